"""Figures that are measured, and what they must not miss."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Figure:
    """A measured figure with its limit.

    Attributes:
        name: What was measured, in a few words.
        value: In ``unit``.
        limit: In ``unit``.
        unit: Such as ``"s"``; ``"x"`` for a ratio.
        meaning: How it was measured, in a sentence.
        at_least: Whether the limit is the least value, or the largest.
    """

    name: str
    value: float
    limit: float
    unit: str
    meaning: str
    at_least: bool = False

    @property
    def kept(self) -> bool:
        """Whether the limit is kept."""
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    def __str__(self) -> str:
        """Return the figure in two lines."""
        bound = "at least" if self.at_least else "at most"
        verdict = "kept" if self.kept else "MISSED"
        value = f"{self.value:.3g} {self.unit}, {bound} {self.limit:g} {self.unit}: {verdict}"
        return f"{self.name}: {value}\n    {self.meaning}"


#: Measures, prints what it likes and returns its figures.
Section = Callable[[], Sequence[Figure]]
