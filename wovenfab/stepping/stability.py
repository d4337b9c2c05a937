"""Where an equilibrium is no minimum: stop, follow the branch from the saddle, or ignore."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.sheet.narrow import FlatCell, flattest_cell
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.solver.globalisation import CROSSING_SHARE
from wovenfab.solver.problem import SolveResult
from wovenfab.solver.tangent_spectrum import bounding_box

#: Largest displacement with which a saddle is left, over the size of the sheet.
FARTHEST = 0.1
#: How often it is halved in search of the lowest potential.
MODE_HALVINGS = 30


def softest_mode(solver: EquilibriumSolver) -> NDArray[np.float64]:
    """Return the direction in which the model's present field is softest; collective.

    Returns:
        Displacement at this rank's unknowns, ghosts included; its largest component is 1 m.
    """
    model = solver.problem.model
    own = solver.spectrum.mode()
    largest = model.comm.allreduce(float(np.abs(own).max(initial=0.0)), op=MPI.MAX)
    mode = fem.Function(model.space)
    mode.x.array[: len(own)] = own / largest
    mode.x.scatter_forward()
    return np.array(mode.x.array)


def leave_saddle(solver: EquilibriumSolver, mode: NDArray[np.float64]) -> SolveResult:
    """Move the field along a mode to the lowest potential there, and solve from there.

    Args:
        solver: Solver of the problem, whose field is a saddle; it must go down where the
            tangent is indefinite.
        mode: As :func:`softest_mode` returned it.
    """
    problem, field = solver.problem, solver.problem.model.field
    low, high = bounding_box(problem.model.placements)
    farthest = min(
        FARTHEST * float(np.max(high - low)), CROSSING_SHARE * solver.crossing.limit(mode)
    )
    saddle = field.x.array.copy()
    lengths = farthest * 0.5 ** np.arange(MODE_HALVINGS)
    energies = []
    for length in lengths:
        field.x.array[:] = saddle + length * mode
        energies.append(problem.energy())
    field.x.array[:] = saddle + lengths[int(np.nanargmin(energies))] * mode
    return solver.solve()


Treatment = Literal["stop", "follow", "ignore"]
#: A loss is found once the forces on both sides of it agree to this, relative, ...
SAME_FORCE = 1e-3
#: ... or the steps have come down to this share of a planned one.
SHORTEST_STEP = 2.0**-30


@dataclass(frozen=True)
class StabilityLoss:
    """Where stability is lost: between a minimum and the saddle next to it.

    Attributes:
        time, displacement: Of the minimum, s and m.
        step, increment: From there to the saddle, s and m.
        reactions: Force (N; x, y) at each held edge at the minimum.
        force: Force that is conjugate to the program there, N.
        negatives: Number of negative eigenvalues of the tangent at the saddle.
        saddle: Displacement of all unknowns there, m.
        mode: Direction in which the energy falls most; its largest component is 1 m.
        second: Displacement of the second program at the minimum, m.
    """

    time: float
    displacement: float
    step: float
    increment: float
    reactions: dict[str, tuple[float, float]]
    force: float
    negatives: int
    saddle: NDArray[np.float64]
    mode: NDArray[np.float64]
    second: float = 0.0

    def __str__(self) -> str:
        """Say where, how well it is known, and at which load."""
        known = f"known to {1e3 * abs(self.increment):.1g} mm"
        beside = f"; of the second program {1e3 * self.second:.6g} mm" if self.second else ""
        return (
            f"the sheet loses its stability at t = {self.time:.6g} s (displacement "
            f"{1e3 * self.displacement:.6g} mm, {known}{beside}) under a force of "
            f"{abs(self.force):.6g} N"
        )


class StabilityLostError(Exception):
    """No minimum beyond the last accepted state, which has been restored.

    Attributes:
        loss: Where.
        cutbacks: Rejected attempts since the last accepted step.
    """

    def __init__(self, loss: StabilityLoss, remedy: str, cutbacks: int) -> None:
        """Say where and what can be done."""
        super().__init__(f"{loss}; {remedy}")
        self.loss, self.cutbacks = loss, cutbacks


class Stability:
    """Ensures that accepted states are minima, as far as a case asks for that.

    Attributes:
        loss: The loss that was located and not yet passed, or None.
    """

    def __init__(self, solver: EquilibriumSolver, treatment: Treatment) -> None:
        """Start without a loss."""
        self._solver, self._problem, self._treatment = solver, solver.problem, treatment
        self.loss: StabilityLoss | None = None
        self._flattest: FlatCell | None = None

    @property
    def follows(self) -> bool:
        """Whether the run goes on along the branch."""
        return self._treatment == "follow"

    def refuses(self, result: SolveResult) -> bool:
        """Return whether an result is a saddle that must not be accepted."""
        return result.converged and result.negatives > 0 and self._treatment != "ignore"

    def is_close(self, force: NDArray[np.float64], share: float, smallest: float) -> bool:
        """Return whether a refused saddle is so near to the last minimum that it tells where.

        Args:
            force: Internal force of the last minimum at own unknowns, N.
            share: Length of the step to the saddle over that of the planned one.
            smallest: Share below which steps need not be cut.
        """
        if self.loss is not None or share <= SHORTEST_STEP:
            return True
        before, now = (self._resultants(f) for f in (force, self._problem.force))
        change = float(np.abs(now - before).max())
        return share < 2 * smallest and change <= SAME_FORCE * float(np.abs(now).max())

    def leave(
        self, now: tuple[float, float], until: tuple[float, float], force: NDArray[np.float64],
        conjugate: float, result: SolveResult, second: float = 0.0,
    ) -> SolveResult:  # fmt: skip
        """Note the loss and go from the saddle to a minimum, if that is wanted.

        Args:
            now: Time (s) and displacement (m) of the last minimum.
            until: The same of the saddle.
            force: Internal force of the last minimum at own unknowns, N.
            conjugate: Force that is conjugate to the program there, N.
            result: That of the saddle.
            second: Displacement of the second program at the last minimum, m.
        """
        if self.loss is None:
            self.loss = StabilityLoss(
                *now,
                step=until[0] - now[0],
                increment=until[1] - now[1],
                reactions=self._problem.constraints.reactions(force),
                force=conjugate,
                negatives=result.negatives,
                saddle=self._problem.model.field.x.array.copy(),
                mode=softest_mode(self._solver),
                second=second,
            )
            self._flattest = flattest_cell(self._problem.model.sheet.mesh)
        if self.follows:
            return leave_saddle(self._solver, self.loss.mode)
        return result

    def passed(self) -> StabilityLoss | None:
        """Return the loss that an accepted minimum lies beyond, and forget it."""
        loss, self.loss = self.loss, None
        return loss

    def error(self, cutbacks: int) -> StabilityLostError:
        """Return the error that ends the run after so many rejected attempts."""
        assert self.loss is not None
        remedy = (
            "no minimum was found beyond; take smaller steps"
            if self.follows
            else "solver.stability=follow goes on along the branch"
        )
        if self._flattest is not None and self._flattest.is_too_flat:
            remedy = (
                f"rounding errors may be the cause: {self._flattest}; remove the narrow place from "
                f"the geometry ('wovenfab check' names it); otherwise {remedy}"
            )
        return StabilityLostError(self.loss, remedy, cutbacks)

    def _resultants(self, force: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.array(list(self._problem.constraints.reactions(force).values()))
