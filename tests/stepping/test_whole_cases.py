"""Derivatives of whole cases against differences of runs: twelve smooth scenes, one with kinks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.case import Case, read_case
from wovenfab.case.objects import differentiate, sheet_of, simulation_of
from wovenfab.forms.effect import Target
from wovenfab.solver import globalisation
from wovenfab.study.response import trial_of, with_elements, with_steps

#: Cases of the scene of bias-1x3 with other outputs, or with forces, which have no derivatives.
LEFT_OUT = {"probes-1x3", "creep", "force-cycles"}
CASES = [
    path
    for path in sorted((Path(__file__).parents[2] / "configs").glob("*.yaml"))
    if path.stem not in LEFT_OUT
]
SPIN = next(path for path in CASES if path.stem == "spin-1x3")
#: Tolerance of the balance of forces, part of the planned steps, size of the cells over that of the
#: case, and change of a parameter for a difference.
TOLERANCE, STEPS, CELLS, SHARE = 1e-12, 0.15, 1.5, 1e-2
#: Forces of a run balance to the rounding error that their stiffness may have. Mostly they have
#: less: with this part of it, Newton's method takes the step that differences need.
ROUND_OFF = 0.03
#: Changes for programs of which steps are cut, at lengths that the parameters decide: compression
#: ends before the sheet buckles, and the pantograph is drawn in steps that all succeed.
CHANGES = {"compression": {"program.to": "-0.02 mm"}, "pantograph": {"program.steps": "140"}}
#: Part of the largest value below which a change of a parameter by its own size is without effect:
#: round-off of a stiff sheet's force (1e-7) over the change of the parameter is larger than it.
WITHOUT_EFFECT = 1e-3
#: Smaller changes, and the largest distances: where larger ones cut a step, and where steps have
#: kinks, as points begin to slide or to stick.
SMALLER = {"bias-1x3": (1e-3, 1e-5), "coulomb": (1e-4, 1e-3)}

Curves = tuple[NDArray[np.float64], NDArray[np.float64]]


def small(case: Case, cells: float | None) -> Case:
    """Return a case with few steps, cells of this size (m) and forces that balance well."""
    case = with_steps(trial_of(case, 1e-2), STEPS)
    solver = case.solver.model_copy(update={"tolerance": TOLERANCE})
    case = with_elements(case, mesh_size=cells) if cells else case
    return case.model_copy(update={"solver": solver})


def targets_of(case: Case) -> list[Target]:
    """Return all parameters of a case."""
    return [Target(e, p) for e, values in case.effects.items() for p in values]


def curves(case: Case, targets: Sequence[Target] = ()) -> Curves:
    """Return force and dissipated energy of each step, or their derivatives."""
    with simulation_of(case, sheet_of(case, MPI.COMM_SELF)) as simulation:
        if targets:
            differentiate(simulation, case, targets)
        steps = list(simulation.steps())
    if targets:
        rows = [step.derivatives for step in steps if step.derivatives is not None]
        assert len(rows) == len(steps)
        return np.array([r.force for r in rows]), np.array([r.dissipated for r in rows])
    lost = [sum(step.dissipated.values()) for step in steps]
    return np.array([step.force for step in steps]), np.array(lost)


def changed(case: Case, target: Target, factor: float) -> Case:
    """Return a case with one parameter times a factor, of both families."""
    value = case.effects[target.effect][target.parameter]
    both = [factor * v for v in value] if isinstance(value, tuple) else factor * value
    return case.changed({f"effects.{target.effect}.{target.parameter}": both})


def value_of(case: Case, target: Target) -> float:
    """Return the value of a parameter, that of the first family if there are two."""
    value = case.effects[target.effect][target.parameter]
    return float(value[0] if isinstance(value, tuple) else value)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("path", "scheme"), [*((path, "bdf2") for path in CASES), (SPIN, "midpoint")], ids=str
)
def test_derivatives_of_a_case_agree_with_differences_of_whole_runs(
    path: Path, scheme: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if path.stem != "coulomb":  # a law with kinks is met no better
        monkeypatch.setattr(globalisation, "EPSILON", ROUND_OFF * globalisation.EPSILON)
    exact = {"solver.factor": "renewed"}  # to round-off, which no kept factor reaches
    case = read_case(path, {"time.scheme": scheme, **exact, **CHANGES.get(path.stem, {})})
    size = case.discretisation.mesh_size
    cells = CELLS * size if size else None
    share, most = SMALLER.get(path.stem, (SHARE, 1e-5))
    targets = targets_of(case)
    slopes = curves(small(case, cells), targets)
    values = curves(small(case, cells))
    for k, target in enumerate(targets):
        cases = [small(changed(case, target, 1 + n * share), cells) for n in (2, 1, -1, -2)]
        for of, slope, *at in zip(values, slopes, *map(curves, cases), strict=True):
            by_share = value_of(case, target) * slope[:, k]
            difference = (8 * (at[1] - at[2]) - (at[0] - at[3])) / (12 * share)  # order 4
            size, least = np.abs(difference).max(), WITHOUT_EFFECT * np.abs(of).max()
            distance = np.abs(by_share - difference).max()
            print(
                f"{path.stem} {target}: {distance:.1e} of {size:.1e}, value {np.abs(of).max():.1e}"
            )
            if max(size, np.abs(by_share).max()) > least:
                assert distance <= most * size
