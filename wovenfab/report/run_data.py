"""The times that tell most of a run: where each cycle turns, and where it ends.

What the pictures need from a results directory besides its history and fields.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from math import cos, sin
from pathlib import Path
from typing import Any

import numpy as np
import pint
from numpy.typing import NDArray
from ruamel.yaml import YAML

from wovenfab.record.fields import StoredFields
from wovenfab.record.history import read_history
from wovenfab.record.results import Provenance, of_summary, this_process
from wovenfab.record.summary import Cycle, cycles, read_summary
from wovenfab.report.style import MILLIMETRE


@dataclass(frozen=True)
class KeyTime:
    """A stored time.

    Attributes:
        index: Its place among the stored times.
        displacement: Displacement of the program then (m).
        words: Which one it is.
    """

    index: int
    displacement: float
    words: str


def largest(source: RunData, stored: StoredFields) -> KeyTime:
    """Return the stored time of largest displacement."""
    u = _displacement(source, stored)
    index = int(np.abs(u).argmax())
    return KeyTime(index, float(u[index]), f"at {_length(u[index])}")


def key_times(
    source: RunData, stored: StoredFields, most: int = 4
) -> list[tuple[KeyTime, KeyTime]]:
    """Return the reversal and the end of each cycle, as near as fields were stored.

    Args:
        source: The run; where it has no cycles, the whole run is taken for one.
        stored: Its fields, of one time at least.
        most: Number of cycles; if there are more, the first, the last and some between.
    """
    u = _displacement(source, stored)
    spans = [(f"cycle {i}", c.start, c.end) for i, c in enumerate(source.cycles, 1)]
    spans = spans or [("run", 0.0, float(stored.times[-1]))]
    if len(spans) > most:
        spans = [spans[round(i)] for i in np.linspace(0, len(spans) - 1, most)]
    slack = 1e-9 * stored.times[-1]
    found = []
    for name, start, end in spans:
        (inside,) = np.nonzero((stored.times >= start - slack) & (stored.times <= end + slack))
        if not len(inside):
            continue
        turn = inside[np.abs(u[inside] - u[inside[0]]).argmax()]
        found.append(
            (
                KeyTime(int(turn), float(u[turn]), f"{name}, {_length(u[turn])}"),
                KeyTime(int(inside[-1]), float(u[inside[-1]]), f"end of {name}"),
            )
        )
    return found


def _displacement(source: RunData, stored: StoredFields) -> NDArray[np.float64]:
    history = source.history
    return np.interp(stored.times, history["time_s"], history["displacement_m"])


def _length(metres: float) -> str:
    return f"{metres * MILLIMETRE.factor:.3g} mm"


@dataclass(frozen=True)
class RunData:
    """A results directory opened for drawing.

    Attributes:
        directory: Where the results are.
        title: Title of the case, or the directory's name.
        fibres: Reference directions, a row a family, shape (2, 2), if the case has them.
        history: Columns of ``history.csv``, with one row at least.
        cycles: Figures of each cycle; empty if the run has no summary.
    """

    directory: Path
    title: str
    fibres: NDArray[np.float64] | None
    history: dict[str, NDArray[np.float64]]
    cycles: list[Cycle]


def open_run_data(directory: str | Path) -> RunData:
    """Return what is known of a run; a case or a summary may be missing.

    Raises:
        FileNotFoundError: The directory has no history.
        ValueError: The history has no row, or the case has a fibre that is no angle.
    """
    folder = Path(directory)
    history = read_history(folder)
    if not len(history.get("step", ())):
        raise ValueError(f"{folder} has a history without a single step: nothing to draw")
    case = case_of(folder)
    angles = (case.get("sheet") or {}).get("fibres")
    fibres = None if angles is None else np.array([_direction(angle) for angle in angles])
    title = str(case.get("title") or folder.resolve().name)
    return RunData(folder, title, fibres, history, cycles(history, _spans(folder)))


def origin_of(directory: str | Path) -> Provenance:
    """Return what makes a picture of a run: the run's command, then this process."""
    try:
        run = of_summary(read_summary(directory))
    except (FileNotFoundError, json.JSONDecodeError):
        run = None
    here = this_process()
    return run.then(here) if run else here


def case_of(directory: str | Path) -> dict[str, Any]:
    """Return ``case.yaml`` as it is written; empty where there is none."""
    path = Path(directory) / "case.yaml"
    return dict(YAML(typ="safe").load(path) or {}) if path.exists() else {}


def _spans(folder: Path) -> list[tuple[float, float]]:
    try:
        found = read_summary(folder)["cycles"]
    except (FileNotFoundError, json.JSONDecodeError, KeyError):
        return []
    return [(cycle["start_s"], cycle["end_s"]) for cycle in found]


def _direction(angle: float | str) -> tuple[float, float]:
    """Return the unit vector at an angle: a number in rad, or a text with its unit."""
    rad = float(pint.Quantity(angle).to("rad").magnitude) if isinstance(angle, str) else angle
    return cos(rad), sin(rad)
