"""A law that is a table: forces against strains, as measured, with a smooth curve between them.

The curve is a monotone piecewise cubic of the force (Fritsch, Carlson, SIAM J. Numer. Anal. 1980),
so that the stored energy is piecewise quartic with continuous second derivatives. Beyond the table
the force goes on along its tangent. A form has the coefficients of the pieces as constants: tables
of as many rows share kernels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite
from typing import Any

import ufl

#: Key of a table among the values of an effect.
TABLE = "table"
#: What a piece is made of: the strain where it starts, and the energy (J/m^2) and its first four
#: derivatives by the strain there.
COEFFICIENTS = 6


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        name: Its name in files.
        unit: SI unit, as of a parameter.
        meaning: A few words.
    """

    name: str
    unit: str
    meaning: str


@dataclass(frozen=True)
class TableParameter:
    """The table that a law takes.

    Attributes:
        strain: What the energy depends on.
        force: The derivative of the energy by it.
        per_family: Whether the two families may have different tables.
    """

    strain: Column
    force: Column
    per_family: bool = False

    @property
    def columns(self) -> tuple[Column, Column]:
        """Both columns in their order."""
        return self.strain, self.force

    @property
    def meaning(self) -> str:
        """What the table is, in a sentence without its end."""
        columns = (f"{c.name} ({c.meaning}, {c.unit})" for c in self.columns)
        return f"a table of {' and '.join(columns)}"


class ForceTableError(ValueError):
    """Rows that are no law.

    Attributes:
        row: Number of the row, from 0, as given; None for all of them.
        column: Number of the column, 0 or 1.
        rule: What it must do.
        remedy: What would be right, in full sentences.
    """

    def __init__(self, row: int | None, column: int, rule: str, remedy: str = "") -> None:
        """Keep them."""
        where = "" if row is None else f" in row {row + 1}"
        super().__init__(f"the {('strain', 'force')[column]}{where} {rule}")
        self.row, self.column, self.rule, self.remedy = row, column, rule, remedy


@dataclass(frozen=True)
class ForceTable:
    """Forces against strains in SI units, for one sign: the curve is continued to the other.

    Attributes:
        strains: Strictly increasing, from zero, which is added if it is not there.
        forces: The same, one for each strain.
    """

    strains: tuple[float, ...]
    forces: tuple[float, ...]

    def __post_init__(self) -> None:
        """Check the rows, and begin with that at rest.

        Raises:
            ForceTableError: They are no law of a stable sheet.
        """
        strains, forces = (tuple(map(float, column)) for column in (self.strains, self.forces))
        _require_law(strains, forces)
        if strains[0]:
            strains, forces = (0.0, *strains), (0.0, *forces)
        object.__setattr__(self, "strains", strains)
        object.__setattr__(self, "forces", forces)


_STABLE = "Where a force falls the sheet is unstable: leave the row out, or smooth the table."
_ORDER = "Sort the rows, and keep one of those with the same strain."


def _require_law(strains: tuple[float, ...], forces: tuple[float, ...]) -> None:
    if len(strains) != len(forces):
        raise ForceTableError(None, 1, f"has {len(forces)} values for {len(strains)} strains")
    for number, column in enumerate((strains, forces)):
        for row, value in enumerate(column):
            if not isfinite(value) or value < 0:
                raise ForceTableError(row, number, "must be finite and not negative")
    if forces and strains[0] == 0 and forces[0] != 0:
        raise ForceTableError(0, 1, "must be zero at rest", "Take it from all forces.")
    if not any(strains):
        raise ForceTableError(None, 0, "must have one value above zero at least")
    first = () if strains[0] == 0 else (0.0,)
    for number, (column, remedy) in enumerate(((strains, _ORDER), (forces, _STABLE))):
        for row, (before, now) in enumerate(pairwise((*first, *column)), start=1 - len(first)):
            if now <= before:
                raise ForceTableError(row, number, "must increase", remedy)


def table_energy(strain: Any, pieces: Any) -> Any:
    """Return the stored energy (J/m^2) of a tabulated law.

    Args:
        strain: A scalar.
        pieces: Their coefficients, shape (pieces, ``COEFFICIENTS``). The first piece has all
            strains below the second, the last one all from its start on.
    """
    start, *derivatives = _select(strain, pieces)
    growth, energy = strain - start, ufl.as_ufl(0.0)
    for order in range(len(derivatives), 0, -1):  # a Taylor polynomial by Horner's rule
        energy = derivatives[order - 1] + growth / order * energy
    return energy


def _select(strain: Any, pieces: Any) -> list[Any]:
    """Return the coefficients of the piece in which a strain is.

    They are selected, and no piece is evaluated but one: there is no sum in which large terms
    cancel, and derivatives are as small as those of one polynomial.
    """
    chosen = [pieces[0, j] for j in range(COEFFICIENTS)]
    for i in range(1, pieces.ufl_shape[0]):
        reached = ufl.ge(strain, pieces[i, 0])
        chosen = [ufl.conditional(reached, pieces[i, j], c) for j, c in enumerate(chosen)]
    return chosen


def least_slope(pieces: Sequence[Sequence[float]]) -> float:
    """Return the least slope of the force over all strains.

    Args:
        pieces: Numbers, as :func:`table_energy` takes them.
    """
    least: float = min(pieces[0][3], pieces[-1][3])
    for (start, _, _, slope, second, third), (end, *_) in pairwise(pieces[1:]):
        lowest = -second / third if third > 0 else 0.0  # from the start of the piece
        for growth in (0.0, end - start, min(max(lowest, 0.0), end - start)):
            least = min(least, slope + second * growth + third / 2 * growth**2)
    return least


def end_of_table(pieces: Any) -> tuple[Any, Any]:
    """Return the last strain of a table, and the slope of the force there."""
    last = pieces.ufl_shape[0] - 1
    return pieces[last, 0], pieces[last, 3]
