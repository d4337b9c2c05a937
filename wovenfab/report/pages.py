"""``report.html``, the page of one run, and ``comparison.html``, the page of several."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from wovenfab.plain_text import one_line
from wovenfab.record.field_file import DATA, MODE
from wovenfab.record.fields import StoredFields
from wovenfab.record.figures import Figure
from wovenfab.record.history import index_of_peak
from wovenfab.record.reading import UnreadableResultsError
from wovenfab.record.results import FINISHED, this_process
from wovenfab.record.summary import read_cycles
from wovenfab.report import curves, sheet
from wovenfab.report.page_blocks import (
    NONE,
    Block,
    PageSection,
    PageTable,
    PageText,
    computation_table,
    cycle_table,
    grouped,
    picture,
    section,
    write_page,
)
from wovenfab.report.run_data import (
    RunData,
    case_of,
    key_times,
    largest,
    open_run_data,
    origin_of,
    stored_of,
)
from wovenfab.report.sheet import Panel, panels, sheet_at
from wovenfab.report.style import DEGREE, FIELD_STYLES, Values, quantity, seconds, shown_fields

PAGE, COMPARISON = "report.html", "comparison.html"


@dataclass(frozen=True)
class OpenedRun:
    """A results directory opened for a page; without fields, ``stored`` is None."""

    source: RunData
    stored: StoredFields | None

    @property
    def outcome(self) -> str:
        """How it ended, in a sentence."""
        outcome = self.source.summary.get("outcome")
        if outcome is None:
            return "Not finished: there is no summary, so the run still goes on or was killed."
        return "Finished." if outcome == FINISHED else f"Stopped early: {outcome}."


def open_run(directory: str | Path) -> OpenedRun:
    """Return a run; fields that cannot be read count as missing. Raises as open_run_data."""
    try:
        stored = stored_of(Path(directory))
    except (OSError, UnreadableResultsError):  # an HDF5 file that is damaged
        stored = None
    return OpenedRun(open_run_data(directory), stored)


def write_run_page(directory: str | Path, more: Sequence[PageSection] = ()) -> Path:
    """Write ``report.html``, with more sections first, and return its path.

    Raises:
        FileNotFoundError: The directory has no history.
        ValueError: The history has no row.
    """
    run = open_run(directory)
    untitled = replace(run, source=replace(run.source, title=""))  # the page has the title
    return write_page(
        Path(directory) / PAGE,
        run.source.title,
        [run.outcome, *_stability(run.source.summary), *_missing(run)],
        headline(run.source),
        [*more, *_sections(untitled)],
        origin_of(directory),
    )


def write_comparison(
    directories: Sequence[Path], path: Path, more: Sequence[PageSection] = ()
) -> Path:
    """Write the page of two or more runs, with more sections first, and return its path.

    Raises:
        FileNotFoundError: A directory has no history.
        ValueError: A history has no row.
    """
    runs = dict(zip(labels(directories), map(open_run, directories), strict=True))
    outcomes = {name: run.outcome for name, run in runs.items()}
    stopped = [f"{name}: {text}" for name, text in outcomes.items() if text != "Finished."]
    sections = [*more, *_sections_of_several(runs)]
    return write_page(path, f"{len(runs)} runs compared", stopped, [], sections, this_process())


def default_place(directories: Sequence[Path]) -> Path:
    """Return the default path of a comparison: in the folder that holds all of the runs."""
    folder = os.path.commonpath([d.resolve().parent for d in directories])
    return Path(os.path.relpath(folder)) / COMPARISON


def labels(directories: Sequence[Path]) -> list[str]:
    """Return the shortest ends of the paths that distinguish the directories."""
    parts = [tuple(map(one_line, d.resolve().parts)) for d in directories]
    for count in range(1, max(map(len, parts)) + 1):
        names = ["/".join(p[-count:]) for p in parts]
        if len(set(names)) == len(names):
            return names
    return [f"{i}: {p[-1]}" for i, p in enumerate(parts, 1)]  # one of them twice


def headline(source: RunData) -> list[tuple[str, str]]:
    """Return the main figures of a run: name and value."""
    history, summary = source.history, source.summary
    peak = index_of_peak(history["force_N"])
    work = float(np.abs(history["work_J"]).max())
    worst = float(np.abs(history["imbalance_J"]).max())
    at = quantity(float(history["displacement_m"][peak]), "m")
    ratios = [c.loss_ratio for c in source.cycles if c.loss_ratio is not None]
    figures = [
        ("peak force", f"{quantity(float(history['force_N'][peak]), 'N')} at {at}"),
        ("energy dissipated", quantity(float(history["dissipated_J"][-1]), "J")),
        ("loss ratio, last cycle", f"{ratios[-1]:.3g}" if ratios else ""),
        ("worst imbalance", f"{100 * worst / work:.2g} % of the work" if work else ""),
        ("unknowns", grouped(summary["unknowns"]) if summary else ""),
        ("steps", f"{len(history['step']) - 1}"),
        ("wall time", seconds(sum(summary["wall_time_s"].values())) if summary else ""),
    ]
    return [(name, value) for name, value in figures if value]


def describe_loop(source: RunData) -> str:
    """Return what the loop of a run says, in a sentence."""
    (_, peak), (_, lost), *_ = headline(source)
    return f"Peak force {peak}; energy dissipated {lost}."


def between(values: Sequence[Values], unit: str) -> str:
    """Return in a sentence between which values (SI) a field lies."""
    ends = [float(end(np.concatenate(values))) for end in (np.min, np.max)]
    if unit == "rad":
        low, high = (f"{DEGREE.factor * end:.3g}{DEGREE.name}" for end in ends)
    else:
        shown = "" if unit == "1" else f" {unit}"
        low, high = (quantity(e, "m") if unit == "m" else f"{e:.3g}{shown}" for e in ends)
    return f"From {low} to {high}."


def _way(source: RunData) -> str:
    """Return how far the program goes and how long it takes, in a sentence."""
    u, time = source.history["displacement_m"], source.history["time_s"]
    low, high = (quantity(float(end), "m") for end in (u.min(), u.max()))
    return f"From {low} to {high} in {quantity(float(time[-1]), 's')}."


def _parts(source: RunData, kind: str) -> str:
    """Return the largest energy of each effect in words."""
    found = curves.parts(source.history, kind).items()
    words = [f"{n.replace('_', ' ')} up to {quantity(np.abs(v).max(), 'J')}" for n, v in found]
    return ", ".join(words) or "none"


def flat(case: Mapping[str, Any], above: str = "") -> dict[str, str]:
    """Return a case as texts by dotted keys."""
    texts: dict[str, str] = {}
    for key, value in case.items():
        if isinstance(value, Mapping):
            texts |= flat(value, f"{above}{key}.")
        else:
            items = value if isinstance(value, list) else [value]
            yaml = (str(item).lower() if isinstance(item, bool) else str(item) for item in items)
            texts[f"{above}{key}"] = ", ".join(yaml)
    return texts


def _stability(summary: Mapping[str, Any]) -> list[str]:
    """Return sentences about lost stability."""
    losses = [
        f"Stability was lost at {quantity(loss['displacement_m'], 'm')} under "
        f"{quantity(loss['force_N'], 'N')}."
        for loss in summary.get("losses_of_stability", [])
    ]
    saddles = summary.get("saddles", 0)
    return losses + [f"{saddles} states are saddles: no sheet would stay on them."] * (saddles > 0)


def _missing(run: OpenedRun) -> list[str]:
    """Return a sentence about fields that cannot be read."""
    if run.stored is not None or not (run.source.directory / DATA).exists():
        return []
    return [f"There are no pictures of the sheet: {DATA} holds no fields that can be read."]


def _sections(run: OpenedRun) -> Iterator[PageSection]:
    source, stored = run.source, run.stored
    if source.fabric:
        yield section("Fabric", lambda: [_fabric(source)])
    caption = "Force of the program against its displacement."
    yield section(
        "Force against displacement",
        lambda: [picture(curves.loop(source), caption, describe_loop(source))],
    )
    if source.figures:
        yield section("Figures of the test", lambda: _figures(source))
    if source.cycles:
        yield section("Cycles", lambda: _cycles(source))
    yield section(
        "Program and energies",
        lambda: [
            picture(curves.program(source), "The program against time.", _way(source)),
            picture(
                curves.energies(source),
                "Energies by effect over time.",
                f"Stored: {_parts(source, 'energy')}. Dissipated: {_parts(source, 'dissipated')}.",
            ),
        ],
    )
    if stored is not None:
        yield section(
            "Sheet and yarns",
            lambda: [
                picture(
                    sheet.mesh(source, stored),
                    "Mesh at rest, directions of the yarns.",
                    f"{len(stored.corners())} triangles.",
                    "png",
                ),
                picture(
                    sheet.deformed(source, stored),
                    "Sheet at its largest displacement.",
                    f"The program is {largest(source, stored).words}.",
                    "png",
                ),
            ],
            lambda: _mode(source),
        )
        yield section("Fields", lambda: _fields(source, stored))
    yield section("Solver", lambda: _solver(source))
    yield section("Case", lambda: _case(source))


def _fabric(source: RunData) -> PageTable:
    rows = [
        (key, str(text))
        for key, given in source.fabric.items()
        for text in (given if isinstance(given, list) else [given])
    ]
    return PageTable("What the effects describe", (), rows, numbers=False)


def _figures(source: RunData) -> Sequence[Block]:
    head = ("figure", "laboratory units", "SI units", "definition")
    return [
        PageTable(
            test,
            head,
            [[name, *value_texts(figure), figure.definition] for name, figure in of.items()],
            numbers=False,
        )
        for test, of in source.figures.items()
    ]


def value_texts(figure: Figure) -> tuple[str, str]:
    """Return the value of a figure in the units of a laboratory and in SI units, as texts."""
    units = (
        (figure.laboratory_value, figure.laboratory_unit),
        (figure.value, figure.unit if figure.laboratory_unit != "%" else ""),
    )
    laboratory, si = (
        NONE if value is None else f"{value:.4g} {unit}".removesuffix(" 1").rstrip()
        for value, unit in units
    )
    return laboratory, si


def _cycles(source: RunData) -> Sequence[Block]:
    rows = read_cycles(source.directory)
    caption = (
        "Energy dissipated in each cycle, and the energy imbalance by the time steps, "
        "in per cent of what was dissipated and stored."
    )
    table = [cycle_table(rows)] if rows else []
    shown = curves.shown_cycles(source)
    lost = [f"cycle {i}: {quantity(c.dissipated, 'J')}" for i, c in shown]
    if len(shown) < len(source.cycles):
        caption += f" {len(shown)} of {len(source.cycles)} cycles are shown."
    return [*table, picture(curves.losses(source), caption, f"{'; '.join(lost)}.")]


def _mode(source: RunData) -> Sequence[Block]:
    lost = stored_of(source.directory, MODE)
    if lost is None:
        return []
    return [picture(sheet.mode(source, lost), "How it buckles, at a size that shows.", kind="png")]


def _fields(source: RunData, stored: StoredFields) -> Sequence[Block]:
    times = key_times(source, stored)
    rows = [[turn for turn, _ in times], [end for _, end in times]]
    if len(times) == 1:  # side by side, once where it is the same
        rows = [list(dict.fromkeys([rows[0][0], rows[1][0]]))]
    sheets = {e.index: sheet_at(source, stored, e.index) for row in rows for e in row}
    where = " at reversals and ends of cycles" if source.cycles else ""
    blocks = []
    for name in shown_fields(stored):
        grid = [
            [Panel(sheets[e.index], stored.field(name, e.index), e.words) for e in row]
            for row in rows
        ]
        caption = f"The {FIELD_STYLES[name].label}{where}, to one scale."
        values = [panel.values for row in grid for panel in row]
        says = between(values, stored.units[name])
        blocks.append(picture(panels(name, stored.units[name], grid), caption, says, "png"))
    return blocks


def _solver(source: RunData) -> Sequence[Block]:
    cut_backs = source.summary.get("cut_backs", 0)
    caption = "Newton iterations and length of each step; wall time by phase."
    if cut_backs:
        caption += f" Attempts that did not converge, followed by shorter steps: {cut_backs}."
    return [picture(curves.solver(source), caption)]


def _case(source: RunData) -> Sequence[Block]:
    path = source.directory / "case.yaml"
    case = [PageText(path.read_text(encoding="utf-8"), verbatim=True)] if path.exists() else []
    return [*([computation_table(source.summary)] if source.summary else []), *case]


def _sections_of_several(runs: Mapping[str, OpenedRun]) -> Iterator[PageSection]:
    named = [(name, run.source) for name, run in runs.items()]
    told = " ".join(f"{name}: {describe_loop(source)}" for name, source in named)
    yield section("Runs", lambda: [_overview(named)], lambda: _differences(named))
    yield section(
        "Force against displacement",
        lambda: [picture(curves.loops(named), "Force of the program.", told)],
    )
    if any(source.cycles for _, source in named):
        caption = "Figures of the complete cycles, against their reversals."
        yield section("Cycles", lambda: [picture(curves.cycle_figures(named), caption)])
    energies = curves.energies_of_runs
    yield section("Energies", lambda: [picture(energies(named), "All effects together.")])
    words = "Energy imbalance by the time steps, and the work of the solver."
    work = curves.imbalance_and_iterations
    yield section("Solver", lambda: [picture(work(named), words)])
    if any(run.stored is not None for run in runs.values()):
        yield section("Fields", lambda: _common_fields(runs))


def _overview(named: Sequence[curves.Named]) -> PageTable:
    figures = {name: dict(headline(source)) for name, source in named}
    heads = list(dict.fromkeys(head for values in figures.values() for head in values))
    rows = [[name, *(values.get(h, NONE) for h in heads)] for name, values in figures.items()]
    return PageTable("Figures of the runs", ["run", *heads], rows)


def _differences(named: Sequence[curves.Named]) -> Sequence[Block]:
    cases = [flat(case_of(source.directory)) for _, source in named]
    keys = dict.fromkeys(key for case in cases for key in case)
    differing = [key for key in keys if len({case.get(key, NONE) for case in cases}) > 1]
    rows = [[key, *(case.get(key, NONE) for case in cases)] for key in differing]
    head = ["key of the case", *(name for name, _ in named)]
    return [PageTable("Differences of the cases", head, rows, numbers=False)] if rows else []


def _common_fields(runs: Mapping[str, OpenedRun]) -> Sequence[Block]:
    shown = [(name, run.source, run.stored) for name, run in runs.items() if run.stored is not None]
    first = shown[0][2]
    common = [f for f in shown_fields(first) if all(f in stored.units for *_, stored in shown)]
    blocks = []
    for field in common:
        cells = [_panel(name, source, stored, field) for name, source, stored in shown]
        rows = [cells[i : i + 2] for i in range(0, len(cells), 2)]
        caption = f"Each run at its largest displacement: {field.replace('_', ' ')}, to one scale."
        says = between([cell.values for cell in cells], first.units[field])
        blocks.append(picture(panels(field, first.units[field], rows), caption, says, "png"))
    return blocks


def _panel(name: str, source: RunData, stored: StoredFields, field: str) -> Panel:
    when = largest(source, stored)
    values = stored.field(field, when.index)
    return Panel(sheet_at(source, stored, when.index), values, f"{name}, {when.words}")
