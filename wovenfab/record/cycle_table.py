"""``cycles.csv``: a row a cycle, with the figures that a laboratory compares."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wovenfab.record.bias_extension import BiasExtension
from wovenfab.record.cycles import Cycle, cycles, window
from wovenfab.record.field_file import DATA
from wovenfab.record.results import write_whole
from wovenfab.record.stored_fields import read_fields

CYCLES = "cycles.csv"
Figure = float | bool | None
History = Mapping[str, NDArray[np.float64]]


def write_cycles(
    directory: str | Path,
    history: History,
    spans: Iterable[tuple[float, float]],
    specimen: BiasExtension | None,
) -> None:
    """Write ``cycles.csv`` if there is a cycle; on one rank, when the fields are written.

    Args:
        directory: The results directory.
        history: Columns of ``history.csv``.
        spans: Times (s) at which each cycle begins and ends, in order.
        specimen: The specimen if the case is a bias-extension test, which adds columns.
    """
    rows: list[dict[str, Figure]] = []
    for number, cycle in enumerate(cycles(history, spans), 1):
        row: dict[str, Figure] = {"cycle": number, **cycle.as_dict()}
        rows.append(row | (sheared(cycle, history, specimen, directory) if specimen else {}))
    if rows:
        text = io.StringIO()
        writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows({name: _cell(value) for name, value in row.items()} for row in rows)
        write_whole(Path(directory) / CYCLES, text.getvalue())


def read_cycles(directory: str | Path) -> list[dict[str, str]]:
    """Return the rows of ``cycles.csv`` as they are written; none where there is no file."""
    path = Path(directory) / CYCLES
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def sheared(
    cycle: Cycle, history: History, specimen: BiasExtension, directory: str | Path
) -> dict[str, Figure]:
    """Return shear angles (rad) and normalised shear force (N/m) at the reversal of a cycle.

    What is not known is None: the angle in the field where none was stored at that time,
    the force where the way to the reversal does not begin at rest or turns in between.
    """
    way = window(history, cycle.start, cycle.peak_time)
    angle = specimen.shear_angle(specimen.elongation(way["displacement_m"]))
    ascending = abs(angle[0]) < 1e-9 and bool((np.diff(angle) > 0).all())
    tension = specimen.tension(way["force_N"])
    force = float(specimen.shear_force(angle, tension)[-1]) if ascending else None
    return {
        "shear_angle_kinematic_rad": None if np.isnan(angle[-1]) else float(angle[-1]),
        "shear_angle_field_rad": mean_shear_angle(directory, cycle.peak_time, specimen),
        "normalised_shear_force_N_per_m": force,
    }


def mean_shear_angle(directory: str | Path, time: float, specimen: BiasExtension) -> float | None:
    """Return the mean of the shear angle (rad) over the central zone at a time (s).

    It is None where a run did not store that field at that time.
    """
    if not (Path(directory) / DATA).exists():
        return None
    fields = read_fields(directory)
    if not len(fields.times) or "shear_angle" not in fields.units:
        return None
    index = int(np.abs(fields.times - time).argmin())
    if abs(fields.times[index] - time) > 1e-9 * fields.times[-1]:
        return None
    corners = fields.points()[fields.triangles()]
    (ax, ay), (bx, by) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    centre = specimen.in_centre(corners.mean(axis=1))
    area = np.abs(ax * by - ay * bx) * centre
    angle = fields.field("shear_angle", index)[fields.triangles()].mean(axis=1)
    return float(area @ angle / area.sum()) if area.any() else None


def _cell(value: Figure) -> str:
    if value is None:
        return ""
    return str(value).lower() if isinstance(value, bool) else repr(value)
