"""The table of a sweep: a row for each run."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

from wovenfab.record.results import write_whole
from wovenfab.record.summary import read_summary
from wovenfab.study.sweep import Run

TABLE = "sweep.csv"
#: Column and where it is in the summary of a run.
_FIGURES: Mapping[str, Callable[[Mapping[str, Any]], Any]] = {
    "unknowns": lambda s: s["unknowns"],
    "steps": lambda s: s["steps"],
    "peak_force_N": lambda s: s["peak_force_N"],
    "peak_force_at_m": lambda s: s["peak_force_at_m"],
    "dissipated_J": lambda s: s["dissipated_J"],
    "work_J": lambda s: s["work_J"],
    "worst_imbalance_J": lambda s: s["worst_imbalance_J"],
    "newton_iterations": lambda s: s["newton_iterations"]["total"],
    "cut_backs": lambda s: s["cut_backs"],
    "wall_time_s": lambda s: round(sum(s["wall_time_s"].values()), 1),
}
#: The columns that are printed, with their headings.
_PRINTED = {
    "outcome": "outcome",
    "unknowns": "unknowns",
    "peak_force_N": "peak force (N)",
    "dissipated_J": "dissipated (J)",
    "worst_imbalance_J": "imbalance (J)",
    "wall_time_s": "time (s)",
}


def table_of(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Return a row for each run: name, what is varied, outcome and figures in SI units."""
    keys = dict.fromkeys(key for run in runs for key in run.member.variation.values)
    return [_row(run, list(keys)) for run in runs]


def write_table(runs: Sequence[Run], directory: Path) -> Path:
    """Write the table as CSV into the directory of a sweep; return the file."""
    rows = table_of(runs)
    stream = StringIO()
    writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_whole(directory / TABLE, stream.getvalue())
    return directory / TABLE


def printed(runs: Sequence[Run]) -> str:
    """Return the most telling columns as a table in Markdown."""
    rows = table_of(runs)
    lines = [
        "| run | " + " | ".join(_PRINTED.values()) + " |",
        "|---|---|" + "---:|" * (len(_PRINTED) - 1),
    ]
    lines += [
        f"| {row['run']} | " + " | ".join(_short(row[key]) for key in _PRINTED) + " |"
        for row in rows
    ]
    return "\n".join(lines)


def _row(run: Run, keys: Sequence[str]) -> dict[str, Any]:
    summary = read_summary(run.directory) if run.has_results else {}
    values = run.member.variation.values
    return {
        "run": run.member.name,
        **{key: values.get(key, "") for key in keys},
        "outcome": _outcome(run),
        **{name: figure(summary) if summary else "" for name, figure in _FIGURES.items()},
    }


def _outcome(run: Run) -> str:
    if run.state == "failed":
        return f"failed: {run.problem}"
    return "not run" if run.state in ("waiting", "running") else "finished"


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
