"""An accepted step, and why one could not be made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from wovenfab.solver.problem import SolveResult
from wovenfab.stepping.program import Milestone
from wovenfab.stepping.stability import StabilityLoss

if TYPE_CHECKING:
    from wovenfab.solver.diagnosis import Diagnosis
    from wovenfab.stepping.time_error import StepError


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
        tangents: Number of its iterations that formed a tangent.
        force, force_transverse: Force of the driven edge along its motion and across it, N.
        force_error: Estimated error of ``force`` by the time step, N.
        loss: The loss of stability since the last step, beyond which it lies, or None.
        error: Its estimated error in time, where that is measured.
        dissipated_error: Of all dissipated energy since the start by the errors of steps, J.
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
    tangents: int = 0
    loss: StabilityLoss | None = None
    error: StepError | None = None
    dissipated_error: float = 0.0
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
    """

    def __init__(
        self,
        time: float,
        displacement: float,
        step: float,
        result: SolveResult,
        cutbacks: int,
        diagnosis: Diagnosis | None = None,
    ) -> None:
        """Say where and why."""
        why = f". {diagnosis}" if diagnosis else ""
        super().__init__(
            f"no equilibrium at t = {time:.6g} s (displacement {1e3 * displacement:.6g} mm) even "
            f"with a step of {step:.3g} s: {result.reason} after {result.iterations} iterations, "
            f"residual {result.residual:.3g} N{why}"
        )
        self.time, self.displacement, self.step = time, displacement, step
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
