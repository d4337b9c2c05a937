from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from tests.report.sample import WIDTH, make, turn_of
from wovenfab.case import read_case
from wovenfab.case.specimen import bias_extension_of
from wovenfab.record.bias_extension import BiasExtension
from wovenfab.record.history import read_history
from wovenfab.record.jaws import Jaws
from wovenfab.record.summary import mean_shear_angle, read_cycles, write_cycles

CONFIGS = Path(__file__).parents[2] / "configs"
LENGTH, WIDTH_OF_IT = 0.9, 0.3


def specimen_of(
    length: float = LENGTH, factor: float = 1.0, offset: float = 0.0, upright: bool = False
) -> BiasExtension:
    centre, direction = (length / 2, WIDTH_OF_IT / 2), (1.0, 0.0)
    turn = slice(None, None, -1) if upright else slice(None)
    jaws = Jaws(length, WIDTH_OF_IT, centre[turn], direction[turn], factor, offset)
    return BiasExtension(jaws)


SPECIMEN = specimen_of()
K = 400.0
UPRIGHT = [
    "sheet.length=0.3",
    "sheet.width=0.9",
    "boundary={bottom: clamp, top: {displacement: [0, program]}}",
]
BOTH = "boundary={left: {displacement: [-program, 0]}, right: {displacement: [program, 0]}}"
APART = "boundary={left: {displacement: [-5 mm, 0]}, right: {displacement: [program, 0]}}"


def table(results: Path, specimen: BiasExtension | None) -> list[dict[str, str]]:
    """The rows of cycles.csv of a made-up run, whose cycles have 80 steps each."""
    history = read_history(results)
    write_cycles(results, history, pairwise(history["time_s"][::80]), specimen)
    return read_cycles(results)


def elongation(angle: np.ndarray) -> np.ndarray:
    """How far the grips part: the central zone's diagonal, from rest (m)."""
    span = SPECIMEN.jaws.distance - SPECIMEN.jaws.width
    return span * (np.cos(angle / 2) + np.sin(angle / 2) - 1)


def test_the_angle_is_that_of_a_rhombus_of_yarns() -> None:
    angle = np.radians([-20, 0, 1e-6, 5, 30, 89.9])
    np.testing.assert_allclose(SPECIMEN.shear_angle(elongation(angle)), angle, atol=1e-12)


def test_beyond_locking_there_is_no_angle() -> None:
    locked = (np.sqrt(2) - 1) * (SPECIMEN.jaws.distance - SPECIMEN.jaws.width)
    assert np.isfinite(SPECIMEN.shear_angle(locked * 0.999999))
    assert np.isnan(SPECIMEN.shear_angle(locked * 1.000001))


def test_the_central_zone_has_the_area_of_the_zone_theory() -> None:
    x, y = (np.arange(0.5, n) / n for n in (900, 300))
    points = np.stack(np.meshgrid(LENGTH * x, WIDTH_OF_IT * y), axis=-1).reshape(-1, 2)
    h, w = LENGTH, WIDTH_OF_IT
    assert SPECIMEN.in_centre(points).mean() == pytest.approx((2 * h - 3 * w) / (2 * h), rel=2e-3)
    turned = specimen_of(upright=True)
    assert (turned.in_centre(points[:, ::-1]) == SPECIMEN.in_centre(points)).all()


def test_the_shear_force_is_that_of_a_sheet_whose_energy_is_known() -> None:
    """The energy K/2 tan^2 of both zones gives F, from which F_sh = K tan / cos^3 comes back."""
    h, w = LENGTH, WIDTH_OF_IT
    angle = np.linspace(0, np.radians(60), 1201)

    def slope(a: np.ndarray) -> np.ndarray:
        return K * np.tan(a) / np.cos(a) ** 2

    power = w * (h - 1.5 * w) * slope(angle) + w**2 * slope(angle / 2) / 2
    way = (h - w) / 2 * (np.cos(angle / 2) - np.sin(angle / 2))  # d elongation / d angle
    np.testing.assert_allclose(np.gradient(elongation(angle), angle)[1:-1], way[1:-1], rtol=1e-5)
    force = SPECIMEN.shear_force(angle, power / way)
    np.testing.assert_allclose(force[1:], (slope(angle) / np.cos(angle))[1:], rtol=1e-5)


