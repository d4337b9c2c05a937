"""Figures of standard tests against closed forms of homogeneous sheets."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from wovenfab.case import units
from wovenfab.record.bias_extension import BiasExtension
from wovenfab.record.figures import LABORATORY, Figure, read_figures, write_figures
from wovenfab.record.history import read_history
from wovenfab.record.jaws import Jaws
from wovenfab.record.kes import KesShear, KesTension
from wovenfab.record.loop import Loop
from wovenfab.record.picture_frame import PictureFrame
from wovenfab.record.reading import UnreadableResultsError
from wovenfab.record.results import FIGURES
from wovenfab.record.shear_curve import locking_angle

Array = NDArray[np.float64]
K, ZETA = 84.0, 1.7  # N/m
DISTANCE, WIDTH = 0.05, 0.2  # m
JAWS = Jaws(DISTANCE, WIDTH, (0.1, 0.025), (0.0, 1.0))
#: Degrees of a KES cycle, a number of steps each that puts none of them at 0.5, 2.5 or 5.
CYCLE, STEPS = (0.0, 8.0, -8.0, 0.0), (37, 74, 37)


def path(ends: tuple[float, ...] = CYCLE, steps: tuple[int, ...] = STEPS) -> Array:
    """Return values from end to end, evenly."""
    ways = zip(pairwise(ends), steps, strict=True)
    parts = [np.linspace(a, b, n + 1)[1:] for (a, b), n in ways]
    return np.concatenate([ends[:1], *parts])


def slide(strain: Array) -> Array:
    """Return on each step which way the strain has gone: the sign of Coulomb's friction."""
    return np.sign(np.diff(strain, prepend=strain[0]))


def history(displacement: Array, force: Array, friction: Array | float = 0.0) -> dict[str, Array]:
    """Return a history: a force that is elastic, and a friction that acts in a step as at its end.

    The work is the trapezoidal rule of the one, and exact of the other.
    """
    friction = friction + 0 * force
    moved = np.diff(displacement)
    work = moved * ((force[1:] + force[:-1]) / 2 + friction[1:])
    return {
        "step": np.arange(len(force), dtype=float),
        "time_s": np.arange(len(force), dtype=float),
        "displacement_m": displacement,
        "force_N": force + friction,
        "work_J": np.concatenate([[0.0], work.cumsum()]),
    }


def kes_shear(
    angle: Array, law: Callable[[Array], Array], zeta: float = ZETA, factor: float = 1.0
) -> dict[str, Array]:
    """Return the history of a uniform shear with force per width law(gamma) and friction."""
    travel = DISTANCE * np.tan(angle) / factor
    return history(travel, WIDTH * factor * law(angle), WIDTH * factor * zeta * slide(angle))


def values(figures: dict[str, Figure]) -> dict[str, float | None]:
    return {name: figure.value for name, figure in figures.items()}


def test_a_linear_shear_with_coulomb_friction_has_its_stiffness_and_twice_its_strength() -> None:
    """F = K gamma + zeta sign: G = K and 2HG = 2HG5 = 2 zeta; zeta is lost along the travel."""
    angle = np.radians(path())
    found = values(KesShear(JAWS).figures(kes_shear(angle, lambda a: K * a)))
    assert found["G"] == pytest.approx(K, rel=1e-12)
    assert found["2HG"] == pytest.approx(2 * ZETA, rel=1e-12)
    assert found["2HG5"] == pytest.approx(2 * ZETA, rel=1e-12)
    assert found["loop energy"] == pytest.approx(4 * np.tan(np.radians(8)) * ZETA, rel=1e-12)


def test_between_steps_a_curved_law_is_followed() -> None:
    """F = K tan/cos^2: the slope between 0.5 deg and 2.5 deg is a difference of the law."""
    angle, (a, b) = np.radians(path()), np.radians([0.5, 2.5])

    def law(gamma: Array) -> Array:
        return K * np.tan(gamma) / np.cos(gamma) ** 2

    found = values(KesShear(JAWS).figures(kes_shear(angle, law)))
    assert found["G"] == pytest.approx((law(b) - law(a)) / (b - a), rel=1e-5)
    assert found["2HG5"] == pytest.approx(2 * ZETA, rel=1e-5)


