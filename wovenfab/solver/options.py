"""How equilibrium is sought, and how a search ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class SolverOptions:
    """How equilibrium is sought.

    Attributes:
        max_iterations: Newton iterations after which a step is given up.
        tolerance: Residual force over the largest internal force met so far.
        options: PETSc options, such as ``{"snes_monitor": None}``.
        step_limit: Keep iterates admissible; only a test switches it off.
        line_search: Backtrack on the potential; only a test switches it off.
        keep_from: Solutions that a factorisation must be worth before the factor of an earlier
            tangent is used; infinite for never.
        descend: Step downwards where the tangent is indefinite.
        seed: Of the random field that decides between the branches at a bifurcation.
    """

    max_iterations: int = 25
    tolerance: float = 1e-9
    options: Mapping[str, Any] | None = None
    step_limit: bool = True
    line_search: bool = True
    keep_from: float = 10.0
    descend: bool = False
    seed: int = 0


@dataclass(frozen=True)
class SolveResult:
    """How a solve ended.

    Attributes:
        converged: Whether equilibrium was found.
        reason: PETSc's name of the reason.
        iterations: Newton iterations.
        residual: Norm of the residual force, N.
        negatives: Number of negative eigenvalues of the tangent at the solution; it is a
            minimum of the incremental potential if there is none.
        tangents: Number of iterations that formed one, which takes most of the time.
    """

    converged: bool
    reason: str
    iterations: int
    residual: float
    negatives: int = 0
    tangents: int = 0
