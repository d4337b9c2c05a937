"""Shear angles and normalised shear forces become displacement and force of the test."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import trapezoid

from wovenfab.case import CaseError, read_case
from wovenfab.case.boundary import FrameMotion
from wovenfab.case.specimen import ShearTest, shear_test_of
from wovenfab.measured.curve import describe_reading, read_curve, read_measured
from wovenfab.measured.layout import Layout
from wovenfab.record.bias_extension import BiasExtension
from wovenfab.record.jaws import Jaws
from wovenfab.record.picture_frame import PictureFrame
from wovenfab.study.fit.fit_file import read_fit

Array = NDArray[np.float64]
BIAS = BiasExtension(Jaws(0.3, 0.1, (0.15, 0.05), (1.0, 0.0), factor=-2.0, offset=1e-3))
FRAME = PictureFrame(0.25, 0.2 * 0.18)
GAMMA = np.radians(np.linspace(0.0, 55.0, 221))


def law(gamma: Array) -> Array:
    """Return a normalised shear force (N/m)."""
    return 20 * gamma + 90 * gamma**3


def bias_tension(gamma: Array) -> Array:
    """Return the tension of a bias extension with that law, from its balance of work."""
    h, w, half = BIAS.jaws.distance, BIAS.jaws.width, gamma / 2
    work = (2 * h - 3 * w) * np.cos(gamma) * law(gamma) + w * np.cos(half) * law(half)
    return np.asarray(work / ((h / w - 1) * (np.cos(half) - np.sin(half))))


def written(folder: Path, titles: str, *columns: Array) -> Path:
    rows = (",".join(map(repr, row)) for row in zip(*(c.tolist() for c in columns), strict=True))
    (folder / "curve.csv").write_text("\n".join([titles, *rows, ""]), encoding="utf-8")
    return folder / "curve.csv"


@pytest.mark.parametrize("test", [BIAS, FRAME])
def test_displacement_and_angle_are_inverse(test: ShearTest) -> None:
    np.testing.assert_allclose(test.angle_at(test.displacement_at(GAMMA)), GAMMA, atol=1e-12)


def test_normalised_force_of_a_bias_extension_is_inverse_of_its_evaluation() -> None:
    force = BIAS.force_at(GAMMA, law(GAMMA))
    np.testing.assert_allclose(
        BIAS.shear_force(GAMMA, BIAS.jaws.force(force)), law(GAMMA), atol=1e-9
    )


def test_the_crosshead_of_a_frame_does_the_work_of_the_shear_force() -> None:
    force = FRAME.force_at(GAMMA, law(GAMMA))
    of_crosshead = trapezoid(force, FRAME.displacement_at(GAMMA))
    of_fabric = FRAME.area * trapezoid(law(GAMMA) * np.cos(GAMMA), GAMMA)
    assert of_crosshead == pytest.approx(of_fabric, rel=1e-4)
    np.testing.assert_allclose(
        FRAME.shear_force(FRAME.displacement_at(GAMMA), force), law(GAMMA), rtol=1e-12
    )


def test_the_angle_of_a_frame_is_that_between_its_bars() -> None:
    travel = FRAME.displacement_at(GAMMA)
    x, y = (FrameMotion(FRAME.length, 0.3, axis) for axis in (0, 1))
    bars = []
    for angle in (0.3, 0.3 + np.pi / 2):
        at = np.array([np.cos(angle), np.sin(angle)])
        bars.append(np.array([at[i] + m.at(*at, travel) for i, m in enumerate((x, y))]))
    between = np.arccos((bars[0] * bars[1]).sum(axis=0))
    np.testing.assert_allclose(np.pi / 2 - between, GAMMA, atol=1e-9)


@pytest.mark.parametrize(
    "titles",
    [
        "Shear angle (deg),Normalised shear force (N/mm)",
        "Scherwinkel [°],normierte Scherkraft [N/mm]",
        "angle de cisaillement (degrés),effort de cisaillement (N/mm)",
        "angolo (gradi),forza di taglio normalizzata (N/mm)",
        "ángulo (grados),fuerza de cizalla (N/mm)",
        "\u03b3 / deg,F_sh / N/mm",
    ],
)
def test_a_file_of_angle_and_normalised_force_is_the_curve_of_the_test(
    titles: str, tmp_path: Path
) -> None:
    path = written(tmp_path, titles, np.degrees(GAMMA), 1e-3 * law(GAMMA))
    found = read_measured(path, test=BIAS)
    np.testing.assert_allclose(BIAS.angle_at(found.displacement), GAMMA, atol=1e-9)
    np.testing.assert_allclose(BIAS.jaws.force(found.force), bias_tension(GAMMA), rtol=2e-3)
    found = read_measured(path, test=FRAME)
    np.testing.assert_allclose(found.force, FRAME.force_at(GAMMA, law(GAMMA)), rtol=1e-9)


def test_a_file_of_angle_and_force_keeps_its_force(tmp_path: Path) -> None:
    path = written(tmp_path, "shear angle (rad),shear force (N)", GAMMA, law(GAMMA))
    found = read_measured(path, test=FRAME)
    assert np.array_equal(found.force, law(GAMMA))
    np.testing.assert_allclose(found.displacement, FRAME.displacement_at(GAMMA), rtol=1e-14)


def test_displacement_and_force_are_taken_where_both_pairs_are_there(tmp_path: Path) -> None:
    u = np.linspace(0, 40, len(GAMMA))
    columns = (np.degrees(GAMMA), u, 2 * u, law(GAMMA))
    path = written(tmp_path, "angle (deg),Weg (mm),F (N),shear force (N/m)", *columns)
    found = read_measured(path)
    np.testing.assert_allclose([found.displacement, found.force], [1e-3 * u, 2 * u], rtol=1e-14)
    named = Layout({"angle": 1, "shear_force": 4})
    np.testing.assert_allclose(
        read_measured(path, named, FRAME).force, FRAME.force_at(GAMMA, law(GAMMA)), rtol=1e-9
    )


def test_how_an_angle_is_read_is_said_in_degrees(tmp_path: Path) -> None:
    path = written(tmp_path, "angle (rad),shear force (N/mm)", GAMMA, 1e-3 * law(GAMMA))
    words = "\n".join(describe_reading(read_curve(path)))
    assert "(0 to 55 deg)" in words and f"{law(GAMMA)[-1]:.5g} N/m at 55 deg" in words


def test_an_angle_of_another_test_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, "shear angle (deg),force (N)", np.degrees(GAMMA), law(GAMMA))
    with pytest.raises(CaseError, match=r"curve.csv:1: 'shear angle \(deg\)' is an angle"):
        read_measured(path)


def test_degrees_that_are_called_radians_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path, "angle (rad),force (N)", np.degrees(GAMMA), law(GAMMA))
    with pytest.raises(CaseError, match="between -90 and 90 degrees"):
        read_measured(path, test=BIAS)


def test_normalised_forces_of_a_loop_of_a_bias_extension_are_refused(tmp_path: Path) -> None:
    loop = np.degrees(np.concatenate([GAMMA, GAMMA[::-1]]))
    path = written(tmp_path, "angle (deg),shear force (N/m)", loop, law(loop))
    with pytest.raises(CaseError, match="one loading"):
        read_measured(path, test=BIAS)
    assert read_measured(path, test=FRAME).force.size == loop.size


CASE = """\
sheet: {length: 0.3 m, width: 0.1 m, fibres: [45 deg, -45 deg]}
effects: {stretch: {stiffness: 2e5 N/m}, shear: {stiffness: 60 N/m}}
boundary: {left: clamp, right: {displacement: [program, 0]}}
program: {type: ramp, to: 60 mm, steps: 8}
"""


def test_a_fit_converts_with_the_specimen_of_its_case(tmp_path: Path) -> None:
    (tmp_path / "case.yaml").write_text(CASE)
    written(tmp_path, "angle (deg),shear force (N/m)", np.degrees(GAMMA), law(GAMMA))
    (tmp_path / "fit.yaml").write_text(
        "tests: [{case: case.yaml, measured: curve.csv}]\nparameters: {shear.stiffness: }\n"
    )
    (test,) = read_fit(tmp_path / "fit.yaml").tests
    plain = BiasExtension(Jaws(0.3, 0.1, (0.15, 0.05), (1.0, 0.0)))
    np.testing.assert_allclose(test.measured.displacement, plain.displacement_at(GAMMA))
    np.testing.assert_allclose(test.measured.force, bias_tension(GAMMA), rtol=2e-3)


def test_a_frame_that_holds_all_edges_is_a_picture_frame(tmp_path: Path) -> None:
    held = "{frame: {length: 250 mm}}"
    text = CASE.replace("[45 deg, -45 deg]", "[0 deg, 90 deg]").replace(
        "{left: clamp, right: {displacement: [program, 0]}}", "BOUNDARY"
    )
    edges = dict.fromkeys(("left", "right", "bottom", "top"), held)
    cases = {"all": edges, "three": {k: v for k, v in edges.items() if k != "top"}}
    found = {}
    for name, boundary in cases.items():
        listed = ", ".join(f"{edge}: {how}" for edge, how in boundary.items())
        (tmp_path / f"{name}.yaml").write_text(text.replace("BOUNDARY", f"{{{listed}}}"))
        found[name] = shear_test_of(read_case(tmp_path / f"{name}.yaml"))
    assert found == {"all": PictureFrame(0.25, pytest.approx(0.03)), "three": None}
