"""Case, history and fields of a results directory, as pictures and pages use them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import cos, isfinite, sin
from pathlib import Path
from typing import Annotated, Any, NotRequired, TypedDict

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, TypeAdapter, ValidationError

from wovenfab.case import units
from wovenfab.case.recorded import read_yaml
from wovenfab.plain_text import one_line
from wovenfab.record.field_file import FIELDS
from wovenfab.record.fields import StoredFields, read_fields
from wovenfab.record.figures import Figure, read_figures
from wovenfab.record.history import read_history
from wovenfab.record.reading import damaged
from wovenfab.record.results import Provenance, of_summary, this_process
from wovenfab.record.summary import SUMMARY, Cycle, cycles, read_summary
from wovenfab.report.style import millimetres

#: Name of the file of the case.
CASE = "case.yaml"
#: Characters of a title that are drawn, which takes long for thousands.
LONGEST_TITLE = 300


@dataclass(frozen=True)
class RunData:
    """A results directory opened for drawing.

    Attributes:
        directory: Where the results are.
        title: Title of the case with the name of its fabric, or the directory's name.
        fabric: What the case says of its fabric, by key; empty if it says nothing.
        fibres: Reference directions, a row a family, shape (2, 2), if the case has them.
        history: Columns of ``history.csv``, with one row at least.
        cycles: Figures of each cycle; empty if the run has no summary.
        summary: ``summary.json``; empty if the run has none.
        figures: Of each standard test by its name; empty if the case is none.
    """

    directory: Path
    title: str
    fabric: Mapping[str, Any]
    fibres: NDArray[np.float64] | None
    history: dict[str, NDArray[np.float64]]
    cycles: list[Cycle]
    summary: dict[str, Any]
    figures: dict[str, dict[str, Figure]]

    def reached(self, stored: StoredFields) -> NDArray[np.float64]:
        """Return the displacement of the program (m) at each stored time."""
        return np.interp(stored.times, self.history["time_s"], self.history["displacement_m"])


@dataclass(frozen=True)
class KeyTime:
    """A stored time.

    Attributes:
        index: Index into the stored times.
        displacement: Displacement of the program then (m).
        words: Description of the time.
    """

    index: int
    displacement: float
    words: str


def open_run_data(directory: str | Path) -> RunData:
    """Return the data of a run; a case or a summary may be missing.

    Raises:
        FileNotFoundError: The directory has no history.
        ValueError: The history has no row, or a file is damaged.
    """
    folder = Path(directory)
    history = read_history(folder)
    if not len(history["step"]):
        raise ValueError(f"{folder} has a history without a single step: nothing to draw")
    case, summary = case_of(folder), _checked(read_summary(folder), folder / SUMMARY)
    if (count := len(summary.get("cycles", ()))) > (rows := len(history["step"])):
        raise damaged(folder / SUMMARY, f"there are {count} cycles for {rows} rows of the history")
    spans = [(cycle["start_s"], cycle["end_s"]) for cycle in summary.get("cycles", ())]
    travel = summary.get("grip_travel_per_program", 1.0)
    fabric = case["fabric"] if isinstance(case.get("fabric"), Mapping) else {}
    names = [str(name) for name in (case.get("title"), fabric.get("name")) if name]
    title = one_line(": ".join(names) or folder.resolve().name)
    if len(title) > LONGEST_TITLE:
        title = f"{title[:LONGEST_TITLE]}…"
    fibres = _fibres(case, folder / CASE)
    parts = cycles(history, spans, travel), summary, read_figures(folder)
    return RunData(folder, title, fabric, fibres, history, *parts)


class _Cycle(TypedDict):
    start_s: Annotated[float, Field(ge=0)]
    end_s: float


class _Iterations(TypedDict):
    total: int
    worst: int | None


class _Loss(TypedDict):
    displacement_m: float
    force_N: float


class _Summary(TypedDict):
    """What pictures and pages take from a summary."""

    outcome: str
    unknowns: int
    steps: int
    cut_backs: int
    ranks: int
    newton_iterations: _Iterations
    wall_time_s: dict[str, float]
    versions: dict[str, str]
    cycles: list[_Cycle]
    losses_of_stability: NotRequired[list[_Loss]]
    saddles: NotRequired[int]
    grip_travel_per_program: NotRequired[Annotated[float, Field(gt=1e-12, lt=1e12)]]
    command: NotRequired[str | None]
    commit: NotRequired[str | None]


_SUMMARIES = TypeAdapter(_Summary)


def _checked(summary: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return a summary that has what is taken from it, or is empty.

    Raises:
        UnreadableResultsError: It lacks something.
    """
    if summary:
        try:
            _SUMMARIES.validate_python(summary, strict=True)
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(map(str, first["loc"]))
            raise damaged(path, f"{key}: {first['msg']}") from None
    return summary


