"""The tables of pages: cycles, computation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from wovenfab.report.pages.blocks import Table
from wovenfab.report.style import DEGREE, Unit, readable

NONE = "\N{EN DASH}"
MINUS = "\N{MINUS SIGN}"
#: Heading and SI unit of each column of cycles.csv that a page shows.
COLUMNS: dict[str, tuple[str, str]] = {
    "peak_displacement_m": ("reversal at", "m"),
    "peak_force_N": ("peak force", "N"),
    "residual_force_N": ("residual force", "N"),
    "secant_stiffness_N_per_m": ("secant stiffness", "N/m"),
    "loop_area_J": ("loop area", "J"),
    "stored_at_peak_J": ("stored at reversal", "J"),
    "loss_ratio": ("loss ratio", ""),
    "dissipated_J": ("dissipated", "J"),
    "imbalance_J": ("imbalance", "J"),
    "shear_angle_kinematic_rad": ("shear angle, kinematic", "rad"),
    "shear_angle_field_rad": ("shear angle, field", "rad"),
    "normalised_shear_force_N_per_m": ("normalised shear force", "N/m"),
}


def cycle_table(rows: Sequence[Mapping[str, str]]) -> Table:
    """Return the table of cycles.

    Args:
        rows: What ``read_cycles`` returned, one row at least.
    """
    known = [name for name in COLUMNS if name in rows[0]]
    columns = [_column(*COLUMNS[name], [row[name] for row in rows]) for name in known]
    numbers = [row["cycle"] + ("" if row["complete"] == "true" else "*") for row in rows]
    head = ["cycle", *(title for title, _ in columns)]
    body = [[n, *cells] for n, *cells in zip(numbers, *(c for _, c in columns), strict=True)]
    unfinished = any(number.endswith("*") for number in numbers)
    return Table("Figures of each cycle" + (" (* not finished)" if unfinished else ""), head, body)


def computation_table(summary: Mapping[str, Any]) -> Table:
    """Return what the computation was, from ``summary.json``."""
    iterations = summary["newton_iterations"]
    seconds = summary["wall_time_s"]
    rows = [
        ("command", summary.get("command") or NONE),
        ("commit", summary.get("commit") or NONE),
        ("versions", ", ".join(f"{k} {v}" for k, v in summary["versions"].items())),
        ("MPI ranks", f"{summary['ranks']}"),
        ("unknowns", grouped(summary["unknowns"])),
        ("steps", f"{summary['steps']}, {summary['cut_backs']} cut back"),
        ("Newton iterations", f"{iterations['total']}, at most {iterations['worst'] or 0} a step"),
        ("wall time", ", ".join(f"{phase} {value:.2g} s" for phase, value in seconds.items())),
    ]
    return Table("Computation", (), rows, numbers=False)


def grouped(number: int) -> str:
    """Return a whole number in groups of three digits."""
    return f"{number:,}".replace(",", "\N{THIN SPACE}")


def _column(title: str, unit: str, cells: Sequence[str]) -> tuple[str, list[str]]:
    """Return heading and cells of a column in one readable unit."""
    values = [float(cell) if cell else None for cell in cells]
    largest = max((abs(v) for v in values if v is not None), default=0.0)
    shown = DEGREE if unit == "rad" else readable(unit, largest) if unit else Unit("", 1.0)
    texts = [NONE if v is None else f"{v * shown.factor:.4g}".replace("-", MINUS) for v in values]
    return f"{title} ({shown.name})" if shown.name else title, texts
