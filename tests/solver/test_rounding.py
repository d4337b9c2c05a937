"""Where rounding at a few stiff nodes exceeds the forces of the sheet, Newton's method goes on."""

from __future__ import annotations

from math import fsum
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from wovenfab.case import Case
from wovenfab.case.objects import sheet_of
from wovenfab.solver.globalisation import EPSILON, Convergence
from wovenfab.study.response import response_of, with_elements


@pytest.fixture
def rounded() -> Convergence:
    """Return a judge for whom rounding makes 0.3 N of 1 N and 1 J."""
    judge = Convergence(1e-9, 0.0)
    judge.accept(1.0, 1.0)
    judge.measure(stiffness=0.3 / EPSILON, farthest=1.0)
    return judge


def test_a_residual_of_a_third_of_the_force_shows_no_balance(rounded: Convergence) -> None:
    residual = {"residual": 0.29, "force": 1.0, "energy": 1.0}
    for decrement in (np.inf, 1e-4):
        assert rounded.reason(**residual, decrement=decrement) is None
    assert rounded.reason(**residual, decrement=1e-10) is not None
    assert rounded.reason(**{**residual, "residual": 0.31}, decrement=1e-10) is None


def test_rounding_far_below_the_force_ends_a_solve_without_another_step() -> None:
    judge = Convergence(1e-9, 0.0)
    judge.accept(1.0, 1.0)
    judge.measure(stiffness=1e-6 / EPSILON, farthest=1.0)
    for residual, ends in ((9e-7, True), (2e-6, False)):
        found = judge.reason(residual, force=1.0, decrement=np.inf, energy=1.0)
        assert (found is not None) is ends


def test_the_rounding_error_of_a_potential_is_that_of_a_sum_and_hides_no_step_of_newton() -> None:
    tolerance = 1e-9
    judge = Convergence(tolerance, 0.0)
    parts = np.random.default_rng(1).uniform(0, 1, 10**6)
    total = fsum(parts)
    rounding = max(abs(float(np.cumsum(p)[-1]) - total) for p in (parts, parts[::-1]))
    assert 0 < rounding < judge.energy_roundoff(total) < tolerance * total


@pytest.mark.slow
def test_degrees_agree_on_slivers_at_corners() -> None:
    """Fibres that nearly follow an edge: by rounding, forces of degree 5 were 5 % off."""
    document: dict[str, Any] = {
        "sheet": {"length": 0.02578, "width": 0.09474, "fibres": ["-1.4 deg", "-91.4 deg"]},
        "effects": {
            "stretch": {"stiffness": 1.078e4},
            "shear": {"stiffness": 13.39},
            "bending": {"stiffness": 3.767e-4},
        },
        "boundary": {
            "left": {"clamp": "rotation"},
            "right": {"displacement": [0, "program"], "rotation": "held"},
        },
        "program": {"type": "ramp", "to": 8.6e-4, "duration": "1 s", "steps": 1},
        "discretisation": {"mesh_size": 0.0129},
    }
    case = Case(**document)
    sheet = sheet_of(case, MPI.COMM_SELF)
    forces = [response_of(with_elements(case, degree=p), sheet).forces[-1] for p in (4, 5)]
    assert forces[1] == pytest.approx(forces[0], rel=2e-3)
