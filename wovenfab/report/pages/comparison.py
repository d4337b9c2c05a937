"""One page on which several runs lie over each other."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from wovenfab.record.results import this_process
from wovenfab.report import overlays
from wovenfab.report.field_styles import painted_fields
from wovenfab.report.pages.blocks import Block, Section, Table, raster, section, vector, write_page
from wovenfab.report.pages.run_page import Run, headline, open_run
from wovenfab.report.pages.tables import NONE
from wovenfab.report.panels import Panel, panels
from wovenfab.report.run_data import case_of, largest
from wovenfab.report.sheet import sheet_at

PAGE = "comparison.html"


def default_place(directories: Sequence[Path]) -> Path:
    """Return where the comparison goes: into the folder that holds all of the runs."""
    folder = os.path.commonpath([d.resolve().parent for d in directories])
    return Path(os.path.relpath(folder)) / PAGE


def write_comparison(directories: Sequence[Path], path: Path) -> Path:
    """Write the page of several runs and return its path.

    Args:
        directories: The results directories, two or more.
        path: The HTML file.

    Raises:
        FileNotFoundError: A directory has no history.
        ValueError: A history has no row.
    """
    runs = dict(zip(labels(directories), map(open_run, directories), strict=True))
    stopped = [f"{name}: {run.outcome}" for name, run in runs.items() if not _finished(run)]
    title = f"{len(runs)} runs compared"
    return write_page(path, title, stopped, [], list(_sections(runs)), this_process())


def labels(directories: Sequence[Path]) -> list[str]:
    """Return the shortest ends of the paths that tell the directories apart."""
    parts = [d.resolve().parts for d in directories]
    for count in range(1, max(map(len, parts)) + 1):
        names = ["/".join(p[-count:]) for p in parts]
        if len(set(names)) == len(names):
            return names
    return [f"{i}: {p[-1]}" for i, p in enumerate(parts, 1)]  # one of them twice


def _finished(run: Run) -> bool:
    return bool(run.summary.get("outcome") == "finished")


def _sections(runs: Mapping[str, Run]) -> Iterator[Section]:
    named = [(name, run.source) for name, run in runs.items()]
    yield section("Runs", lambda: [_overview(runs)], lambda: _differences(runs))
    yield section(
        "Force against displacement",
        lambda: [vector(overlays.loops(named), "loops", "Force of the driven edge.")],
    )
    if any(run.source.cycles for run in runs.values()):
        caption = "Figures of the complete cycles, against their reversals."
        yield section("Cycles", lambda: [vector(overlays.cycle_figures(named), "cycles", caption)])
    yield section(
        "Energies", lambda: [vector(overlays.energies(named), "energies", "All effects together.")]
    )
    caption = "What the steps in time leave of the energy balance, and the work of the solver."
    yield section("Solver", lambda: [vector(overlays.efforts(named), "efforts", caption)])
    if any(run.stored is not None for run in runs.values()):
        yield section("Fields", lambda: _fields(runs))


def _overview(runs: Mapping[str, Run]) -> Table:
    told = {name: dict(headline(run)) for name, run in runs.items()}
    heads = list(dict.fromkeys(head for figures in told.values() for head in figures))
    rows = [[name, *(figures.get(h, NONE) for h in heads)] for name, figures in told.items()]
    return Table("What came out", ["run", *heads], rows)


def _differences(runs: Mapping[str, Run]) -> Sequence[Block]:
    cases = [flat(case_of(run.source.directory)) for run in runs.values()]
    keys = dict.fromkeys(key for case in cases for key in case)
    differing = [key for key in keys if len({case.get(key, NONE) for case in cases}) > 1]
    rows = [[key, *(case.get(key, NONE) for case in cases)] for key in differing]
    head = ["key of the case", *runs]
    return [Table("Where the cases differ", head, rows, numbers=False)] if rows else []


def flat(case: Mapping[str, Any], above: str = "") -> dict[str, str]:
    """Return a case as texts by dotted keys."""
    found: dict[str, str] = {}
    for key, value in case.items():
        if isinstance(value, Mapping):
            found |= flat(value, f"{above}{key}.")
        else:
            items = value if isinstance(value, list) else [value]
            found[f"{above}{key}"] = ", ".join(map(_written, items))
    return found


def _written(value: Any) -> str:
    """Return a value as one writes it in a case file."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def _fields(runs: Mapping[str, Run]) -> Sequence[Block]:
    shown = {name: run for name, run in runs.items() if run.stored is not None}
    fields = [set(painted_fields(run.stored)) for run in shown.values() if run.stored]
    first = next(iter(shown.values())).stored
    assert first is not None
    common = [name for name in painted_fields(first) if all(name in f for f in fields)]
    found = []
    for field in common:
        cells = [_panel(name, run, field) for name, run in shown.items()]
        columns = int(np.clip(len(cells), 1, 2))
        rows = [cells[i : i + columns] for i in range(0, len(cells), columns)]
        caption = f"Each run at its largest displacement: {field.replace('_', ' ')}, to one scale."
        found.append(raster(panels(field, first.units[field], rows), caption))
    return found


def _panel(name: str, run: Run, field: str) -> Panel:
    assert run.stored is not None
    when = largest(run.source, run.stored)
    sheet = sheet_at(run.source, run.stored, when.index)
    return Panel(sheet, run.stored.field(field, when.index), f"{name}, {when.words}")
