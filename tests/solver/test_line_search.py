"""Newton's steps where yarns are bent sharply, and steps that may rise a little."""

from __future__ import annotations

from math import inf
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from wovenfab.case import read_case
from wovenfab.case.objects import sheet_of, simulation_of
from wovenfab.solver.globalisation import LOOSE, LineSearch, backtrack
from wovenfab.solver.tangent_spectrum import TangentSpectrum
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
    with simulation_of(case, sheet_of(case, MPI.COMM_SELF)) as simulation:
        return list(simulation.steps())


@pytest.mark.slow
def test_sharply_bent_yarns_turn_in_one_step_by_the_positive_part_of_the_tangent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    once = pulled()
    monkeypatch.setattr(TangentSpectrum, "saddle", False)  # steps are by the whole tangent then
    cut = pulled()
    cutbacks = [sum(s.cutbacks for s in steps) for steps in (once, cut)]
    print(f"\n{once[-1].iterations} iterations, cut-backs {cutbacks[0]}; without it {cutbacks[1]}")
    assert cutbacks[0] == 0 < cutbacks[1]
    assert once[-1].reactions["right"][0] == pytest.approx(cut[-1].reactions["right"][0], rel=1e-6)


class Slope:
    """A potential of one unknown that falls by 1 J per length, and has given values at 1, 2, ..."""

    def __init__(self, *values: float) -> None:
        """Begin at the first value, with steps of length 1."""
        unknowns = SimpleNamespace(array=np.zeros(1), scatter_forward=lambda: None)
        self.field = SimpleNamespace(x=unknowns)
        problem: Any = SimpleNamespace(model=SimpleNamespace(field=self.field), energy=self.energy)
        self.values, self.search = values, LineSearch(problem)

    def energy(self) -> float:
        """Return the potential, by straight lines between its values."""
        return float(np.interp(self.field.x.array[0], range(len(self.values)), self.values))

    def go(self, loose: bool = True) -> float:
        """Search from here, go there, and return how far."""
        length = self.search.along(np.ones(1), 1.0, 1.0, lambda energy: 0.0, loose)
        self.field.x.array += length
        return length


def test_a_whole_step_may_rise_a_little_from_the_lowest_potential_so_far() -> None:
    little = LOOSE / 2
    hills = Slope(0.0, little, 2 * little, -1.0, -1.0 + little)
    assert hills.go() == 1.0  # from the lowest so far
    assert hills.search.potential == little and hills.search.decrement == inf
    assert hills.go() < 1e-3  # the next one has to go down, and finds no way
    assert hills.search.failures == 1


@pytest.mark.parametrize(("gain", "length"), [(5e-5, 0.5), (5e-4, 1.0)])
def test_a_step_that_gains_a_ten_thousandth_of_what_its_slope_promises_is_enough(
    gain: float, length: float
) -> None:
    """The constant of sufficient decrease of Nocedal and Wright (2006), section 3.1."""
    found, _ = backtrack(lambda at: -gain if at == 1.0 else -at / 2, 0.0, 1.0, 1.0, 0.0)
    assert found == length


def test_steps_that_rise_more_or_are_by_indefinite_tangents_are_shortened() -> None:
    assert Slope(0.0, 1.1 * LOOSE).go() < 1.0
    assert Slope(0.0, LOOSE / 2).go(loose=False) < 1.0
    down = Slope(0.0, -1.0, -1.0 + LOOSE / 2)
    assert down.go() == 1.0 and down.search.decrement == 1.0
    assert down.go() == 1.0 and down.search.decrement == inf
