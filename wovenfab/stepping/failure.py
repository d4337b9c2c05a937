"""Steps that could not be made, told so that a user knows what to do."""

from __future__ import annotations

from wovenfab.solver.controls import Outcome
from wovenfab.solver.diagnosis import Diagnosis


class StepFailedError(Exception):
    """No equilibrium even for the smallest step; the last state has been restored.

    Attributes:
        time: Time that was not reached, s.
        displacement: Displacement that was not reached, m.
        step: Length of the smallest step tried, s.
        outcome: How the last attempt ended.
        cutbacks: Rejected attempts since the last accepted step.
        diagnosis: Worst point, probable cause and remedy, where they are known.
    """

    def __init__(
        self,
        time: float,
        displacement: float,
        step: float,
        outcome: Outcome,
        cutbacks: int,
        diagnosis: Diagnosis | None = None,
    ) -> None:
        """Say where and why."""
        why = f". {diagnosis}" if diagnosis else ""
        super().__init__(
            f"no equilibrium at t = {time:.6g} s (displacement {1e3 * displacement:.6g} mm) even "
            f"with a step of {step:.3g} s: {outcome.reason} after {outcome.iterations} iterations, "
            f"residual {outcome.residual:.3g} N{why}"
        )
        self.time, self.displacement, self.step = time, displacement, step
        self.outcome, self.cutbacks, self.diagnosis = outcome, cutbacks, diagnosis


class StartFailedError(StepFailedError):
    """No equilibrium from which the program could start; ``step`` is a share of the loads."""

    def __str__(self) -> str:
        """Say under how much and why."""
        found = self.outcome
        reason = (
            f"it would not be stable ({found.negatives} negative eigenvalues)"
            if found.converged
            else f"{found.reason} after {found.iterations} iterations, residual "
            f"{found.residual:.3g} N"
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
