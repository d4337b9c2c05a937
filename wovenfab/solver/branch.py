"""Where stability is lost: the mode, and the way from the saddle to a minimum beside it."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.model.model import Model
from wovenfab.solver.admissible import SHARE
from wovenfab.solver.controls import Outcome
from wovenfab.solver.equilibrium import Equilibrium
from wovenfab.solver.inertia import bounds

#: Largest displacement with which a saddle is left, over the size of the sheet.
FARTHEST = 0.1
#: How often it is halved in search of the lowest potential.
HALVINGS = 30


def softest_mode(model: Model, equilibrium: Equilibrium) -> NDArray[np.float64]:
    """Return the direction in which the model's present field is softest; collective.

    Returns:
        Displacement at this rank's unknowns, ghosts included; its largest component is 1 m.
    """
    step = equilibrium.barrier.step
    own = equilibrium.inertia.mode()
    largest = model.comm.allreduce(float(np.abs(own).max(initial=0.0)), op=MPI.MAX)
    step.x.array[: len(own)] = own / largest
    step.x.scatter_forward()
    return np.array(step.x.array)


def leave_saddle(model: Model, equilibrium: Equilibrium, mode: NDArray[np.float64]) -> Outcome:
    """Move the field along a mode to the lowest potential there, and solve from there.

    Args:
        model: The model, whose field is a saddle.
        equilibrium: Its solver, which must go down where the tangent is indefinite.
        mode: As :func:`softest_mode` returned it.
    """
    field, step = model.field, equilibrium.barrier.step
    step.x.array[:] = mode
    low, high = bounds(model.placements)
    farthest = min(FARTHEST * float(np.max(high - low)), SHARE * equilibrium.barrier.limit())
    saddle = field.x.array.copy()
    lengths = farthest * 0.5 ** np.arange(HALVINGS)
    energies = []
    for length in lengths:
        field.x.array[:] = saddle + length * mode
        energies.append(equilibrium.energy())
    field.x.array[:] = saddle + lengths[int(np.nanargmin(energies))] * mode
    return equilibrium.solve()
