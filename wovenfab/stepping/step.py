"""Steps: what one has come to, why one fails, and how long the next one is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil, inf
from typing import TYPE_CHECKING, Any

from wovenfab.model.memory import attributes, take_attributes
from wovenfab.solver.problem import SolveResult
from wovenfab.stepping.program import SAME, Milestone
from wovenfab.stepping.stability import StabilityLoss

if TYPE_CHECKING:
    from wovenfab.solver.diagnosis import Diagnosis
    from wovenfab.stepping.schemes import StepError
    from wovenfab.stepping.sensitivity import Derivatives


@dataclass(frozen=True)
class Step:
    """An accepted step.

    Attributes:
        number: 0 for the initial state.
        time, displacement: At its end, s and m.
        reactions: Force (N; x, y) that each held edge exerts on the sheet.
        stored: Stored energy (J) by effect.
        dissipated: Energy dissipated since the start (J) by effect.
        work: External work since the start, J.
        iterations: Newton iterations, those of rejected attempts not counted.
        cutbacks: Rejected attempts before it since the last accepted step.
        milestone: The planned time that it reaches, or None on the way to it.
        negatives: Negative eigenvalues of the tangent; none where the state is a minimum.
        force, force_transverse: Force that is conjugate to the program, and that across it, N
            (:meth:`~wovenfab.model.constraints.Constraints.conjugate`).
        force_error: Estimated error of ``force`` by the time step, N.
        loss: The loss of stability since the last step, beyond which it lies, or None.
        error: Its estimated error in time, where that is measured.
        dissipated_error: Of all dissipated energy since the start by the errors of steps, J.
        derivatives: By material parameters, where they are asked for.
        second: Displacement of the second program at its end, m.
    """

    number: int
    time: float
    displacement: float
    reactions: dict[str, tuple[float, float]]
    stored: dict[str, float]
    dissipated: dict[str, float]
    work: float
    iterations: int
    cutbacks: int
    milestone: Milestone | None
    negatives: int = 0
    loss: StabilityLoss | None = None
    error: StepError | None = None
    dissipated_error: float = 0.0
    derivatives: Derivatives | None = None
    second: float = 0.0
    force: float = 0.0
    force_transverse: float = 0.0
    force_error: float = 0.0


class StepFailedError(Exception):
    """No equilibrium even for the smallest step; the last state has been restored.

    Attributes:
        time: Time that was not reached, s.
        displacement: Displacement that was not reached, m.
        step: Length of the smallest step tried, s.
        result: How the last attempt ended.
        cutbacks: Rejected attempts since the last accepted step.
        diagnosis: Worst point, probable cause and remedy, where they are known.
        second: Displacement of the second program, which was not reached either, m.
    """

    def __init__(
        self,
        time: float,
        displacement: float,
        step: float,
        result: SolveResult,
        cutbacks: int,
        diagnosis: Diagnosis | None = None,
        second: float = 0.0,
    ) -> None:
        """Say where and why."""
        why = f". {diagnosis}" if diagnosis else ""
        beside = f", of the second program {1e3 * second:.6g} mm" if second else ""
        super().__init__(
            f"no equilibrium at t = {time:.6g} s (displacement {1e3 * displacement:.6g} mm"
            f"{beside}) even with a step of {step:.3g} s: {result.reason} after "
            f"{result.iterations} iterations, residual {result.residual:.3g} N{why}"
        )
        self.time, self.displacement, self.second, self.step = time, displacement, second, step
        self.result, self.cutbacks, self.diagnosis = result, cutbacks, diagnosis


class StartFailedError(StepFailedError):
    """No equilibrium from which the program could start; ``step`` is a share of the loads."""

    def __str__(self) -> str:
        """Say under how much and why."""
        result = self.result
        reason = (
            f"it would not be stable ({result.negatives} negative eigenvalues)"
            if result.converged
            else f"{result.reason} after {result.iterations} iterations, residual "
            f"{result.residual:.3g} N"
        )
        return (
            f"no equilibrium at the start, even with steps of {self.step:.3g} of the forces and "
            f"displacements that are there from the start: {reason}"
        )


class UnsoundSheetError(StepFailedError):
    """The sheet is unstable at rest, so that no equilibrium means anything."""

    def __str__(self) -> str:
        """Say why."""
        return f"the sheet at rest is not stable, so that no step can be trusted. {self.diagnosis}"


#: Share of its length that is left of a failed step, and growth after easy ones.
CUT, GROWTH = 0.5, 2.0
#: Tangents up to which a step is easy, and harder ones in a row after which steps grow, too.
EASY, ENOUGH = 3, 5
#: What a later step depends on.
MEMORY = "_length", "_before", "_row", "_target"


class StepSizeControl:
    """The length of steps between planned times, which are always hit.

    A planned step is made whole unless the last ones had to be cut: the shorter length is
    kept beyond the planned time, so that a difficult part of the program does not begin with
    the same failures at each of its steps, and is doubled again where steps converge.
    """

    def __init__(self, smallest: float) -> None:
        """Begin with whole steps.

        Args:
            smallest: Share of a planned step below which cutting ends.
        """
        self._smallest = smallest
        self._length = self._before = inf
        self._row = 0
        self._target = -inf  # of a bisection, s

    def snapshot(self) -> dict[str, Any]:
        """Return the present lengths."""
        return attributes(self, *MEMORY)

    def resume(self, snapshot: Mapping[str, Any]) -> None:
        """Go on with the lengths of a snapshot."""
        take_attributes(self, snapshot, *MEMORY)

    def next(self, now: float, end: float) -> float:
        """Return the time (s) to step to from ``now``, on the way to the planned ``end``."""
        if -inf < self._target <= now:
            self.bracketed(self._before)
        left = end - now
        number = max(1, ceil(left / self._length - SAME))
        return end if number == 1 else now + left / number

    def accepted(self, length: float, iterations: int) -> None:
        """Grow after an accepted step of ``length`` (s), if its number of iterations allows."""
        self._row += 1
        if self._target == -inf and (iterations <= EASY or self._row >= ENOUGH):
            self._length = max(self._length, GROWTH * length)
            self._row = 0

    def reduce(self, length: float, planned: float) -> bool:
        """Cut after a failed step; return whether the shorter one may be tried.

        Args:
            length: Of the failed step, s.
            planned: Length of the planned step, s.
        """
        self._length, self._row = CUT * length, 0
        return self._length >= self._smallest * planned

    def limit(self, length: float) -> None:
        """Take steps of at most ``length`` (s) next, for their error; not in a bisection."""
        if self._target == -inf:
            self._length, self._row = length, 0

    def bisect(self, until: float, length: float) -> None:
        """Begin or continue a bisection towards ``until`` (s), where a step of ``length`` led.

        Steps do not grow before it has ended.
        """
        if self._target == -inf:
            self._before = self._length
        self._target, self._length = until, CUT * length

    def grow(self, length: float) -> None:
        """Try twice a ``length`` (s) next."""
        self._length = GROWTH * length

    def bracketed(self, length: float) -> None:
        """End a bisection; grow again from a ``length`` (s)."""
        self._length, self._target, self._row = length, -inf, 0
