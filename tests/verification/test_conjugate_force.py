"""The recorded force: conjugate to the program, whatever the wording and the axes."""

from collections.abc import Mapping
from math import cos, pi, sin, sqrt, tan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import wovenfab
from wovenfab.case import CaseError
from wovenfab.record.summary import read_cycles

#: Unequal families, and friction of both kinds: no symmetry hides an error.
EFFECTS = {
    "stretch": {"stiffness": [1e5, 3e5]},
    "shear": {"stiffness": 50.0},
    "coupling": {"stiffness": 1e6},
    "slip_friction": {"strength": 3000.0, "slope": 100.0},
    "spin_friction": {"strength": 5.0, "law": "coulomb"},
}
CORNERS = np.array([(0, 0), (0.2, 0), (0.2, 0.1), (0, 0.1)])
RAMP = {"type": "ramp", "to": "15 mm", "velocity": "20 mm/s", "steps": 3}


def file_of(corners: NDArray[np.float64], at: Path) -> Path:
    """Write a quadrilateral in gmsh's language; its sides are bottom, right, top, left."""
    lines = [f"Point({i}) = {{{x:.15g}, {y:.15g}, 0, 1}};" for i, (x, y) in enumerate(corners, 1)]
    lines += [f"Line({i}) = {{{i}, {i % 4 + 1}}};" for i in range(1, 5)]
    lines += ["Curve Loop(1) = {1:4};", "Plane Surface(1) = {1};", 'Physical Surface("s") = {1};']
    lines += [
        f'Physical Curve("{name}") = {{{i}}};'
        for i, name in enumerate(("bottom", "right", "top", "left"), 1)
    ]
    at.write_text("\n".join(lines) + "\n")
    return at


def turned(angle: float, mirrored: bool, folder: Path) -> list[dict[str, Any]]:
    """Return what is recorded of a test whose axes are turned, or mirrored before that."""
    turn = np.array([[cos(angle), -sin(angle)], [sin(angle), cos(angle)]])
    sign = -1.0 if mirrored else 1.0
    corners = CORNERS * [1.0, sign] @ turn.T
    x, y = turn @ [1.0, 0.0]
    case = wovenfab.Case(
        sheet={
            "file": str(file_of(corners, folder / f"{angle:.3f}{sign}.geo")),
            "fibres": [f"{sign * a + np.degrees(angle):.14g} deg" for a in (50, -35)],
        },
        effects=EFFECTS,
        boundary={
            "left": "clamp",
            "right": {"displacement": [f"program*({x:.17g})", f"program*({y:.17g})"]},
        },
        program=RAMP,
        discretisation={"degree": 2, "mesh_size": 0.05},
    )
    return [
        {
            "force": s.force,
            "across": sign * s.force_transverse,
            "stored": sum(s.stored.values()),
            "dissipated": sum(s.dissipated.values()),
            "work": s.work,
        }
        for s in wovenfab.steps(case)
    ]


def test_turned_and_mirrored_sheets_have_the_same_figures(tmp_path: Path) -> None:
    reference = turned(0.0, False, tmp_path)
    assert abs(reference[-1]["across"]) > 0.01 * reference[-1]["force"]  # it can be wrong
    angle = np.random.default_rng(5).uniform(-pi, pi)
    for now, then in zip(turned(angle, True, tmp_path), reference, strict=True):
        assert now == pytest.approx(then, rel=1e-6, abs=1e-9)


def bias(boundary: Mapping[str, Any], amplitude: float, folder: Path) -> dict[str, Any]:
    case = wovenfab.Case(
        sheet={"length": 0.6, "width": 0.3, "fibres": ["45 deg", "-45 deg"]},
        effects={
            "stretch": {"stiffness": 1e5},
            "shear": {"stiffness": 100.0},
            "spin_friction": {"strength": 20.0, "law": "coulomb"},
        },
        boundary=boundary,
        program={"type": "cycles", "amplitudes": [amplitude], "frequency": "1 Hz"},
        time={"steps_per_cycle": 8},
        discretisation={"degree": 2, "mesh_size": 0.15},
        output={"pictures": False},
    )
    run = wovenfab.simulate(case, folder / "run", overwrite=True)
    (cycle,), (row,) = run.summary["cycles"], read_cycles(folder / "run")
    figures = {name: value for name, value in cycle.items() if name != "complete"}
    assert {name: float(row[name]) for name in figures} == figures
    return dict(cycle)


