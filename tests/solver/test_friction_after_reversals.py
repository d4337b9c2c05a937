"""Friction that reverses in sheets: few iterations, and steps that need not be cut."""

from __future__ import annotations

from copy import deepcopy
from itertools import takewhile
from typing import Any

import pytest
from mpi4py import MPI

from benchmarks.hard.families.sharp_friction import ELASTIC, SOUND, WAYS, path
from benchmarks.hard.measurement import Measurement
from tests import scenes
from wovenfab.case import Case
from wovenfab.case.objects import sheet_of, simulation_of
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.stepping.program import cycle, program_of
from wovenfab.stepping.schemes import SCHEMES
from wovenfab.stepping.step import Step
from wovenfab.stepping.time_stepper import TimeStepper

#: A bias extension and back of a weave of which one family hardly resists bending.
UNBALANCED: dict[str, Any] = {
    "sheet": {"length": "300 mm", "width": "100 mm", "fibres": ["45 deg", "-45 deg"]},
    "effects": {
        "stretch": {"stiffness": "5e4 N/m"},
        "shear": {"stiffness": "10 N/m"},
        "bending": {"stiffness": ["1e-2 N*m", "1e-5 N*m"]},
        "spin_friction": {"strength": "3 N/m", "law": "coulomb"},
    },
    "boundary": {"left": "clamp", "right": {"displacement": ["program", 0]}},
    "program": {"type": "cycles", "amplitudes": "45 mm", "frequency": "0.1 Hz"},
}


@pytest.mark.slow
def test_sharp_friction_goes_on_at_points_from_the_stresses_that_were_there_last() -> None:
    """Else the instant reversal takes 13 iterations."""
    law = "effects.slip_friction={strength: 1e5, slope: 1e6}"
    run = Measurement(ELASTIC.but(path(WAYS[:3]), law)).run()
    worst = next(bound.most for bound in SOUND if bound.figure == "worst")
    assert run.end == "finished"
    assert max(step.iterations for step in run.steps) <= worst
    assert not sum(step.cutbacks for step in run.steps)


@pytest.mark.parametrize(
    ("size", "number"), [("50 mm", 20), pytest.param("25 mm", 12, marks=pytest.mark.slow)]
)
def test_steps_after_a_reversal_are_not_cut_where_one_family_hardly_bends(
    size: str, number: int
) -> None:
    """Stuck points are extrapolated as if they slid: that first step is far too long.

    With long steps the tangent becomes indefinite between two equilibria: its positive part leads
    to the next one.
    """
    elements = {"degree": 2, "mesh_size": size}
    case = Case(**UNBALANCED, discretisation=elements, time={"steps_per_cycle": number})
    steps: list[Step] = []
    with simulation_of(case, sheet_of(case, MPI.COMM_SELF)) as simulation:
        stepped = simulation.stepper.steps()
        steps += takewhile(lambda step: step.time < 6.9, stepped)
    assert max(step.displacement for step in steps) > steps[-1].displacement + 0.005
    assert not sum(step.cutbacks for step in steps)
    assert len(steps) == 1 + int(0.69 * number)


def test_a_run_that_goes_on_has_the_stresses_that_were_there_last() -> None:
    """Also where the smooth law was back when it was stopped: the same iterations follow."""
    values = {**scenes.TABLE_1, "slip_friction": {"strength": 199.2e3, "slope": 1e7}}
    program = program_of(cycle(0.0, 0.04, 0.25, 12))

    def stepper() -> tuple[EquilibriumSolver, TimeStepper]:
        names = (*scenes.COUPLED, "slip_friction")
        solver = scenes.solver(scenes.model(scenes.sheet(), names, scenes.PROTOTYPE, values))
        return solver, TimeStepper(solver, program, SCHEMES["backward-euler"], 1 / 64)

    solver, whole = stepper()
    snapshots, steps = [], []
    for step in whole.steps():
        steps.append((step.number, step.iterations))
        snapshots.append(deepcopy(whole.snapshot()))
    solver.destroy()
    of_solver = [snapshot["solver"] for snapshot in snapshots]
    smooth = [n for n, s in enumerate(of_solver) if s["sharp_stress"] and not s["sharp"]]
    assert smooth
    again, rest = stepper()
    rest.resume(snapshots[smooth[0]])
    assert [(s.number, s.iterations) for s in rest.steps()] == steps[smooth[0] + 1 :]
    again.destroy()
