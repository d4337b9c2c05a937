"""``report.html``: everything about one run on one page."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from wovenfab.record.field_file import DATA, MODE
from wovenfab.record.fields import StoredFields, read_fields
from wovenfab.record.summary import read_cycles, read_summary
from wovenfab.report import curves
from wovenfab.report.deformed import deformed
from wovenfab.report.field_styles import FIELD_STYLES, painted_fields
from wovenfab.report.loop import loop
from wovenfab.report.mesh import mesh
from wovenfab.report.mode import mode
from wovenfab.report.pages.blocks import Block, Section, Text, raster, section, vector, write_page
from wovenfab.report.pages.tables import computation_table, cycle_table, grouped
from wovenfab.report.panels import Panel, panels
from wovenfab.report.run_data import RunData, key_times, open_run_data, origin_of
from wovenfab.report.sheet import sheet_at
from wovenfab.report.style import said

PAGE = "report.html"


@dataclass(frozen=True)
class Run:
    """A results directory opened for a page.

    Attributes:
        source: Case and history.
        summary: ``summary.json``; empty if the run did not come so far.
        stored: Fields of one time at least, or None.
    """

    source: RunData
    summary: dict[str, Any]
    stored: StoredFields | None

    @property
    def outcome(self) -> str:
        """How it ended, in a sentence."""
        outcome = self.summary.get("outcome")
        if outcome is None:
            return "Not finished: there is no summary, so the run still goes on or was killed."
        return "Finished." if outcome == "finished" else f"Stopped early: {outcome}."


def open_run(directory: str | Path) -> Run:
    """Return a run with all that it wrote; fields and summary may be missing.

    Raises:
        FileNotFoundError: The directory has no history.
        ValueError: The history has no row.
    """
    try:
        summary = read_summary(directory)
    except (FileNotFoundError, json.JSONDecodeError):
        summary = {}
    try:
        stored = read_fields(directory) if (Path(directory) / DATA).exists() else None
    except OSError:  # an HDF5 file that a killed run left open
        stored = None
    usable = stored is not None and len(stored.times) > 0
    return Run(open_run_data(directory), summary, stored if usable else None)


def write_run_page(directory: str | Path) -> Path:
    """Write ``report.html`` into a results directory and return its path.

    Raises:
        FileNotFoundError: The directory has no history.
        ValueError: The history has no row.
    """
    run = open_run(directory)
    untitled = replace(run, source=replace(run.source, title=""))  # the page has the title
    return write_page(
        Path(directory) / PAGE,
        run.source.title,
        [run.outcome, *_stability(run.summary), *_missing(run)],
        headline(run),
        list(_sections(untitled)),
        origin_of(directory),
    )


def _stability(summary: Mapping[str, Any]) -> list[str]:
    """Return what a run tells of stability, in sentences."""
    found = [
        f"Stability was lost at {said(loss['displacement_m'], 'm')} under "
        f"{said(loss['force_N'], 'N')}."
        for loss in summary.get("losses_of_stability", [])
    ]
    saddles = summary.get("saddles", 0)
    return found + ([f"{saddles} states are saddles: no sheet would stay on them."] * (saddles > 0))


def _missing(run: Run) -> list[str]:
    """Return what a page is without, in words."""
    if run.stored is not None or not (run.source.directory / DATA).exists():
        return []
    return [f"There are no pictures of the sheet: {DATA} holds no fields that can be read."]


def headline(run: Run) -> list[tuple[str, str]]:
    """Return the numbers that people quote: name and value."""
    history, summary = run.source.history, run.summary
    peak = int(np.abs(history["force_N"]).argmax())
    work = float(np.abs(history["work_J"]).max())
    worst = float(np.abs(history["imbalance_J"]).max())
    at = said(float(history["displacement_m"][peak]), "m")
    ratios = [c.loss_ratio for c in run.source.cycles if c.loss_ratio is not None]
    found = [
        ("peak force", f"{said(float(history['force_N'][peak]), 'N')} at {at}"),
        ("energy dissipated", said(float(history["dissipated_J"][-1]), "J")),
        ("loss ratio, last cycle", f"{ratios[-1]:.3g}" if ratios else ""),
        ("worst imbalance", f"{100 * worst / work:.2g} % of the work" if work else ""),
        ("unknowns", grouped(summary["unknowns"]) if summary else ""),
        ("steps", f"{len(history['step']) - 1}"),
        ("wall time", f"{sum(summary['wall_time_s'].values()):.3g} s" if summary else ""),
    ]
    return [(name, value) for name, value in found if value]


def _sections(run: Run) -> Iterator[Section]:
    source, summary = run.source, run.summary
    yield section(
        "Force against displacement",
        lambda: [
            vector(loop(source), "loop", "Force of the driven edge against its displacement.")
        ],
    )
    if source.cycles:
        yield section("Cycles", lambda: _cycles(run))
    yield section(
        "Program and energies",
        lambda: [vector(curves.program(source), "program", "What the driven edge was told to do.")],
        lambda: [vector(curves.energies(source), "energies", "Energies by effect over time.")],
    )
    stored = run.stored
    if stored is not None:
        yield section(
            "Sheet and yarns",
            lambda: [raster(mesh(source, stored), "The mesh at rest and the yarns' directions.")],
            lambda: [raster(deformed(source, stored), "The sheet at its largest displacement.")],
            lambda: _mode(source),
        )
        yield section("Fields", lambda: _fields(source, stored))
    yield section("Solver", lambda: _solver(source, summary))
    yield section("Case", lambda: _case(source, summary))


def _cycles(run: Run) -> Sequence[Block]:
    rows = read_cycles(run.source.directory)
    caption = (
        "Energy dissipated in each cycle, and the energy imbalance that the steps in time leave, "
        "in per cent of what was dissipated and stored."
    )
    table = [cycle_table(rows)] if rows else []
    return [*table, vector(curves.losses(run.source), "losses", caption)]


def _mode(source: RunData) -> Sequence[Block]:
    if not (source.directory / f"{MODE}.h5").exists():
        return []
    lost = read_fields(source.directory, MODE)
    return [raster(mode(source, lost), "How it buckles, at a size that shows.")]


def _fields(source: RunData, stored: StoredFields) -> Sequence[Block]:
    found = key_times(source, stored)
    rows = [[turn for turn, _ in found], [end for _, end in found]]
    if len(found) == 1:  # side by side, once where it is the same
        rows = [list(dict.fromkeys([rows[0][0], rows[1][0]]))]
    sheets = {e.index: sheet_at(source, stored, e.index) for row in rows for e in row}
    where = " at reversals and ends of cycles" if source.cycles else ""
    blocks = []
    for name in painted_fields(stored):
        grid = [
            [Panel(sheets[e.index], stored.field(name, e.index), e.words) for e in row]
            for row in rows
        ]
        caption = f"The {FIELD_STYLES[name].label}{where}, to one scale."
        blocks.append(raster(panels(name, stored.units[name], grid), caption))
    return blocks


def _solver(source: RunData, summary: dict[str, Any]) -> Sequence[Block]:
    seconds = summary.get("wall_time_s", {})
    cut_backs = summary.get("cut_backs", 0)
    caption = "Newton iterations and length of each step; where the wall time went."
    if cut_backs:
        caption += f" {cut_backs} attempts did not converge and were cut back: shorter steps."
    return [vector(curves.solver(source, seconds), "solver", caption)]


def _case(source: RunData, summary: dict[str, Any]) -> Sequence[Block]:
    path = source.directory / "case.yaml"
    case = [Text(path.read_text(encoding="utf-8"), verbatim=True)] if path.exists() else []
    return [*([computation_table(summary)] if summary else []), *case]