def test_both_sides_count_alike() -> None:
    """Twice the friction and stiffness on one side: the figures are means of both."""
    angle = np.radians(path())
    uneven = np.where(angle > 0, 1.0, 2.0)
    force = WIDTH * uneven * K * angle
    friction = WIDTH * uneven * ZETA * slide(angle)
    found = values(KesShear(JAWS).figures(history(DISTANCE * np.tan(angle), force, friction)))
    assert found["G"] == pytest.approx(1.5 * K, rel=1e-9)
    assert found["2HG"] == pytest.approx(3 * ZETA, rel=1e-9)


@pytest.mark.parametrize("factor", [-1.0, 0.5, 2.0])
def test_neither_the_side_nor_the_share_of_a_jaw_matters(factor: float) -> None:
    angle = np.radians(path())
    plain = values(KesShear(JAWS).figures(kes_shear(angle, lambda a: K * a)))
    jaws = Jaws(DISTANCE, WIDTH, (0.1, 0.025), (0.0, 1.0), factor)
    other = values(KesShear(jaws).figures(kes_shear(angle, lambda a: K * a, factor=factor)))
    assert other == pytest.approx(plain, rel=1e-12)
    mirrored = kes_shear(-angle, lambda a: K * a, factor=factor)
    assert values(KesShear(jaws).figures(mirrored)) == pytest.approx(plain, rel=1e-12)


def test_jaws_that_come_nearer_shear_by_the_sine_of_their_travel() -> None:
    free = Jaws(DISTANCE, WIDTH, (0.1, 0.025), (0.0, 1.0), free=True)
    angle = np.radians([-8.0, 0.0, 3.0])
    np.testing.assert_allclose(KesShear(free).shear_angle(DISTANCE * np.sin(angle)), angle)
    np.testing.assert_allclose(KesShear(JAWS).shear_angle(DISTANCE * np.tan(angle)), angle)


def test_the_first_of_several_cycles_is_read() -> None:
    ends, steps = (*CYCLE, *CYCLE[1:]), (*STEPS, *STEPS)
    angle = np.radians(path(ends, steps))
    later = np.arange(len(angle)) > sum(STEPS)
    zeta = np.where(later, ZETA / 2, ZETA)
    travel, force = DISTANCE * np.tan(angle), WIDTH * K * angle
    found = values(KesShear(JAWS).figures(history(travel, force, WIDTH * zeta * slide(angle))))
    assert found["2HG"] == pytest.approx(2 * ZETA, rel=1e-9)
    assert found["loop energy"] == pytest.approx(4 * np.tan(np.radians(8)) * ZETA, rel=1e-9)


@pytest.mark.parametrize(
    ("ends", "steps", "unknown"),
    [
        (CYCLE[:2], (37,), {"G", "2HG", "2HG5", "loop energy"}),  # one way
        (CYCLE[:3], (37, 74), {"2HG", "2HG5", "loop energy"}),  # no way back on one side
        (CYCLE, (10, 20, 10), {"G", "2HG"}),  # 0.5 deg is within the first step
        ((0.0, 4.0, -4.0, 0.0), STEPS, {"2HG5"}),
    ],
)
def test_what_a_test_does_not_tell_is_left_out(
    ends: tuple[float, ...], steps: tuple[int, ...], unknown: set[str]
) -> None:
    angle = np.radians(path(ends, steps))
    found = values(KesShear(JAWS).figures(kes_shear(angle, lambda a: K * a)))
    assert {name for name, value in found.items() if value is None} == unknown


def test_a_linear_elastic_tension_is_linear_and_gives_all_back() -> None:
    """LT = 1, RT = 100 %, WT = F e / 2."""
    strain, stiffness = path((0.0, 0.04, 0.0), (20, 20)), 1.2e4
    force = stiffness * WIDTH * strain
    found = values(KesTension(JAWS).figures(history(DISTANCE * strain, force)))
    peak = stiffness * 0.04
    expected = {"EMT": 0.04, "force": peak, "WT": peak * 0.04 / 2, "LT": 1.0, "RT": 1.0}
    assert found == pytest.approx(expected | {"loop energy": 0.0}, rel=1e-12, abs=1e-12)


def test_a_force_that_ends_at_nothing_but_for_its_tolerance_gives_all_back() -> None:
    """A program of forces ends a little above zero or below it by chance."""
    strain = path((0.0, 0.04, 1e-7), (20, 20))
    found = values(KesTension(JAWS).figures(history(DISTANCE * strain, 1.2e4 * WIDTH * strain)))
    assert found["RT"] == pytest.approx(1.0, rel=1e-6)


