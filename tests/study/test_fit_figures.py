"""Figures of a standard test as targets of a fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.stats import norm

from wovenfab.case import CaseError
from wovenfab.record.figures import LABORATORY
from wovenfab.study.fit.figures import figures_compared
from wovenfab.study.fit.fit_file import FigureTest, Fit, read_fit
from wovenfab.study.fit.identifiability import knowledge
from wovenfab.study.fit.objective import Objective
from wovenfab.study.fit.response import BranchError, ResponseCurve
from wovenfab.study.fit.result import write_result
from wovenfab.study.fit.search import search

Array = NDArray[np.float64]
SHEET = """\
sheet: {length: 50 mm, width: 200 mm, fibres: [0 deg, 90 deg]}
discretisation: {degree: 2, mesh_size: 50 mm}
boundary: {left: clamp, right: {displacement: [0, program]}}
program:
  - {type: ramp, to: 7 mm, steps: 16}
  - {type: ramp, to: -7 mm, steps: 32}
  - {type: ramp, to: 0 mm, steps: 16}
figures: kes-shear
"""
FABRIC = """\
effects:
  stretch: {stiffness: 100 kN/m}
  shear: {stiffness: 60 N/m}
  spin_friction: {law: coulomb, strength: 2 N/m * (1 + (gamma/8 deg)^2)}
"""
FIT = """\
refine: false
tests:
  - case: test.yaml
    fabric: fabric.yaml
    figures: {G: 2 gf/(cm*deg), 2HG: 5 gf/cm, 2HG5: {value: 7.5 gf/cm, error: 0.3 gf/cm}}
    error: 2 %
parameters:
  shear.stiffness: {start: 60 N/m}
  spin_friction.strength#1: {start: 2 N/m}
  spin_friction.strength#3: {start: 8 deg, bounds: [1 deg, 90 deg]}
