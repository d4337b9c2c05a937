"""A sentence of the paper, the numbers that speak for or against it, and the verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Measure:
    """One number, or a few that are compared.

    Attributes:
        what: What is measured.
        values: The numbers.
        shown: The numbers with units, as they are printed.
        asked: What the claim asks of them.
        holds: Whether they do that.
    """

    what: str
    values: tuple[float, ...]
    shown: str
    asked: str
    holds: bool


@dataclass(frozen=True)
class Claim:
    """A claim and its measures.

    Attributes:
        number: Its place in the list.
        figures: Where the paper shows it.
        sentence: What it says.
        measures: What was measured; all must hold.
        otherwise: Why it may not hold with what was chosen.
    """

    number: int
    figures: str
    sentence: str
    measures: tuple[Measure, ...]
    otherwise: str

    @property
    def holds(self) -> bool:
        """Whether all measures do what the claim asks."""
        return all(measure.holds for measure in self.measures)

    @property
    def verdict(self) -> str:
        """The verdict in words."""
        return "Holds." if self.holds else f"Does not hold. {self.otherwise}"

    def as_dict(self) -> dict[str, Any]:
        """Return the claim with its measures and verdict as plain data."""
        return asdict(self) | {"verdict": self.verdict}


def above(what: str, value: float, least: float, unit: str = "") -> Measure:
    """Return the measure that asks for more than ``least``; ``%`` shows parts of one."""
    return Measure(what, (value,), _shown(value, unit), f"> {_shown(least, unit)}", value > least)


def below(what: str, value: float, most: float, unit: str = "") -> Measure:
    """Return the measure that asks for less than ``most``."""
    return Measure(what, (value,), _shown(value, unit), f"< {_shown(most, unit)}", value < most)


def between(what: str, value: float, least: float, most: float, unit: str = "") -> Measure:
    """Return the measure that asks for something between two bounds."""
    asked = f"{_shown(least, unit)} to {_shown(most, unit)}"
    return Measure(what, (value,), _shown(value, unit), asked, least < value < most)


def falling(what: str, values: Sequence[float], unit: str = "", factor: float = 1.0) -> Measure:
    """Return the measure that asks that each value is below the one before.

    Args:
        what: What is measured.
        values: The numbers.
        unit: Their unit; ``%`` shows parts of one.
        factor: The last must even be below the first over this.
    """
    falls = all(b < a for a, b in pairwise(values))
    far = values[-1] < values[0] / factor
    asked = "falling" if factor == 1 else f"falling, to less than 1/{factor:g}"
    shown = ", ".join(_shown(value, unit) for value in values)
    return Measure(what, tuple(values), shown, asked, falls and far)


def digits(value: float) -> str:
    """Return a number with three digits, without an exponent."""
    return np.format_float_positional(value, 3, unique=False, fractional=False, trim="-")


def _shown(value: float, unit: str) -> str:
    if unit == "%":
        return f"{digits(100 * value)} %"
    return f"{digits(value)} {unit}".strip()
