"""What is known of an accepted step."""

from __future__ import annotations

from dataclasses import dataclass

from wovenfab.stepping.embedded import StepError
from wovenfab.stepping.program import Milestone
from wovenfab.stepping.stability import Loss


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
    loss: Loss | None = None
    error: StepError | None = None
    dissipated_error: float = 0.0