"""
#: Sides of the sample, m, and travels of a jaw, m.
LENGTH, WIDTH = 0.05, 0.2
TRAVEL = np.concatenate(
    [np.linspace(0, 7e-3, 24), np.linspace(7e-3, -7e-3, 48)[1:], np.linspace(-7e-3, 0, 24)[1:]]
)
TURNS = (0, 23, 70, 93)


def _place(folder: Path, fit: str = FIT, sheet: str = SHEET) -> Path:
    for name, text in {"test": sheet, "fabric": FABRIC, "fit": fit}.items():
        (folder / f"{name}.yaml").write_text(text)
    return folder / "fit.yaml"


def _uniform(stiffness: float, strength: float, angle: float) -> ResponseCurve:
    """Return the loop F/WIDTH = K gamma + Z (1 + (gamma/A)^2) with its derivatives; A in deg."""
    gamma = np.arctan(TRAVEL / LENGTH)
    share = gamma / np.radians(angle)
    way = np.sign(np.diff(TRAVEL, prepend=TRAVEL[0]))
    columns = [gamma, way * (1 + share**2), -2 * way * strength * share**2 / angle]
    force = WIDTH * (stiffness * columns[0] + strength * columns[1])
    work = cumulative_trapezoid(force, TRAVEL, initial=0.0)
    return ResponseCurve(TRAVEL, force, work, WIDTH * np.stack(columns, axis=1), TURNS, 0.0)


@pytest.fixture
def fit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fit:
    def curves(
        objective: Objective, values: Mapping[str, float], scale: float
    ) -> Sequence[ResponseCurve]:  # of a uniform sheet, in place of a run
        return [_uniform(*values.values())]

    monkeypatch.setattr(Objective, "_curves", curves)
    return read_fit(_place(tmp_path))


def test_the_parameters_of_a_uniform_sheet_are_those_of_its_figures(
    fit: Fit, tmp_path: Path
) -> None:
    """G = K + 3 Z/A^2 per deg, 2HG = 2 Z (1 + (0.5 deg/A)^2), 2HG5 = 2 Z (1 + (5 deg/A)^2)."""
    with Objective(fit, tmp_path / "runs") as objective:
        found = search(objective, fit)
    stiffness, strength, angle = found.values.values()
    gf = LABORATORY["N/m"][1]
    per_square = (7.5 - 5.0) * gf / 2 / (5**2 - 0.5**2)
    assert found.converged
    assert strength == pytest.approx(2.5 * gf - 0.25 * per_square, rel=1e-3)
    assert strength / angle**2 == pytest.approx(per_square, rel=1e-3)
    growth = np.degrees(3 * per_square)
    assert stiffness + growth == pytest.approx(2 * gf * 180 / np.pi, rel=1e-3)


def test_intervals_are_those_of_the_stated_errors(fit: Fit, tmp_path: Path) -> None:
    """As many parameters as figures: nothing but the errors tells how far they may be off."""
    with Objective(fit, tmp_path / "runs") as objective:
        found = search(objective, fit)
    e = found.evaluation
    known = knowledge(fit, found.values, e.residuals, e.jacobian, e.comparisons)
    (test,) = fit.tests
    inverse = np.linalg.inv(e.comparisons[0].slopes * objective.slopes(found.values))
    expected = norm.ppf(0.975) * np.sqrt(((inverse * test.errors) ** 2).sum(axis=1))
    assert [i.half for i in known.intervals] == pytest.approx(expected, rel=1e-6)
    write_result(fit, found, known, (), (), [], tmp_path)
    assert '"fitted"' in (tmp_path / "fit.json").read_text()


def test_derivatives_of_figures_are_those_of_differences(tmp_path: Path) -> None:
    """Of those that are linear in the force and of the loop energy, by a Taylor expansion."""
    figures = "figures: {G: 2 gf/(cm*deg), 2HG5: 7.5 gf/cm, loop energy: 2 gf*cm/cm^2}"
    text = FIT.replace(FIT[FIT.index("figures:") : FIT.index("\n    error")], figures)
    fit = read_fit(_place(tmp_path, text))
    (test,) = fit.tests
    assert isinstance(test, FigureTest)
    at, way = np.array([60.0, 2.0, 8.0]), np.array([6.0, -0.2, 0.3])

    def compared(step: float) -> tuple[Array, Array]:
        c = figures_compared(test, _uniform(*(at + step * way)), fit.unknowns)
        return c.computed, c.slopes

    value, slopes = compared(0.0)
    rests = [np.abs(compared(h)[0] - value - h * slopes @ way).max() for h in (1e-2, 5e-3)]
    assert np.log2(rests[0] / rests[1]) == pytest.approx(2, abs=0.1)


def test_errors_are_shares_or_values_with_units(fit: Fit) -> None:
    (test,) = fit.tests
    assert test.errors / LABORATORY["N/m"][1] == pytest.approx(
        [0.02 * 2 * 180 / np.pi, 0.02 * 5, 0.3]
    )


def test_a_figure_that_the_steps_do_not_tell_is_refused(tmp_path: Path) -> None:
    fit = read_fit(_place(tmp_path))
    (test,) = fit.tests
    assert isinstance(test, FigureTest)
    full = _uniform(60.0, 2.0, 8.0)
    rows = slice(0, 24)  # without a way back there is no width
    u, force, work = full.displacement[rows], full.force[rows], full.work[rows]
    half = ResponseCurve(u, force, work, full.slopes[rows], (0, 23), 0.0)
    with pytest.raises(BranchError, match="2HG, 2HG5"):
        figures_compared(test, half, fit.unknowns)


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("2HG: 5", "3HG: 5", "tests.0.figures.3HG"),
        ("2HG: 5 gf/cm", "2HG: 5 gf", "tests.0.figures.2HG"),
        ("2HG: 5 gf/cm", "2HG: 0 gf/cm", "tests.0.figures.2HG"),
        ("0.3 gf/cm", "0.3 deg", "tests.0.figures.2HG5"),
        ("0.3 gf/cm", "0 gf/cm", "tests.0.figures.2HG5"),
        ("error: 2 %", "error: 2 N", "tests.0"),
        ("error: 2 %", "measured: fit.csv", "tests.0"),
    ],
)
def test_bad_figures_are_refused_at_their_key(old: str, new: str, key: str, tmp_path: Path) -> None:
    (tmp_path / "fit.csv").write_text("u_mm,F_N\n0,0\n1,1\n2,2\n")
    assert old in FIT
    with pytest.raises(CaseError) as refused:
        read_fit(_place(tmp_path, FIT.replace(old, new)))
    assert [p.key for p in refused.value.problems] == [key]


def test_a_case_without_figures_has_none_to_fit(tmp_path: Path) -> None:
    with pytest.raises(CaseError) as refused:
        read_fit(_place(tmp_path, sheet=SHEET.replace("figures: kes-shear\n", "")))
    assert [p.key for p in refused.value.problems] == ["figures"]
