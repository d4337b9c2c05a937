"""Measured fields of displacements in fits."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from wovenfab.case import CaseError, read_case
from wovenfab.forms.effect import Target
from wovenfab.report.fit import draw_fit, write_fit_page
from wovenfab.study.fit.clouds import describe_field, field_compared
from wovenfab.study.fit.fit_file import FieldTest, Fit, read_fit
from wovenfab.study.fit.identifiability import Identifiability, knowledge
from wovenfab.study.fit.objective import Objective
from wovenfab.study.fit.response import (
    BranchError,
    FieldPoints,
    ResponseCurve,
    command,
    computed,
    curve_of,
)
from wovenfab.study.fit.result import write_result
from wovenfab.study.fit.search import search
from wovenfab.study.runner import execute

Array = NDArray[np.float64]
CASE = """\
sheet: {length: 0.2 m, width: 0.1 m, fibres: [45 deg, -45 deg]}
effects:
  stretch: {stiffness: 2e5 N/m}
  shear: {stiffness: 60 N/m}
  bending: {stiffness: 5e-3 N*m}
boundary: {left: clamp, right: {displacement: [program, 0]}}
program: {type: ramp, to: 20 mm, steps: 4}
discretisation: {degree: 2, mesh_size: 25 mm}
"""
FIT = """\
refine: false
tests:
  - case: case.yaml
    measured: curve.csv
    error: 1 %
    fields: [{file: field.csv, at: 12 mm, error: 0.05 mm, subset: 10 mm}]
parameters:
  shear.stiffness: {start: 40 N/m}
  bending.stiffness: {start: 1e-2 N*m}
