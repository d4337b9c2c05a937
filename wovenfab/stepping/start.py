"""The state in which a program begins: at rest under what is there from the start."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from mpi4py import MPI

from wovenfab.model.constraints import Constraints
from wovenfab.model.model import Model
from wovenfab.solver.controls import Outcome
from wovenfab.solver.equilibrium import Equilibrium
from wovenfab.stepping.failure import StartFailedError


def prescribe(model: Model, constraints: Constraints, program: float, share: float = 1.0) -> None:
    """Prescribe placements and dead loads for a program value (m), or a share of them."""
    constraints.set(program, share)
    model.loading.set(program, share)


def settle(
    model: Model,
    constraints: Constraints,
    equilibrium: Equilibrium,
    program: float,
    smallest: float,
    refuses: Callable[[Outcome], bool],
) -> tuple[Outcome | None, int]:
    """Bring a model from its reference state to rest under a program value; collective.

    Friction carries nothing at rest and is left out, so that none is lost on the way,
    which is gone in one step or, where that fails, in smaller ones.

    Args:
        model: The model in its reference state.
        constraints: Its prescribed placements.
        equilibrium: Its solver.
        program: The program's first value, m.
        smallest: Share of what is prescribed below which stepping ends.
        refuses: Whether an equilibrium must not be taken, since it is no minimum.

    Returns:
        How it was found, with all iterations and tangents, or None where nothing acts; and the
        number of rejected attempts.

    Raises:
        StartFailedError: If there is no such state; the model is as it was at the last
            share that could be reached.
    """
    prescribe(model, constraints, program)
    loaded = model.comm.allreduce(bool(model.loading.force().any()), op=MPI.LOR)
    if not loaded and not constraints.unmet(model.field):
        return None, 0
    field = model.field.x.array
    share, step, iterations, tangents, rejected = 0.0, 1.0, 0, 0, 0
    model.friction.value = 0.0
    try:
        while share < 1:
            reached = field.copy()
            model.last.x.array[:] = reached
            prescribe(model, constraints, program, share + step)
            outcome = equilibrium.solve()
            if outcome.converged and not refuses(outcome):
                share += step
                iterations += outcome.iterations
                tangents += outcome.tangents
                continue
            field[:] = reached
            rejected += 1
            if step / 2 < smallest:
                raise StartFailedError(0.0, program, step, outcome, rejected)
            step /= 2
    finally:
        model.friction.value = 1.0
    return replace(outcome, iterations=iterations, tangents=tangents), rejected
