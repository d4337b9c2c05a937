"""Newton's steps where yarns are bent sharply, and solves that are about to converge."""

from __future__ import annotations

from math import inf
from pathlib import Path

import pytest
from mpi4py import MPI

from tests import scenes
from wovenfab.case import read_case
from wovenfab.simulation.assemble import sheet_of
from wovenfab.simulation.rig import rig_of
from wovenfab.solver.controls import Controls
from wovenfab.solver.inertia import Inertia
from wovenfab.stepping.step import Step

BONDED = Path(__file__).parents[2] / "configs" / "bonded-1x3.yaml"
#: Yarns of much bending stiffness, held by a clamp and seen closely at its ends.
BENT = (
    "discretisation={degree: 4, mesh: fibres, mesh_size: 50 mm, corner_size: 0.2 mm}",
    "effects.bending.stiffness=4000 N*m",
    "program=[{type: ramp, to: 1 mm, steps: 1}, {type: ramp, to: 30 mm, steps: 1}]",
)


def pulled() -> list[Step]:
    """Return the states of the bent yarns after a small step and a large one."""
    case = read_case(BONDED, BENT)
    with rig_of(case, sheet_of(case, MPI.COMM_SELF)) as rig:
        return list(rig.march.steps())


def test_sharply_bent_yarns_turn_in_one_step_by_the_positive_part_of_the_tangent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    once = pulled()
    monkeypatch.setattr(Inertia, "saddle", False)  # steps are by the whole tangent then
    cut = pulled()
    cutbacks = [sum(s.cutbacks for s in steps) for steps in (once, cut)]
    print(f"\n{once[-1].iterations} iterations, cut-backs {cutbacks[0]}; without it {cutbacks[1]}")
    assert cutbacks[0] == 0 < cutbacks[1]
    assert once[-1].reactions["right"][0] == pytest.approx(cut[-1].reactions["right"][0], rel=1e-6)


def test_a_solve_that_is_about_to_converge_may_take_a_few_iterations_more() -> None:
    own = Controls(keep_from=inf)  # a tangent for each iteration
    ended = []
    for most in (1, 2, 3, 25):
        model = scenes.model(scenes.sheet(mesh_size=0.05), scenes.BONDED, scenes.PROTOTYPE)
        constraints, equilibrium = scenes.solver(model, controls=own)
        constraints.set(0.1)
        outcome = equilibrium._solve(most)
        ended.append((outcome.converged, outcome.iterations))
        equilibrium.destroy()
    print(f"\nconverged after iterations: {ended}")
    needed = ended[-1][1]
    assert needed > 3 and ended[-1][0]
    assert ended[0] == (False, 1)
    assert ended[2] == (True, needed)