@pytest.mark.parametrize(
    ("config", "overrides", "specimen"),
    [
        ("bias-1x3", [], SPECIMEN),
        ("bias-1x3", ["sheet.fibres=[-45 deg, 45 deg]"], SPECIMEN),
        ("bias-1x3", ["sheet.fibres=[135 deg, 45 deg]"], replace(SPECIMEN, sign=-1.0)),
        ("bias-1x3", ["boundary.left={clamp: rotation}"], SPECIMEN),
        ("bias-1x3", UPRIGHT, replace(specimen_of(upright=True), sign=-1.0)),
        ("bias-1x3", [BOTH], specimen_of(factor=2.0)),
        ("bias-1x3", [APART], specimen_of(offset=0.005)),
        ("bias-1x3", ["sheet.length=0.6"], specimen_of(0.6)),
        ("bias-1x3", ["sheet.length=0.59"], None),
        ("bias-1x3", ["sheet.fibres=[30 deg, -45 deg]"], None),
        ("bias-1x3", ["boundary.right={displacement: [program, free]}"], None),
        ("bias-1x3", ["boundary.right={displacement: [0, program]}"], None),
        ("bias-1x3", ["boundary.right={displacement: [program * y / (1 m), 0]}"], None),
        ("bias-1x3", ["boundary.right={displacement: [program, 0], family: 1}"], None),
        ("bias-1x3", ["boundary.top={force: [0, 1 N/m]}"], None),
        ("uniaxial", [], None),
        ("dogbone", [], None),
    ],
)
def test_which_cases_are_bias_extension(
    config: str, overrides: list[str], specimen: BiasExtension | None
) -> None:
    assert bias_extension_of(read_case(CONFIGS / f"{config}.yaml", overrides)) == specimen


def test_a_grip_that_moves_inwards_pulls_with_the_opposite_force() -> None:
    inwards = specimen_of(factor=-1.0)
    np.testing.assert_array_equal(inwards.jaws.force(np.array([3.0])), [-3.0])
    np.testing.assert_array_equal(inwards.jaws.travel(np.array([-0.02])), [0.02])


def test_the_table_has_the_angles_of_a_net_of_inextensible_yarns(tmp_path: Path) -> None:
    """In the made-up run the central zone shears alike but for narrow borders."""
    results = make(tmp_path / "run", [0.03, 0.06], every=20)
    rows = table(results, SPECIMEN)
    assert [row["cycle"] for row in rows] == ["1", "2"]
    assert [row["complete"] for row in rows] == ["true", "true"]
    for row, amplitude in zip(rows, (0.03, 0.06), strict=True):
        kinematic, measured = (
            float(row[f"shear_angle_{how}_rad"]) for how in ("kinematic", "field")
        )
        assert kinematic == pytest.approx(2 * turn_of(amplitude), rel=0.01)
        assert measured == pytest.approx(kinematic, rel=0.12)  # 20 mm borders around the zone
        assert measured < kinematic
        assert 0 < float(row["normalised_shear_force_N_per_m"]) < float(row["peak_force_N"]) / WIDTH


def test_what_is_not_known_is_left_out(tmp_path: Path) -> None:
    results = make(tmp_path / "run", [0.03], every=30)
    assert mean_shear_angle(results, read_history(results)["time_s"][40], SPECIMEN) is None
    apart = specimen_of(offset=0.005)  # the way out does not begin at rest
    (row,) = table(results, apart)
    assert row["shear_angle_field_rad"] == row["normalised_shear_force_N_per_m"] == ""
    assert float(row["shear_angle_kinematic_rad"]) > 0


def test_other_tests_have_no_such_columns(tmp_path: Path) -> None:
    (row,) = table(make(tmp_path / "run", [0.03]), None)
    assert not [name for name in row if "shear" in name]
    assert float(row["loss_ratio"]) == pytest.approx(
        float(row["loop_area_J"]) / float(row["stored_at_peak_J"])
    )


def test_a_run_without_cycles_has_no_table(tmp_path: Path) -> None:
    write_cycles(tmp_path, {"time_s": np.zeros(1)}, [(0, 1)], None)
    assert read_cycles(tmp_path) == []
    assert not list(tmp_path.iterdir())