#: Conditions, amplitude (m), and elongation per program.
WORDINGS: dict[str, tuple[dict[str, Any], float, float]] = {
    "one grip": ({"left": "clamp", "right": {"displacement": ["program", 0]}}, 0.03, 1.0),
    "both grips": (
        {"left": {"displacement": ["-program", 0]}, "right": {"displacement": ["program", 0]}},
        0.015,
        2.0,
    ),
    "a formula": (
        {"left": "clamp", "right": {"displacement": ["2*program/(1 + 0*y/1 m)", 0]}},
        0.015,
        2.0,
    ),
}


def test_the_figures_of_a_cycle_do_not_depend_on_its_wording(tmp_path: Path) -> None:
    found = {
        name: (bias(boundary, amplitude, tmp_path), factor)
        for name, (boundary, amplitude, factor) in WORDINGS.items()
    }
    reference, _ = found["one grip"]
    same = ("loop_area_J", "loss_ratio", "secant_stiffness_N_per_m", "dissipated_J")
    for cycle, factor in found.values():
        assert {k: cycle[k] for k in same} == pytest.approx(
            {k: reference[k] for k in same}, rel=1e-6
        )
        assert cycle["peak_force_N"] == pytest.approx(factor * reference["peak_force_N"], rel=1e-6)
        balance = cycle["dissipated_J"] + cycle["imbalance_J"]
        # the sheet does not come back to the state of reference quite
        assert cycle["loop_area_J"] == pytest.approx(balance, rel=5e-3)


SHEAR, SIDE = 400.0, 0.3
FRAMED = {"stretch": {"stiffness": 1e7}, "shear": {"stiffness": SHEAR}}


def framed(**frame: Any) -> dict[str, Any]:
    """Return the boundary of a sheet with all edges in a frame."""
    return {name: {"frame": frame} for name in ("right", "top", "left", "bottom")}


def picture_frame(**more: Any) -> wovenfab.Case:
    given: dict[str, Any] = {
        "sheet": {"length": SIDE, "width": SIDE, "fibres": ["0 deg", "90 deg"]},
        "effects": FRAMED,
        "boundary": framed(length="400 mm"),
        "program": {"type": "ramp", "to": "60 mm", "steps": 2, "velocity": "1 m/s"},
        "discretisation": {"degree": 2, "mesh": "crossed", "mesh_size": 0.15},
    }
    return wovenfab.Case(**(given | more))


def kinematics(length: float, travel: float) -> tuple[float, float]:
    """Return the shear angle (rad) of a frame, and its change with the travel (rad/m)."""
    c = 1 / sqrt(2) + travel / (2 * length)
    return pi / 2 - 2 * np.arccos(c), 1 / (length * sqrt(1 - c * c))


@pytest.mark.parametrize("mesh", ["crossed", "fibres"])
@pytest.mark.parametrize("length", [0.3, 0.4])
def test_the_crosshead_of_a_picture_frame_has_the_force_of_its_closed_form(
    mesh: str, length: float
) -> None:
    """Shear energy K tan(gamma)^2/2 per area: F = dW/dtravel."""
    case = picture_frame(
        boundary=framed(length=length),
        discretisation={"degree": 2, "mesh": mesh, "mesh_size": 0.15},
    )
    for step in wovenfab.steps(case):
        gamma, rate = kinematics(length, step.displacement)
        torque = SHEAR * tan(gamma) / cos(gamma) ** 2
        assert step.force == pytest.approx(SIDE**2 * torque * rate, rel=1e-8, abs=1e-9)


@pytest.mark.parametrize("size", [0.15, 0.075])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_each_bar_of_a_picture_frame_has_its_own_traction(size: float, degree: int) -> None:
    """Also at its ends, which it shares with the next bar; whichever is named first."""
    found = []
    for names in (("right", "top", "left", "bottom"), ("bottom", "left", "top", "right")):
        case = picture_frame(
            boundary={name: {"frame": {"length": SIDE}} for name in names},
            discretisation={"degree": degree, "mesh": "crossed", "mesh_size": size},
        )
        *_, step = wovenfab.steps(case)
        found.append(step.reactions)
    gamma, _ = kinematics(SIDE, 0.06)
    torque = SHEAR * tan(gamma) / cos(gamma) ** 2
    # The diagonal of the frame is at 45 degrees, so that the bars turn by gamma/2 each.
    one = np.array([cos(gamma / 2), sin(gamma / 2)])
    two = one[::-1]
    right = SIDE * torque * (two - sin(gamma) * one) / cos(gamma)
    expected = {"right": right, "top": right[::-1], "left": -right, "bottom": -right[::-1]}
    for reactions in found:
        for edge, force in expected.items():
            assert reactions[edge] == pytest.approx(tuple(force), rel=1e-6)


