"""The parts of the cost of a scene make up no more than the whole."""

from __future__ import annotations

import pytest
from mpi4py import MPI

from tests.study.test_estimate import case_of
from wovenfab.case.objects import sheet_of
from wovenfab.study.effects import measure


@pytest.mark.slow
def test_tangents_and_factors_are_parts_of_a_step() -> None:
    cycle = "program.amplitudes=40mm", "time.steps_per_cycle=80"
    case = case_of("bias-1x3", *cycle, "discretisation={degree: 2, mesh_size: 150 mm}")
    cost = measure(case, sheet_of(case, MPI.COMM_SELF))
    parts = cost.tangents * cost.assembly, cost.factorisations * cost.factorisation
    print(f"\n{cost.iterations} iterations, {cost.tangents} tangents, {parts} of {cost.step} s")
    assert cost.tangents >= 1
    assert 1 <= cost.factorisations <= cost.tangents
    assert 0 < sum(parts) < cost.step
