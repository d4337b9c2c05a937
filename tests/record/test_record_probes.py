"""Probes say what the stored fields and closed forms say, on any ranks and beside jumps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely
from mpi4py import MPI

from tests import scenes
from tests.resume.test_resume import small
from tests.verification.test_few_unknowns import SAMPLES
from wovenfab.case import Case, CaseError
from wovenfab.case.schema import OutputSection
from wovenfab.interface import execute
from wovenfab.model.model import Numerics
from wovenfab.model.probes import Probes
from wovenfab.record import output
from wovenfab.record.fields import StoredFields, read_fields
from wovenfab.record.history import read_history
from wovenfab.sheet.output_nodes import OutputNodes, circle, locate

#: On a fibre through a corner, where placements jump; anywhere; and on the edge of the sheet.
JUMP, ANY, EDGE = (0.25, 0.05), (0.47, 0.13), (0.9, 0.21)
PROBES = {
    "jump": {"type": "point", "at": list(JUMP)},
    "any": {"type": "point", "at": list(ANY)},
    "edge": {"type": "point", "at": list(EDGE)},
    "gauge": {"type": "extensometer", "ends": [list(ANY), [0.6, 0.17]], "family": 2},
    "round": {"type": "zone", "centre": [0.45, 0.15], "radius": 0.06},
    "window": {"type": "zone", "corners": [[0.36, 0.21], [0.53, 0.08]]},
    "axis": {"type": "line", "ends": [[0.1, 0.15], [0.8, 0.15]], "points": 11},
    "yarn": {"type": "yarn", "family": 1, "through": list(ANY), "points": 9},
}


def probed(*overrides: str) -> Case:
    program = "program={type: cycles, amplitudes: 20 mm, max_velocity: 0.5 m/s}"
    steps = ("time.steps_per_cycle=8", "output.every=1")
    return small("bias-1x3", program, *steps, *overrides).changed({"output.probes": PROBES})


def assert_as_stored(columns: dict[str, np.ndarray], stored: StoredFields) -> None:
    """Compare every step with the fields of the same step."""
    corners, lattice = stored.corners(), stored.lattice
    zones = {"round": circle((0.45, 0.15), 0.06), "window": shapely.box(0.36, 0.08, 0.53, 0.21)}
    means = lattice.over_zones(corners, list(zones.values()))
    places = np.array([JUMP, ANY, EDGE, (0.6, 0.17)])
    at = stored.at(places)
    for index in range(len(stored.times)):
        u = [at(f"displacement_{family}", index) for family in (1, 2)]
        for i, name in enumerate(("jump", "any", "edge")):
            for family in (1, 2):
                for k, xy in enumerate("xy"):
                    value = columns[f"{name}_displacement_{family}_{xy}_m"][index]
                    assert value == pytest.approx(u[family - 1][i, k], abs=1e-14)
            slip = np.linalg.norm(u[0][i] - u[1][i])
            assert columns[f"{name}_beta_m"][index] == pytest.approx(slip, abs=1e-14)
        length = np.linalg.norm(np.diff((places + u[1])[[1, 3]], axis=0))
        assert columns["gauge_gauge_length_m"][index] == pytest.approx(length, abs=1e-14)
        rest = np.linalg.norm(places[3] - places[1])
        assert columns["gauge_strain"][index] == pytest.approx(length / rest - 1, abs=1e-13)
        angles = means @ stored.field("shear_angle", index) / means.sum(axis=1)
        for name, angle in zip(zones, angles, strict=True):
            assert columns[f"{name}_shear_angle_rad"][index] == pytest.approx(angle, abs=1e-13)


def test_probes_are_the_stored_fields_to_round_off(tmp_path: Path) -> None:
    done = execute(probed(), tmp_path / "run", comm=MPI.COMM_SELF)
    stored, history = read_fields(tmp_path / "run"), read_history(tmp_path / "run")
    assert len(stored.times) == len(history["step"]) == 9
    assert_as_stored(history, stored)
    assert history["jump_beta_m"].max() > 1e-5
    assert {n: v.tolist() for n, v in done.columns.items()} == {
        n: v.tolist() for n, v in history.items()
    }
    memory = execute(probed(), None, comm=MPI.COMM_SELF).columns
    assert (memory["any_beta_m"] == history["any_beta_m"]).all()


@pytest.mark.mpi
@pytest.mark.mpi4
def test_probes_are_the_stored_fields_on_several_ranks(shared_path: Path) -> None:
    columns = execute(probed(), shared_path / "run").columns
    assert_as_stored(columns, read_fields(shared_path / "run"))
    alone = execute(probed(), None, comm=MPI.COMM_SELF).columns
    for name, values in columns.items():
        if name.startswith(tuple(PROBES)):
            np.testing.assert_allclose(values, alone[name], atol=1e-8 * 0.02, err_msg=name)


def test_a_point_on_a_jump_has_the_value_on_the_side_of_larger_x(tmp_path: Path) -> None:
    execute(probed(), tmp_path / "run", comm=MPI.COMM_SELF)
    stored, history = read_fields(tmp_path / "run"), read_history(tmp_path / "run")
    step, sides = len(stored.times) // 2, {}
    for side in (-1, 1):
        beside = np.array([[JUMP[0] + side * 1e-7, JUMP[1]]])
        sides[side] = stored.at(beside)("displacement_2", step)[0]
    assert np.abs(sides[1] - sides[-1]).max() > 1e-5  # 10 µm
    value = [history[f"jump_displacement_2_{xy}_m"][step] for xy in "xy"]
    np.testing.assert_allclose(value, sides[1], atol=1e-7)


def test_lines_have_the_fields_along_them_at_every_stored_time(tmp_path: Path) -> None:
    execute(probed("output.every=4"), tmp_path / "run", comm=MPI.COMM_SELF)
    stored = read_fields(tmp_path / "run")
    table = np.genfromtxt(
        tmp_path / "run" / "lines.csv", delimiter=",", names=True, dtype=None, encoding="utf-8"
    )
    assert len(table) == len(stored.times) * (11 + 9)
    yarn = table[(table["line"] == "yarn") & (table["step"] == stored.steps[1])]
    points = np.column_stack([yarn["x_m"], yarn["y_m"]])
    cross = (points - ANY) @ [1, -1]
    numbers = [name for name in table.dtype.names or () if name != "line"]
    assert all(np.isfinite(table[name]).all() for name in numbers)
    np.testing.assert_allclose(cross, 0, atol=1e-8)  # along 45 degrees, from edge to edge
    np.testing.assert_allclose(points[[0, -1], 1], [0, 0.3], atol=1e-8)
    at = stored.at(points)
    np.testing.assert_allclose(yarn["shear_angle_rad"], at("shear_angle", 1), atol=1e-15)
    slip = np.linalg.norm(at("relative_displacement", 1), axis=1)
    np.testing.assert_allclose(yarn["beta_m"], slip, atol=1e-15)


@pytest.mark.mpi
@pytest.mark.parametrize("names", [scenes.BONDED, scenes.COUPLED])
def test_probes_of_a_homogeneous_strain_are_exact(names: tuple[str, ...]) -> None:
    model = scenes.model(SAMPLES["1:3"].sheet(0.15), names, Numerics(2))
    gradient = np.array([[0.05, 0.1], [0.02, -0.03]])
    scenes.set_field(model.field, lambda x: gradient @ x[:2])
    given = {name: probe.probe for name, probe in OutputSection(probes=PROBES).probes.items()}
    probes = Probes(model, output.Output(probes=given).gauges)
    values = dict(zip(probes.columns, probes.values(), strict=True))
    ends = np.array([ANY, (0.6, 0.17)])
    rest, now = (ends[1] - ends[0]) @ np.array([np.eye(2), np.eye(2) + gradient]).swapaxes(1, 2)
    strain = np.linalg.norm(now) / np.linalg.norm(rest) - 1
    assert values["gauge_strain"] == pytest.approx(strain, abs=1e-13)
    one, other = model.sheet.fibres @ (np.eye(2) + gradient).T
    angle = np.arcsin(one @ other / np.linalg.norm(one) / np.linalg.norm(other))
    for name in ("round", "window"):
        assert values[f"{name}_shear_angle_rad"] == pytest.approx(angle, abs=1e-13)
    moved = gradient @ EDGE
    which = "_1" if len(names) == len(scenes.COUPLED) else ""
    at_edge = [values[f"edge_displacement{which}_{xy}_m"] for xy in "xy"]
    np.testing.assert_allclose(at_edge, moved, atol=1e-14)
    assert ("edge_beta_m" in values) == bool(which)


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5])
def test_means_over_zones_are_exact_for_polynomials(degree: int) -> None:
    corners = np.array([[[0, 0], [2, 0], [0, 1]], [[2, 1], [0, 1], [2, 0]]], dtype=float)
    lattice, box = OutputNodes(degree), shapely.box(0.3, 0.2, 1.7, 0.9)
    shape = np.column_stack([1 - lattice.points.sum(axis=1), lattice.points])
    x, y = np.einsum("pk,ckd->cpd", shape, corners).reshape(-1, 2).T
    for power in range(degree + 1):
        values = x**power * y ** (degree - power)
        parts = [
            (b ** (n + 1) - a ** (n + 1)) / (n + 1)
            for a, b, n in ((0.3, 1.7, power), (0.2, 0.9, degree - power))
        ]
        assert (lattice.over_zones(corners, [box]) @ values)[0] == pytest.approx(np.prod(parts))
    assert circle((1, 2), 0.3).area == pytest.approx(np.pi * 0.09, rel=1e-12)


def test_a_point_of_several_cells_belongs_to_the_side_of_larger_x_whatever_their_order() -> None:
    """Four triangles around a point; two on an edge of the sheet."""
    ring, middle = np.array([[0, 0], [2, 0], [2, 2], [0, 2]], dtype=float), np.array([1.0, 1.0])
    corners = np.array([[ring[i], ring[(i + 1) % 4], middle] for i in range(4)])
    points = np.array([[1, 1], [0.5, 0.5], [1.5, 1.5], [2, 1], [0, 0], [1, 2], [3, 3]])
    expected = [1, 0, 1, 1, 0, 2, -1]  # lower, right, upper, left triangle
    for order in ([0, 1, 2, 3], [3, 1, 0, 2], [2, 3, 1, 0]):
        cells, local, _ = locate(corners[order], points)
        assert [order[c] if c >= 0 else -1 for c in cells] == expected
        start, *others = np.moveaxis(corners[order][cells[:-1]], 1, 0)
        there = start + sum(
            s[:, None] * (o - start) for s, o in zip(local[:-1].T, others, strict=True)
        )
        np.testing.assert_allclose(there, points[:-1])


@pytest.mark.parametrize(
    ("probe", "message"),
    [
        ("{type: point, at: [1 m, 0.1 m]}", r"probes\.p: the point x = 1 m, y = 0\.1 m is not on"),
        ("{type: zone, centre: [0.1 m, 0.1 m], radius: 0.11 m}", "reaches beyond the sheet"),
        ("{type: line, ends: [[0.1, 0.1], [0.1, 0.4]]}", "x from 0 to 0.9 m and y from 0 to 0.3 m"),
        ("{type: yarn, family: 3, through: [0.1, 0.1]}", "expected '1' or '2'"),
        ("{type: extensometer, ends: [[0.1, 0.1], [0.1, 0.1]]}", "both points are the same"),
        ("{type: zone, radius: 1 mm}", "two corners, or a centre and a radius"),
        ("{type: zone, corners: [[0.1, 0.1], [0.1, 0.2]]}", "not opposite"),
        ("{type: pont, at: [0, 0]}", "Did you mean 'point'"),
    ],
)
def test_probes_that_cannot_be_are_refused_before_the_run(
    probe: str, message: str, tmp_path: Path
) -> None:
    with pytest.raises(CaseError, match=message):
        execute(small("bias-1x3", f"output.probes.p={probe}"), tmp_path / "run")
    assert not (tmp_path / "run").exists()
