"""Figures as standards define them: ``figures.json``, ``figures.csv`` and the curves of tests.

A laboratory states its figures in units of its own: gf, cm, deg and per cent. Files have both.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import isfinite, pi
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.constants import g

from wovenfab.record.reading import damaged, read_object
from wovenfab.record.results import FIGURES, FIGURES_TABLE, rows_of, write_csv, write_whole

if TYPE_CHECKING:
    from wovenfab.record.loop import Loop

Values = NDArray[np.float64]
#: Columns of ``history.csv``.
Columns = Mapping[str, Values]
#: Force per width of 1 gf/cm, N/m; work per area of 1 gf·cm/cm^2, J/m^2; g is standard gravity.
GF_PER_CM = 1e-3 * g / 1e-2
#: Unit of a laboratory for each unit of a figure, and its size in that.
LABORATORY: Mapping[str, tuple[str, float]] = {
    "N/(m·rad)": ("gf/(cm·deg)", GF_PER_CM * 180 / pi),
    "N/m": ("gf/cm", GF_PER_CM),
    "J/m^2": ("gf·cm/cm^2", GF_PER_CM),
    "rad": ("deg", pi / 180),
    "m/m": ("%", 1e-2),
    "J/J": ("%", 1e-2),
    "1": ("1", 1.0),
}


#: Units of pure numbers.
PURE = ("m/m", "J/J", "1")


def laboratory(value: float, unit: str) -> tuple[float, str]:
    """Return a value of a unit of :data:`LABORATORY` in the unit of laboratories, and that unit."""
    name, size = LABORATORY[unit]
    return value / size, name


@dataclass(frozen=True)
class Figure:
    """A figure of a standard test.

    Attributes:
        value: In ``unit``; None where the test does not determine it.
        unit: SI unit, of :data:`LABORATORY`.
        definition: What it is, in a sentence.
    """

    value: float | None
    unit: str
    definition: str

    @property
    def laboratory_unit(self) -> str:
        """The unit in which laboratories state it."""
        return LABORATORY[self.unit][0]

    @property
    def laboratory_value(self) -> float | None:
        """The value in that unit."""
        return None if self.value is None else laboratory(self.value, self.unit)[0]

    def as_dict(self) -> dict[str, Any]:
        """Return it as in the files, without its name."""
        return {
            "value": self.value,
            "unit": self.unit,
            "laboratory_value": self.laboratory_value,
            "laboratory_unit": self.laboratory_unit,
            "definition": self.definition,
        }


#: Figures by name.
Figures = Mapping[str, Figure]


class StandardTest(Protocol):
    """A test whose figures a standard defines.

    Attributes:
        name: As in ``figures`` of a case.
    """

    name: ClassVar[str]

    def loop(self, history: Columns) -> Loop:
        """Return the loop of force against strain or angle of which its figures are read."""

    def figures(self, history: Columns) -> dict[str, Figure]:
        """Return its figures by name, from the columns of ``history.csv``."""

    def curve(self, history: Columns) -> dict[str, Values]:
        """Return the curve that it plots, a value a step; NaN where there is none."""


def figure(value: float, unit: str, definition: str) -> Figure:
    """Return a figure; NaN becomes None."""
    return Figure(float(value) if isfinite(value) else None, unit, definition)


def figures_of(tests: Iterable[StandardTest], history: Columns) -> dict[str, dict[str, Figure]]:
    """Return the figures of each test by its name; none before the first step."""
    started = len(history["step"]) > 0
    return {test.name: test.figures(history) for test in tests if started}


def figures_at_rest(test: StandardTest) -> dict[str, Figure]:
    """Return the figures of a test by name before it has begun: their units, mostly no values."""
    rest = np.zeros(1)
    return test.figures(columns_of(rest, rest, rest))


def columns_of(displacement: Values, force: Values, work: Values) -> Columns:
    """Return the columns of ``history.csv`` of which figures without a zone are made.

    Args:
        displacement: Of the program, m, shape (steps,).
        force: Conjugate to it, N, same shape.
        work: External work since the start, J, same shape.
    """
    steps = np.arange(len(force), dtype=np.float64)
    return {"step": steps, "displacement_m": displacement, "force_N": force, "work_J": work}


def write_figures(directory: Path, tests: Iterable[StandardTest], history: Columns) -> None:
    """Write ``figures.json``, ``figures.csv`` and a table of the curve of each test; on one rank.

    Nothing is written without a test.
    """
    tests = tuple(tests)
    found = figures_of(tests, history)
    if not found:
        return
    plain = {name: {k: f.as_dict() for k, f in of.items()} for name, of in found.items()}
    write_whole(directory / FIGURES, json.dumps(plain, indent=2, ensure_ascii=False) + "\n")
    rows = [
        {"test": test, "name": name, **values}
        for test, figures in plain.items()
        for name, values in figures.items()
    ]
    write_csv(directory / FIGURES_TABLE, rows)
    for test in tests:
        columns = {name: history[name] for name in ("step", "time_s")} | test.curve(history)
        write_csv(directory / f"{test.name}.csv", [_row(row) for row in rows_of(columns)])


def read_figures(directory: str | Path) -> dict[str, dict[str, Figure]]:
    """Return the figures of each test by its name; none if there is no file.

    Raises:
        UnreadableResultsError: It is damaged, or not written by wovenfab.
    """
    path = Path(directory) / FIGURES
    try:
        content = read_object(path)
    except FileNotFoundError:
        return {}
    try:
        return {
            test: {name: _read(**values) for name, values in figures.items()}
            for test, figures in content.items()
        }
    except (TypeError, AttributeError, ValueError) as error:
        raise damaged(path, f"these are no figures ({error})") from None


def _read(value: float | None, unit: str, definition: str, **_: object) -> Figure:
    """Return a figure of a file.

    Raises:
        ValueError: A value has another type, or the unit is unknown.
    """
    if unit not in LABORATORY or not isinstance(definition, str):
        raise ValueError("a unit or a definition is unknown")
    if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
        raise ValueError("a value is no number")
    return Figure(value, unit, definition)


def _row(row: Mapping[str, float]) -> dict[str, str]:
    """Return a row of a curve as texts: whole numbers for steps, nothing where there is none."""
    texts = {name: "" if np.isnan(value) else repr(float(value)) for name, value in row.items()}
    return texts | {"step": str(int(row["step"]))}
