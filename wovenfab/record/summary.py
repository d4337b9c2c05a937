"""Figures of a run and of its cycles: ``summary.json`` and ``cycles.csv``."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from wovenfab.parallel import on_root, world
from wovenfab.record.bias_extension import BiasExtension
from wovenfab.record.field_file import DATA
from wovenfab.record.fields import read_fields
from wovenfab.record.figures import Columns, StandardTest, figures_of
from wovenfab.record.history import index_of_peak, peak_force
from wovenfab.record.reading import damaged, read_object, text_of
from wovenfab.record.results import this_process, write_csv, write_whole
from wovenfab.versions import versions

if TYPE_CHECKING:
    from mpi4py import MPI

SUMMARY = "summary.json"
CYCLES = "cycles.csv"
CycleValue = float | bool | None


@dataclass(frozen=True)
class Cycle:
    """The figures of one cycle.

    Attributes:
        start, end: Times (s) at which it begins and ends, or should have ended.
        complete: Whether the run reached the end; if not, the figures are those so far.
        peak_time, peak_displacement: Reversal (s, m): farthest from where it began.
        peak_force, residual_force: Force of largest size, and at the end (N).
        secant_stiffness: Change of the force from the start to the reversal over that of the
            displacement, both of the grips against each other (N/m).
        loop_area: External work in the cycle, as the energy balance sums it (J): the area inside
            the loop of force against displacement, if the cycle is closed.
        stored_at_peak, dissipated: Energy at the reversal, and lost by all effects (J).
        imbalance: Change of the energy imbalance (J).
    """

    start: float
    end: float
    complete: bool
    peak_time: float
    peak_displacement: float
    peak_force: float
    residual_force: float
    secant_stiffness: float | None
    loop_area: float
    stored_at_peak: float
    dissipated: float
    imbalance: float

    @property
    def loss_ratio(self) -> float | None:
        """Loop area over stored energy; None for part of a loop, or where nothing is stored."""
        stores = self.complete and self.stored_at_peak > 0
        return self.loop_area / self.stored_at_peak if stores else None

    def as_dict(self) -> dict[str, CycleValue]:
        """Return the figures by name with unit, as in ``summary.json``."""
        return {
            "start_s": self.start,
            "end_s": self.end,
            "complete": self.complete,
            "peak_time_s": self.peak_time,
            "peak_displacement_m": self.peak_displacement,
            "peak_force_N": self.peak_force,
            "residual_force_N": self.residual_force,
            "secant_stiffness_N_per_m": self.secant_stiffness,
            "loop_area_J": self.loop_area,
            "stored_at_peak_J": self.stored_at_peak,
            "loss_ratio": self.loss_ratio,
            "dissipated_J": self.dissipated,
            "imbalance_J": self.imbalance,
        }


def cycles(
    history: Columns, spans: Iterable[tuple[float, float]], travel: float = 1.0
) -> list[Cycle]:
    """Return the figures of each cycle that the history entered.

    Args:
        history: Columns of ``history.csv``.
        spans: Times (s) at which each cycle begins and ends, in order.
        travel: Displacement of the grips against each other per displacement of the program.
    """
    time = history["time_s"]
    if len(time) < 2:
        return []
    slack = 1e-9 * (time[-1] - time[0])
    return [
        _cycle(history, start, end, bool(end <= time[-1] + slack), travel)
        for start, end in spans
        if start < time[-1] - slack
    ]


def window(history: Columns, start: float, end: float) -> dict[str, NDArray[np.float64]]:
    """Return the history from ``start`` to ``end`` (s), with interpolated rows at both.

    Where the history stops before ``end``, so does the window.
    """
    time = history["time_s"]
    end = min(end, float(time[-1]))
    # a step that ends a rounding error beside the boundary is not a point of its own
    slack = 1e-9 * (end - start)
    first, last = time.searchsorted(start + slack, "right"), time.searchsorted(end - slack)
    times = np.concatenate([[start], time[first:last], [end]])
    # Only the rows around it: a run of many cycles has a window for each.
    before = int(time.searchsorted(start, "right")) - 1
    rows = slice(max(before, 0), int(time.searchsorted(end)) + 1)
    return {name: np.interp(times, time[rows], column[rows]) for name, column in history.items()}


def write_cycles(
    directory: str | Path,
    history: Columns,
    spans: Iterable[tuple[float, float]],
    specimen: BiasExtension | None,
    travel: float = 1.0,
) -> None:
    """Write ``cycles.csv`` if there is a cycle; on one rank, after the fields.

    A bias-extension test has its ``specimen``, which adds columns; see :func:`cycles`.
    """
    rows: list[dict[str, CycleValue]] = []
    for number, cycle in enumerate(cycles(history, spans, travel), 1):
        row: dict[str, CycleValue] = {"cycle": number, **cycle.as_dict()}
        rows.append(row | (_shear(cycle, history, specimen, directory) if specimen else {}))
    if rows:
        texts = [{name: _cell(value) for name, value in row.items()} for row in rows]
        write_csv(Path(directory) / CYCLES, texts)


def read_cycles(directory: str | Path) -> list[dict[str, str]]:
    """Return the rows of ``cycles.csv`` as texts; none if there is no file.

    Raises:
        UnreadableResultsError: It is damaged, or not written by wovenfab.
    """
    path = Path(directory) / CYCLES
    if not path.exists():
        return []
    try:
        header, *rows = list(csv.reader(text_of(path).splitlines())) or [[]]
    except csv.Error as error:
        raise damaged(path, f"this is no table of cycles ({error})") from None
    if not rows or not {"cycle", "complete"} <= {*header} or len({*header}) < len(header):
        raise damaged(path, "this is no table of cycles")
    for number, row in enumerate(rows, 2):
        if len(row) != len(header):
            raise damaged(path, f"row {number} has {len(row)} values for {len(header)} columns")
        for name, cell in zip(header, row, strict=True):
            if name != "complete" and cell and not _is_finite(cell):
                raise damaged(path, f"{name} in row {number} is no number")
    return [dict(zip(header, row, strict=True)) for row in rows]


def _is_finite(text: str) -> bool:
    """Return whether a text is a finite number."""
    try:
        return isfinite(float(text))
    except ValueError:
        return False


def summarise(
    history: Columns,
    spans: Iterable[tuple[float, float]],
    *,
    outcome: str,
    unknowns: int,
    travel: float = 1.0,
    cut_backs: int,
    seconds: Mapping[str, float],
    ranks: int,
    losses: Sequence[Mapping[str, float]] = (),
    parts: Sequence[Mapping[str, Any]] = (),
    tests: Sequence[StandardTest] = (),
) -> dict[str, Any]:
    """Return the summary of a run, finished or not.

    Args:
        history: Columns of ``history.csv``.
        spans: Times (s) at which each cycle begins and ends, in order.
        outcome: ``"finished"``, or the reason of the failure in plain words.
        unknowns: Number of unknowns.
        travel: Displacement of the grips against each other per displacement of the program.
        cut_backs: How often a step was rejected and retried with a smaller size.
        seconds: Wall time of each phase (s).
        ranks: Number of MPI ranks.
        losses: Figures of each loss of stability.
        parts: What was done from the start and from each checkpoint on, in order.
        tests: The standard tests that the run is.
    """
    rows, force = len(history["step"]), history["force_N"]
    iterations = history["newton_iterations"][1:]  # the first row is the initial state
    origin = this_process(ranks)
    return {
        "outcome": outcome,
        "command": origin.command,
        "commit": origin.commit,
        "steps": len(iterations),
        "end_s": float(history["time_s"][-1]) if rows else None,
        "peak_force_N": peak_force(force) if rows else None,
        "peak_force_at_m": float(history["displacement_m"][index_of_peak(force)]) if rows else None,
        "dissipated_J": float(history["dissipated_J"][-1]) if rows else None,
        "work_J": float(history["work_J"][-1]) if rows else None,
        "worst_imbalance_J": float(np.abs(history["imbalance_J"]).max()) if rows else None,
        "figures": {
            test: {name: figure.value for name, figure in of.items()}
            for test, of in figures_of(tests, history).items()
        },
        "grip_travel_per_program": travel,
        "cycles": [cycle.as_dict() for cycle in cycles(history, spans, travel)],
        "unknowns": unknowns,
        "newton_iterations": {
            "total": int(iterations.sum()),
            "mean": float(iterations.mean()) if len(iterations) else None,
            "worst": int(iterations.max()) if len(iterations) else None,
        },
        "cut_backs": cut_backs,
        "losses_of_stability": [dict(loss) for loss in losses],
        "saddles": int((history["negative_eigenvalues"] > 0).sum()),
        "wall_time_s": {phase: float(s) for phase, s in seconds.items()},
        "ranks": ranks,
        "parts": [dict(part) for part in parts],
        "versions": versions(),
    }


def write_summary(
    directory: str | Path, summary: Mapping[str, Any], comm: MPI.Comm | None = None
) -> None:
    """Write ``summary.json`` in one operation; rank 0 writes, all call.

    Raises:
        ValueError: A number is not finite; on every rank, and nothing is written.
    """

    def write() -> None:
        text = json.dumps(summary, indent=2, allow_nan=False, default=_plain)
        write_whole(Path(directory) / SUMMARY, text + "\n")

    on_root(world() if comm is None else comm, write)


def read_summary(directory: str | Path) -> dict[str, Any]:
    """Return the content of ``summary.json``, empty where a run was killed or is going on.

    Raises:
        UnreadableResultsError: It is damaged, or not written by wovenfab.
    """
    try:
        return read_object(Path(directory) / SUMMARY)
    except FileNotFoundError:
        return {}


#: Columns of the history that the figures of a cycle are of.
_FIGURES_OF = (
    *("time_s", "displacement_m", "force_N", "work_J", "energy_J", "dissipated_J", "imbalance_J"),
)


def _cycle(history: Columns, start: float, end: float, complete: bool, travel: float) -> Cycle:
    part = window({name: history[name] for name in _FIGURES_OF}, start, end)
    u, force = part["displacement_m"], part["force_N"]
    turn = int(np.abs(u - u[0]).argmax())
    way = float(u[turn] - u[0]) * travel**2  # the force of the grips is F/travel
    return Cycle(
        start=float(start),
        end=float(end),
        complete=complete,
        peak_time=float(part["time_s"][turn]),
        peak_displacement=float(u[turn]),
        peak_force=peak_force(force),
        residual_force=float(force[-1]),
        secant_stiffness=float(force[turn] - force[0]) / way if way else None,
        loop_area=float(part["work_J"][-1] - part["work_J"][0]),
        stored_at_peak=float(part["energy_J"][turn]),
        dissipated=float(part["dissipated_J"][-1] - part["dissipated_J"][0]),
        imbalance=float(part["imbalance_J"][-1] - part["imbalance_J"][0]),
    )


def mean_shear_angle(directory: str | Path, time: float, specimen: BiasExtension) -> float | None:
    """Return the mean of the field ``shear_angle`` (rad) over the central zone at a time (s).

    It is positive as the kinematic angle is, in whatever order the families stand. It is None if
    the run did not store that field at that time.
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
    area = np.abs(ax * by - ay * bx) * specimen.in_centre(corners.mean(axis=1))
    angle = fields.field("shear_angle", index)[fields.triangles()].mean(axis=1)
    return specimen.sign * float(area @ angle / area.sum()) if area.any() else None