def _fibres(case: Mapping[str, Any], path: Path) -> NDArray[np.float64] | None:
    """Return the directions of both families, shape (2, 2), if the case has them."""
    sheet = case.get("sheet")
    angles = sheet.get("fibres") if isinstance(sheet, Mapping) else None
    if angles is None:
        return None
    try:
        first, second = angles
        return np.array([_direction(first), _direction(second)])
    except (ValueError, TypeError) as error:
        raise damaged(path, f"sheet.fibres are no two angles ({error})") from None


def stored_of(directory: Path, name: str = FIELDS) -> StoredFields | None:
    """Return a series of fields; None if the run stored none."""
    stored = read_fields(directory, name) if (directory / f"{name}.h5").exists() else None
    return stored if stored is not None and len(stored.times) else None


def case_of(directory: str | Path) -> dict[str, Any]:
    """Return ``case.yaml`` as it is written; empty if there is none. Nothing is executed.

    Raises:
        UnreadableResultsError: It is no YAML, or has no keys.
    """
    try:
        return read_yaml(Path(directory) / CASE)
    except FileNotFoundError:
        return {}


def origin_of(directory: str | Path) -> Provenance:
    """Return the provenance of a picture of a run: the run's command, then this process."""
    run, here = of_summary(read_summary(directory)), this_process()
    return run.then(here) if run else here


def largest(source: RunData, stored: StoredFields) -> KeyTime:
    """Return the stored time of largest displacement."""
    u = source.reached(stored)
    index = int(np.abs(u).argmax())
    return KeyTime(index, float(u[index]), f"at {millimetres(u[index])}")


def key_times(
    source: RunData, stored: StoredFields, most: int = 4
) -> list[tuple[KeyTime, KeyTime]]:
    """Return the reversal and the end of each cycle, among the stored times (at least one).

    Of more cycles than ``most`` they are some, as :func:`spread`. A run without cycles counts as a
    single one.
    """
    u = source.reached(stored)
    spans = [(f"cycle {i}", c.start, c.end) for i, c in enumerate(source.cycles, 1)]
    spans = spans or [("run", 0.0, float(stored.times[-1]))]
    pairs = []
    for name, start, end in spread(spans, most):
        inside = times_between(stored, start, end)
        if not len(inside):
            continue
        turn, last = inside[np.abs(u[inside] - u[inside[0]]).argmax()], inside[-1]
        reversal = KeyTime(int(turn), float(u[turn]), f"{name}, {millimetres(u[turn])}")
        pairs.append((reversal, KeyTime(int(last), float(u[last]), f"end of {name}")))
    return pairs


def spread[T](items: Sequence[T], most: int) -> Sequence[T]:
    """Return at most so many items: the first, the last and some between, evenly."""
    if len(items) <= most:
        return items
    return [items[round(place)] for place in np.linspace(0, len(items) - 1, most)]


def times_between(stored: StoredFields, start: float, end: float) -> NDArray[np.int64]:
    """Return the indices of the stored times from ``start`` to ``end`` (s)."""
    slack = 1e-9 * stored.times[-1]
    return np.nonzero((stored.times >= start - slack) & (stored.times <= end + slack))[0]


def _direction(angle: float | str) -> tuple[float, float]:
    """Return the unit vector at an angle: a number in rad, or a text with its unit."""
    rad = units.parse(angle, "rad") if isinstance(angle, str) else float(angle)
    if not isfinite(rad):
        raise ValueError(f"{angle} is no angle")
    return cos(rad), sin(rad)
