"""What the pictures need from a results directory besides its history and fields."""

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

from wovenfab.record.cycles import Cycle, cycles
from wovenfab.record.history import read_history
from wovenfab.record.provenance import Provenance, of_summary, this_process
from wovenfab.record.summary import read_summary


@dataclass(frozen=True)
class Source:
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


def open_source(directory: str | Path) -> Source:
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
    return Source(folder, title, fibres, history, cycles(history, _spans(folder)))


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