def test_a_turned_frame_has_the_same_force(tmp_path: Path) -> None:
    angle = np.random.default_rng(8).uniform(0.2, 1.4)
    turn = np.array([[cos(angle), -sin(angle)], [sin(angle), cos(angle)]])
    corners = SIDE * np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) @ turn.T + [0.3, -0.2]
    case = picture_frame(
        sheet={
            "file": str(file_of(corners, tmp_path / "frame.geo")),
            "fibres": [f"{np.degrees(angle) + a:.14g} deg" for a in (0, 90)],
        },
        boundary=framed(length=0.4, angle=angle),
        discretisation={"degree": 2, "mesh_size": 0.15},
    )
    *_, here = wovenfab.steps(case)
    *_, there = wovenfab.steps(picture_frame())
    assert here.force == pytest.approx(there.force, rel=1e-8)
    assert here.reactions["left"] == pytest.approx(tuple(turn @ there.reactions["left"]), rel=1e-6)


@pytest.mark.parametrize("travel", ["235 mm", "-570 mm"])
def test_a_frame_that_the_program_folds_flat_is_refused(travel: str) -> None:
    with pytest.raises(CaseError) as caught:
        picture_frame(program={"type": "ramp", "to": travel, "steps": 2, "velocity": "1 m/s"})
    assert all(p.key.endswith("frame.length") for p in caught.value.problems)


def test_a_frame_reads_as_it_is_written(tmp_path: Path) -> None:
    case, path = picture_frame(), tmp_path / "again.yaml"
    path.write_text(case.to_yaml())
    assert wovenfab.read_case(path).boundary == case.boundary


def test_where_nothing_moves_the_force_is_that_of_what_is_held_apart() -> None:
    """A sheet that is held stretched along a direction, and one that carries a load."""
    sheet = {"length": 0.2, "width": 0.1, "fibres": ["0 deg", "90 deg"]}
    common: dict[str, Any] = {
        "sheet": sheet,
        "effects": FRAMED,
        "program": {"type": "hold", "duration": "1 s", "steps": 1},
        "discretisation": {"degree": 2, "mesh_size": 0.1},
    }
    held = {"left": "clamp", "right": {"displacement": ["1 mm", "-2 mm"]}}
    *_, step = wovenfab.steps(wovenfab.Case(boundary=held, **common))
    direction = np.array([1.0, -2.0]) / sqrt(5)
    assert step.force == pytest.approx(direction @ step.reactions["right"], rel=1e-12)
    loaded = {"left": "clamp", "right": {"force": ["30 N/m", "40 N/m"]}}
    *_, step = wovenfab.steps(wovenfab.Case(boundary=loaded, **common))
    assert step.force == pytest.approx(0.1 * 50, rel=1e-9)


def test_reactions_of_edges_that_share_corners_converge() -> None:
    """For a traction that varies, against elements of higher degree; naming order included."""
    motion = {
        "displacement": [
            "program*(sin(3*x/0.3 m) + 0.5*(y/0.3 m)^2)",
            "program*cos(2*y/0.3 m)*x/0.3 m",
        ]
    }

    def reactions(degree: int, cells: int, *names: str) -> NDArray[np.float64]:
        case = wovenfab.Case(
            sheet={"length": SIDE, "width": SIDE, "fibres": ["0 deg", "90 deg"]},
            effects={"stretch": {"stiffness": 1e4}, "shear": {"stiffness": 1e4}},
            boundary=dict.fromkeys(names, motion),
            program={"type": "ramp", "to": "5 mm", "steps": 1},
            discretisation={"degree": degree, "mesh": "crossed", "mesh_size": SIDE / cells},
        )
        *_, step = wovenfab.steps(case)
        return np.array([step.reactions[name] for name in ("left", "top")])

    order = ("right", "top", "left", "bottom")
    limit = reactions(3, 12, *order)
    for names in (order, order[::-1]):
        errors = [np.abs(reactions(1, n, *names) - limit).max() for n in (4, 8)]
        assert errors[0] < 0.05 * np.abs(limit).max()
        assert errors[1] < errors[0] / 3