def test_a_parabolic_tension_has_two_thirds_of_the_work() -> None:
    """F = a e^2 has WT = a e^3 / 3 and LT = 2/3, which finer steps approach."""
    strain = path((0.0, 0.04), (400,))
    found = values(KesTension(JAWS).figures(history(DISTANCE * strain, 3e5 * WIDTH * strain**2)))
    assert found["WT"] == pytest.approx(3e5 * 0.04**3 / 3, rel=1e-5)
    assert found["LT"] == pytest.approx(2 / 3, rel=1e-5)
    assert found["RT"] is None


def test_coulomb_friction_takes_a_known_share_of_the_work() -> None:
    """F = k e + z sign: the way back ends at e_0 = z/k and gives k (e - e_0)^2 / 2."""
    strain, k, z = path((0.0, 0.04, 0.0), (400, 400)), 1.2e4, 60.0
    force, friction = WIDTH * k * strain, WIDTH * z * slide(strain)
    found = values(KesTension(JAWS).figures(history(DISTANCE * strain, force, friction)))
    work, back = k * 0.04**2 / 2 + z * 0.04, k * (0.04 - z / k) ** 2 / 2
    assert found["WT"] == pytest.approx(work, rel=1e-9)
    assert found["RT"] == pytest.approx(back / work, rel=1e-4)
    assert found["loop energy"] == pytest.approx(2 * z * 0.04, rel=1e-9)


def curve(angle: Array, force: Array) -> Loop:
    return Loop(angle, force, np.zeros_like(angle))


@pytest.mark.parametrize("intercept", [0.0, 3.0])
def test_a_bilinear_curve_locks_at_its_kink(intercept: float) -> None:
    angle, kink = np.linspace(0, 0.9, 61), 0.6
    force = intercept + K * angle + 40 * K * np.maximum(angle - kink, 0)
    out = curve(angle, force).way_out(0.9)
    assert locking_angle(out) == pytest.approx(kink, rel=1e-12)


def test_a_linear_curve_does_not_lock() -> None:
    angle = np.linspace(0, 0.9, 61)
    assert np.isnan(locking_angle(curve(angle, K * angle).way_out(0.9)))


def test_where_a_force_is_not_known_no_angle_locks() -> None:
    angle = np.linspace(0, 0.9, 61)
    force = K * np.tan(angle) ** 3
    assert np.isfinite(locking_angle(curve(angle, force).way_out(0.9)))
    force[30] = np.nan
    assert np.isnan(locking_angle(curve(angle, force).way_out(0.9)))


def slope(angle: Array) -> Array:
    """Return the derivative of K/2 tan^2, N/m."""
    return K * np.tan(angle) / np.cos(angle) ** 2


def frame_history(angle: Array, length: float, area: float, friction: float) -> dict[str, Array]:
    """Return the history of a picture frame: F dd = A (slope + zeta sign) dgamma."""
    half = np.pi / 4 - angle / 2
    travel = 2 * length * (np.cos(half) - 1 / np.sqrt(2))
    way = length * np.sin(half)  # dd/dgamma
    return history(travel, area * slope(angle) / way, area * friction * slide(angle) / way)


def test_a_picture_frame_gives_the_shear_force_of_its_energy_out_and_back() -> None:
    """F_sh cos(gamma) is the torque per area: K tan/cos^2 and, against the motion, zeta."""
    length, area = 0.36, 0.09
    angle = np.radians(path((0.0, 45.0, 0.0), (90, 90)))
    test = PictureFrame(length, area)
    loop = test.loop(frame_history(angle, length, area, ZETA))
    np.testing.assert_allclose(loop.strain, angle, atol=1e-12)
    expected = (slope(angle) + ZETA * slide(angle)) / np.cos(angle)
    np.testing.assert_allclose(loop.force, expected, atol=1e-10)
    found = values(test.figures(frame_history(angle, length, area, 0.0)))
    assert found["largest angle"] == pytest.approx(np.radians(45))
    assert found["shear force"] == pytest.approx(slope(angle).max() * np.sqrt(2))