"""
TRUTH = {"shear.stiffness": 60.0, "bending.stiffness": 5e-3}
#: Of the field and of the curve, over its largest force.
ERROR, NOISE = 5e-5, 0.01
#: Points of a camera, 5 mm apart.
CLOUD = np.stack(np.meshgrid(np.arange(3, 200, 5), np.arange(3, 100, 5)), axis=2).reshape(-1, 2)
POINTS = 1e-3 * CLOUD


def _place(folder: Path) -> Path:
    """Write a fit to what a sample of known stiffness gives, with noise; return its file."""
    generator = np.random.default_rng(1)
    (folder / "case.yaml").write_text(CASE)
    (folder / "fit.yaml").write_text(FIT)
    case = read_case(folder / "case.yaml", {"time.extra_times": ["0.6 s"], "program.steps": 20})
    made = computed(case, [], {"it": FieldPoints(0.6, POINTS)})
    force = made.force + NOISE * made.force.max() * generator.standard_normal(made.force.size)
    rows = [f"{u!r},{f!r}" for u, f in zip(made.displacement.tolist(), force.tolist(), strict=True)]
    (folder / "curve.csv").write_text("\n".join(["u_m,F_N", *rows]) + "\n")
    moved = made.fields["it"][:, :, 0] + ERROR * generator.standard_normal(POINTS.shape)
    cloud = np.hstack([POINTS, moved])
    lines = [",".join(map(repr, row)) for row in cloud.tolist()]
    (folder / "field.csv").write_text("\n".join(["x (m),y (m),ux (m),uy (m)", *lines]) + "\n")
    return folder / "fit.yaml"


SLIDING = {
    "effects.coupling.stiffness": "1e6 N/m^3",
    "effects.spin_friction": "{strength: 3 N/m, slope: 2 s}",
    "program.velocity": "20 mm/s",
}


@pytest.mark.parametrize(
    "more",
    [pytest.param({}, id="bonded"), pytest.param(SLIDING, id="sliding", marks=pytest.mark.slow)],
)
def test_derivatives_of_displacements_are_those_of_differences(
    tmp_path: Path, more: dict[str, str]
) -> None:
    """At a time between two planned ones, of one placement and of two with friction."""
    (tmp_path / "case.yaml").write_text(CASE)
    always = {"solver.tolerance": 1e-12, "time.extra_times": ["0.6 s"], **more}
    places = {"it": FieldPoints(0.6, POINTS[::37])}
    targets = [Target("shear", "stiffness"), Target("bending", "stiffness")]
    names = [f"effects.{t.effect}.{t.parameter}" for t in targets]
    made = computed(read_case(tmp_path / "case.yaml", always), targets, places).fields["it"]
    for k, (name, value) in enumerate(zip(names, TRUTH.values(), strict=True)):
        ends = [
            computed(read_case(tmp_path / "case.yaml", {**always, name: value * s}), [], places)
            for s in (1 + 1e-4, 1 - 1e-4)
        ]
        difference = np.subtract(*(e.fields["it"][:, :, 0] for e in ends)) / (2e-4 * value)
        size = np.abs(difference).max()
        assert size > 0
        np.testing.assert_allclose(made[:, :, 1 + k], difference, atol=1e-4 * size)


@pytest.mark.slow
def test_displacements_are_the_same_on_two_ranks_in_a_process_of_their_own(tmp_path: Path) -> None:
    """As in a fit with ``--ranks 2``, or on a cluster."""
    (tmp_path / "case.yaml").write_text(CASE)
    case = read_case(tmp_path / "case.yaml", {"time.extra_times": ["0.6 s"]})
    asked = case, [Target("bending", "stiffness")], {"it": FieldPoints(0.6, POINTS[::37])}
    one, two = (curve_of(execute(command(*asked, ranks))) for ranks in (1, 2))
    np.testing.assert_allclose(two.slopes, one.slopes, rtol=1e-6, atol=1e-9)
    size = np.abs(one.fields["it"]).max(axis=(0, 1))
    assert (np.abs(two.fields["it"] - one.fields["it"]).max(axis=(0, 1)) < 1e-6 * size).all()


@pytest.mark.slow
def test_bending_is_found_from_field_and_curve_and_not_from_the_curve(tmp_path: Path) -> None:
    """The layer at a clamp is sqrt(K_b/K_s) wide: the field shows it, the force hardly does."""
    fit = read_fit(_place(tmp_path))
    with Objective(fit, tmp_path / "runs") as objective:
        found = search(objective, fit)
    e = found.evaluation
    both = knowledge(fit, found.values, e.residuals, e.jacobian, e.comparisons)
    count = e.comparisons[0].rows.size
    curve = replace(fit, tests=fit.tests[:1])
    parts = e.residuals[:count], e.jacobian[:count], e.comparisons[:1]
    alone = knowledge(curve, found.values, *parts).intervals[1]
    for name, intervals in {"curve alone": (alone,), "field and curve": both.intervals}.items():
        for i in intervals:
            print(f"{name}: {i.name} {i.value:.3g} {i.unit} ({i.low:.3g} to {i.high:.3g})")
    for test, c in zip(fit.tests[1:], e.comparisons[1:], strict=True):
        assert isinstance(test, FieldTest)
        print(describe_field(test, c))
    (tmp_path / "out").mkdir()
    write_result(fit, found, both, (), (), (), tmp_path / "out")
    field = json.loads((tmp_path / "out" / "fit.json").read_text())["tests"][1]["field"]
    assert field["points"] == 800 and field["distance"] == pytest.approx(2**0.5 * ERROR, rel=0.1)
    draw_fit(fit, found, both, tmp_path / "fit.png")
    page = write_fit_page(fit, found, both, (), (), tmp_path / "fit.html").read_text()
    assert "coloured by the distance" in page and "could not be drawn" not in page
    for interval, truth in zip(both.intervals, TRUTH.values(), strict=True):
        assert interval.determined and interval.low < truth < interval.high
    assert not alone.determined and both.intervals[1].half < 0.2 * alone.half


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Fit, ResponseCurve]:
    """Return a fit to a curve and a field, and what the sample gives that they are of."""
    folder = tmp_path_factory.mktemp("made")
    fit = read_fit(_place(folder))
    with Objective(fit, folder / "runs") as objective:
        return fit, objective.evaluate(TRUTH).curves[1]


def _known(fit: Fit, test: FieldTest, curve: ResponseCurve) -> Identifiability:
    """Return what a field tells."""
    own = replace(fit, tests=(test,))
    c = field_compared(test, curve, fit.unknowns)
    residuals = test.factors * (c.computed - c.measured)
    jacobian = test.factors[:, None] * c.slopes * [*TRUTH.values()]
    return knowledge(own, TRUTH, residuals, jacobian, (c,))


def _with_rows(test: FieldTest, curve: ResponseCurve, rows: Array) -> tuple[Any, ResponseCurve]:
    """Return a field of other rows of it; of negative ones the points lie beside the sheet."""
    at = np.abs(rows)
    other = replace(test, points=test.points[at], displacements=test.displacements[at])
    values = curve.fields[test.key][at]
    values[rows < 0] = np.nan
    return other, replace(curve, fields={other.key: values})


def test_points_of_one_square_count_as_one(made: tuple[Fit, ResponseCurve]) -> None:
    """Points that are copied change no interval where their errors are not independent."""
    fit, curve = made
    (_, field), rows = fit.tests, np.arange(len(POINTS))
    assert isinstance(field, FieldTest)
    assert field.share == pytest.approx(200 / len(POINTS))
    twice, same = _with_rows(field, curve, np.repeat(rows, 2))
    assert twice.share == field.share / 2
    known = _known(fit, field, curve), _known(fit, twice, same)
    ends = [[(i.low, i.high) for i in one.intervals] for one in known]
    np.testing.assert_allclose(*ends, rtol=1e-6)
    assert known[0].bic == pytest.approx(known[1].bic)


def test_points_beside_the_sheet_do_not_count_and_most_must_lie_on_it(
    made: tuple[Fit, ResponseCurve], tmp_path: Path
) -> None:
    fit, curve = made
    _, field = fit.tests
    assert isinstance(field, FieldTest)
    field, rows = replace(field, subset=0.0), np.arange(1, len(POINTS))
    fewer = _known(fit, *_with_rows(field, curve, rows[100:]))
    beside = _known(fit, *_with_rows(field, curve, np.concatenate([-rows[:100], rows[100:]])))
    ends = [[(i.low, i.high) for i in one.intervals] for one in (fewer, beside)]
    np.testing.assert_allclose(*ends)
    with pytest.raises(BranchError, match="100 of"):
        field_compared(*_with_rows(field, curve, np.concatenate([rows[:100], -rows[100:]])), ())
    (tmp_path / "case.yaml").write_text(CASE)
    case, away = read_case(tmp_path / "case.yaml"), np.array([[-0.5, 0.0]])
    places = {
        "some": FieldPoints(0.5, np.vstack([away, POINTS[:3]])),
        "none": FieldPoints(1.0, away),
    }
    here = computed(case, [], places).fields
    assert np.isnan(here["some"][0]).all() and np.isfinite(here["some"][1:]).all()
    assert here["none"].shape == (1, 2, 1) and np.isnan(here["none"]).all()


def test_a_field_at_a_displacement_that_the_program_does_not_reach_is_refused(
    tmp_path: Path,
) -> None:
    (tmp_path / "case.yaml").write_text(CASE)
    (tmp_path / "curve.csv").write_text("u_mm,F_N\n0,0\n10,1\n20,2\n")
    (tmp_path / "field.csv").write_text("x (mm),y (mm),ux (mm),uy (mm)\n1,1,0,0\n")
    (tmp_path / "fit.yaml").write_text(FIT)
    case = read_fit(tmp_path / "fit.yaml").tests[0].case
    assert case.time.extra_times == pytest.approx((0.6,))
    (tmp_path / "fit.yaml").write_text(FIT.replace("12 mm", "30 mm"))
    with pytest.raises(CaseError) as caught:
        read_fit(tmp_path / "fit.yaml")
    (problem,) = caught.value.problems
    assert problem.line == 6 and problem.remedy