def _shear(
    cycle: Cycle, history: Columns, specimen: BiasExtension, directory: str | Path
) -> dict[str, CycleValue]:
    """Return shear angles (rad) and normalised shear force (N/m) at the reversal of a cycle.

    Unknown figures are None: the angle in the field if none was stored at that time, the
    force if the way to the reversal does not begin at rest or turns in between.
    """
    way = window(history, cycle.start, cycle.peak_time)
    angle = specimen.angle_at(way["displacement_m"])
    ascending = abs(angle[0]) < 1e-9 and bool((np.diff(angle) > 0).all())
    tension = specimen.jaws.force(way["force_N"])
    force = float(specimen.shear_force(angle, tension)[-1]) if ascending else None
    return {
        "shear_angle_kinematic_rad": None if np.isnan(angle[-1]) else float(angle[-1]),
        "shear_angle_field_rad": mean_shear_angle(directory, cycle.peak_time, specimen),
        "normalised_shear_force_N_per_m": force,
    }


def _cell(value: CycleValue) -> str:
    if value is None:
        return ""
    plain = value.item() if isinstance(value, np.generic) else value  # no np.float64(1.0)
    return str(plain).lower() if isinstance(plain, bool) else repr(plain)


def _plain(value: Any) -> Any:
    """Return numpy's numbers and arrays as Python's."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no place in the summary")
