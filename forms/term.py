"""An effect in a scene: with its values, and with a weight by which its share is told."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .effect import Effect, Values


@dataclass(frozen=True)
class Term:
    """An effect of the scene with its parameter values.

    Attributes:
        effect: The effect.
        values: UFL scalars by parameter name (a pair where it is per family).
        weight: UFL scalar that multiplies the term in :meth:`Balance.potential` and
            :meth:`Balance.power` (and nowhere else), so that one compiled form can
            give each effect's share.
    """

    effect: Effect
    values: Values
    weight: Any