def bias_history(angle: Array, jaws: Jaws, friction: float) -> dict[str, Array]:
    """Return the history of two zones with gamma and gamma/2, by the work of the grips."""
    h, w = jaws.distance, jaws.width
    travel = (h - w) * (np.cos(angle / 2) + np.sin(angle / 2) - 1)
    way = (h - w) / 2 * (np.cos(angle / 2) - np.sin(angle / 2))  # dd/dgamma
    elastic = w * (h - 1.5 * w) * slope(angle) + w**2 * slope(angle / 2) / 2
    lost = (w * (h - 1.5 * w) + w**2 / 2) * friction * slide(angle)
    return history(travel, elastic / way, lost / way)


def test_bias_extension_gives_the_shear_force_of_its_energy_out_and_back() -> None:
    jaws = Jaws(0.9, 0.3, (0.45, 0.15), (1.0, 0.0))
    angle = np.radians(path((0.0, 40.0, 0.0, 40.0), (200, 200, 200)))
    loop = BiasExtension(jaws).loop(bias_history(angle, jaws, ZETA))
    np.testing.assert_allclose(loop.strain, angle, atol=1e-12)
    expected = (slope(angle) + ZETA * slide(angle)) / np.cos(angle)
    beyond = angle > np.radians(4)  # of what the zones beside the centre pass within a step
    np.testing.assert_allclose(loop.force[beyond], expected[beyond], rtol=1e-3)
    assert np.isfinite(loop.force).all()


def test_where_the_half_angle_was_not_passed_there_is_no_shear_force() -> None:
    jaws = Jaws(0.9, 0.3, (0.45, 0.15), (1.0, 0.0))
    angle = np.radians(path((0.0, 40.0, 20.0), (50, 25)))
    loop = BiasExtension(jaws).loop(bias_history(angle, jaws, ZETA))
    assert np.isfinite(loop.force[:51]).all() and np.isnan(loop.force[51:]).all()


def test_a_zone_gives_the_measured_angle_positive_in_any_order_of_the_families() -> None:
    jaws = Jaws(0.9, 0.3, (0.45, 0.15), (1.0, 0.0))
    angle = np.radians(path((0.0, 40.0), (50,)))
    test = BiasExtension(jaws, zone="middle", sign=-1.0)
    seen = bias_history(angle, jaws, 0.0) | {"middle_shear_angle_rad": -0.9 * angle}
    assert test.figures(seen)["measured angle"].value == pytest.approx(0.9 * np.radians(40))
    np.testing.assert_allclose(test.curve(seen)["shear_angle_measured_rad"], 0.9 * angle)


def test_laboratory_units_are_those_of_pint() -> None:
    for unit, (shown, size) in LABORATORY.items():
        plain = unit.replace("(m·rad)", "m") if "rad)" in unit else unit
        known = {"m/m": "", "J/J": "", "1": ""}.get(plain, plain)
        if shown != "1":
            assert units.parse(f"1 {shown}", known) == pytest.approx(size, rel=1e-12)


def test_files_have_the_figures_and_the_curve(tmp_path: Path) -> None:
    angle = np.radians(path(CYCLE[:3], STEPS[:2]))
    seen, test = kes_shear(angle, lambda a: K * a), KesShear(JAWS)
    write_figures(tmp_path, [test], seen)
    assert read_figures(tmp_path) == {test.name: test.figures(seen)}
    table = (tmp_path / "figures.csv").read_text().splitlines()
    assert len(table) == 1 + len(test.figures(seen))
    columns = read_history(tmp_path, f"{test.name}.csv")
    np.testing.assert_array_equal(columns["shear_angle_rad"], test.curve(seen)["shear_angle_rad"])


def test_without_a_test_nothing_is_written(tmp_path: Path) -> None:
    write_figures(tmp_path, [], kes_shear(np.radians(path()), lambda a: K * a))
    assert not list(tmp_path.iterdir()) and read_figures(tmp_path) == {}


@pytest.mark.parametrize(
    "content",
    [
        {"kes-shear": 1},
        {"kes-shear": {"G": 1.0}},
        {"kes-shear": {"G": {"value": "1", "unit": "N/m", "definition": ""}}},
        {"kes-shear": {"G": {"value": 1.0, "unit": "kg", "definition": ""}}},
        {"kes-shear": {"G": {"value": 1.0, "unit": ["N/m"], "definition": ""}}},
        {"kes-shear": {"G": {"value": 1.0}}},
    ],
)
def test_a_damaged_file_is_refused(tmp_path: Path, content: object) -> None:
    (tmp_path / FIGURES).write_text(json.dumps(content))
    with pytest.raises(UnreadableResultsError, match=FIGURES):
        read_figures(tmp_path)
