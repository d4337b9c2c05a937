"""The figures of a standard test do not depend on how its case is worded, nor on ranks."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from mpi4py import MPI

from wovenfab.case import Case, CaseError, read_case
from wovenfab.case.objects import sheet_of
from wovenfab.case.specimen import TestName
from wovenfab.interface import read_results, simulate
from wovenfab.record.figures import read_figures
from wovenfab.record.results import FILES

ALONE = MPI.COMM_SELF
TURN = np.radians(30)
CONFIGS = Path(__file__).parents[2] / "configs"
#: A small KES shear test between jaws whose distance is kept.
SHEAR: dict[str, Any] = {
    "sheet": {"length": 0.2, "width": 0.05, "fibres": [0.0, np.pi / 2]},
    "effects": {
        "stretch": {"stiffness": 1e5},
        "shear": {"stiffness": 50.0},
        "spin_friction": {"law": "coulomb", "strength": 2.0},
    },
    "boundary": {"bottom": "clamp", "top": {"displacement": ["program", 0]}},
    "program": [
        {"type": "ramp", "to": 0.007, "steps": 20},
        {"type": "ramp", "to": -0.007, "steps": 40},
        {"type": "ramp", "to": 0.0, "steps": 20},
    ],
    "discretisation": {"degree": 2, "mesh_size": 0.05},
    "output": {"pictures": False, "fields": [], "checkpoint": False},
    "figures": "kes-shear",
}
#: The same with both jaws moving, and to the other side first.
HALVED = {
    "bottom": {"displacement": ["-program/2", 0]},
    "top": {"displacement": ["program/2", 0]},
}
MIRRORED = {"bottom": "clamp", "top": {"displacement": ["-program", 0]}}
#: A rectangle turned about the origin.
TURNED_GEO = """
SetFactory("OpenCASCADE");
Rectangle(1) = {{0, 0, 0, {length}, {width}}};
Rotate {{{{0, 0, 1}}, {{0, 0, 0}}, {turn}}} {{ Surface{{1}}; }}
Physical Surface("sheet") = {{1}};
Physical Curve("bottom") = {{1}};
Physical Curve("right") = {{2}};
Physical Curve("top") = {{3}};
Physical Curve("left") = {{4}};
"""
#: Relative difference of figures by rounding, and by another mesh, as gmsh makes it of a file.
SAME, ANOTHER_MESH = 1e-6, 1e-3


def turned(case: dict[str, Any], folder: Path, move: str, along: float) -> Case:
    """Return a case with its rectangle turned by 30 degrees; ``move`` goes at an angle to x."""
    sides = {name: case["sheet"][name] for name in ("length", "width")}
    (folder / "turned.geo").write_text(TURNED_GEO.format(**sides, turn=TURN))
    fibres = [angle + TURN for angle in case["sheet"]["fibres"]]
    way = [f"{f(along + TURN):.15g}*program" for f in (np.cos, np.sin)]
    sheet = {"file": str(folder / "turned.geo"), "fibres": fibres}
    boundary = {**case["boundary"], move: {"displacement": way}}
    return Case(**{**case, "sheet": sheet, "boundary": boundary})


FRAME = (CONFIGS / "picture-frame.yaml", ["figures=picture-frame", "output.pictures=false"])


def figures_of(case: Case, comm: MPI.Comm = ALONE) -> dict[str, float]:
    (figures,) = simulate(case, comm=comm).figures.values()
    assert all(value is not None for value in figures.values())
    return {name: float(value or 0) for name, value in figures.items()}


@pytest.fixture(scope="module")
def plain() -> dict[str, float]:
    return figures_of(Case(**SHEAR))


@pytest.mark.parametrize(
    "boundary",
    [
        pytest.param(HALVED, id="halved"),
        pytest.param(MIRRORED, id="mirrored", marks=pytest.mark.slow),
    ],
)
def test_a_shear_test_has_its_figures_however_the_jaws_move(
    boundary: dict[str, Any], plain: dict[str, float]
) -> None:
    other = figures_of(Case(**{**SHEAR, "boundary": boundary}))
    assert other == pytest.approx(plain, rel=SAME)


def test_a_turned_shear_test_has_its_figures(tmp_path: Path, plain: dict[str, float]) -> None:
    assert figures_of(turned(SHEAR, tmp_path, "top", 0.0)) == pytest.approx(plain, rel=ANOTHER_MESH)


def test_a_tension_across_the_jaws_is_a_part_of_the_stiffness() -> None:
    """(K tan/cos^2 + T sin + zeta) / cos: sheet, tension and friction against the travel."""
    tension = 9.80665
    free = {"displacement": ["program", "free"], "force": [0, tension]}
    found = figures_of(Case(**SHEAR).changed({"boundary.top": free}))

    def force(gamma: float) -> float:
        torque = 50 * np.tan(gamma) / np.cos(gamma) ** 2 + tension * np.sin(gamma) + 2.0
        return float(torque / np.cos(gamma))

    a, b = np.radians([0.5, 2.5])
    assert found["G"] == pytest.approx((force(b) - force(a)) / (b - a), rel=5e-3)
    assert found["2HG5"] == pytest.approx(2 * 2.0 / np.cos(np.radians(5)), rel=5e-3)


def test_friction_between_rigid_yarns_gives_a_width_of_twice_its_strength(
    plain: dict[str, float],
) -> None:
    """All yarns from jaw to jaw turn alike; borders and stretch change it by some thousandths."""
    assert plain["2HG"] == pytest.approx(2 * 2.0, rel=5e-3)
    assert plain["2HG5"] == pytest.approx(2 * 2.0, rel=2e-2)


@pytest.mark.mpi
def test_figures_on_two_ranks_are_those_on_one() -> None:
    """Of a frame with edges on which one rank has no facets."""
    case = read_case(*FRAME)
    together, alone = (
        {name: value for name, value in figures.items() if value is not None}
        for figures in (
            simulate(case, comm=comm).figures["picture-frame"] for comm in (MPI.COMM_WORLD, ALONE)
        )
    )
    assert "shear force" in alone
    assert together == pytest.approx(alone, rel=SAME)


BIAS: dict[str, Any] = {
    **SHEAR,
    "sheet": {"length": 0.3, "width": 0.1, "fibres": [np.pi / 4, -np.pi / 4]},
    "boundary": {"left": "clamp", "right": {"displacement": ["program", 0]}},
    "program": [
        {"type": "ramp", "to": 0.06, "steps": 12},
        {"type": "ramp", "to": 0.0, "steps": 12},
    ],
    "figures": "bias-extension",
}


@pytest.mark.slow
def test_a_turned_bias_extension_has_its_figures(tmp_path: Path) -> None:
    zone = {"type": "zone", "centre": [0.15, 0.05], "radius": 0.01}
    case = Case(**BIAS).changed({"output.probes": {"middle": zone}})
    upright = figures_of(case)
    x, y = np.array([[np.cos(TURN), -np.sin(TURN)], [np.sin(TURN), np.cos(TURN)]]) @ [0.15, 0.05]
    other = turned(BIAS, tmp_path, "right", 0.0)
    other = other.changed({"output.probes": {"middle": {**zone, "centre": [x, y]}}})
    assert "measured angle" in upright
    assert figures_of(other) == pytest.approx(upright, rel=ANOTHER_MESH)


def test_a_picture_frame_has_the_shear_force_of_its_law(tmp_path: Path) -> None:
    """K tan/cos^3 at every angle, by the crosshead alone."""
    probe = "output.probes={middle: {type: zone, centre: [0.15 m, 0.15 m], radius: 50 mm}}"
    run = simulate(read_case(*FRAME).changed(probe), tmp_path / "run", comm=ALONE)
    figures = run.figures["picture-frame"]
    gamma = figures["largest angle"]
    assert gamma == pytest.approx(figures["measured angle"], rel=1e-6)
    assert figures["shear force"] == pytest.approx(400 * np.tan(gamma) / np.cos(gamma) ** 3, 1e-4)
    assert read_results(run.directory or "").figures == run.figures
    files = read_figures(tmp_path / "run")["picture-frame"]
    assert {name: figure.value for name, figure in files.items()} == figures


@pytest.mark.parametrize(
    ("case", "changes"),
    [
        (SHEAR, {"figures": ["kes-shear", "kes-tension"]}),
        (SHEAR, {"figures": "bias-extension"}),
        (SHEAR, {"figures": "picture-frame"}),
        (SHEAR, {"sheet.fibres": ["45 deg", "-45 deg"]}),
        (SHEAR, {"boundary.left": {"displacement": ["free", 0]}}),
        (SHEAR, {"boundary.top": {"displacement": ["program", "program"]}}),
        (SHEAR, {"boundary.top": {"displacement": ["program*x/(1 m)", 0]}}),
        (SHEAR, {"boundary.top": {"displacement": ["min(program, 1 mm)", 0]}}),
        (SHEAR, {"program": {"type": "ramp", "to": "7 mm"}}),
        (SHEAR, {"figures": "kes"}),
        (BIAS, {"figures": "kes-shear"}),
        (BIAS, {"sheet.length": "150 mm"}),
        (BIAS, {"figures": "kes-tension", "program": {"type": "ramp", "to": "-1 mm"}}),
    ],
)
def test_a_case_that_is_another_test_is_refused_at_its_key(
    case: dict[str, Any], changes: dict[str, Any]
) -> None:
    with pytest.raises(CaseError) as refused:
        Case(**case).changed(changes)
    assert [p.key.partition(".")[0] for p in refused.value.problems] == ["figures"]


def test_the_curve_of_every_test_that_a_case_may_name_is_a_known_file() -> None:
    assert {f"{name}.csv" for name in get_args(TestName)} <= {*FILES}


def test_a_geometry_that_is_another_test_is_refused_before_it_runs(tmp_path: Path) -> None:
    case = turned(SHEAR, tmp_path, "top", np.pi / 2)  # along the line from jaw to jaw
    with pytest.raises(CaseError) as refused:
        sheet_of(case, ALONE)
    assert [p.key.partition(".")[0] for p in refused.value.problems] == ["figures"]
    assert sheet_of(case.changed("figures=kes-tension"), ALONE).edges
