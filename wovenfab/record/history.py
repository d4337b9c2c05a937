"""The history of a run: one row a step, on disk as soon as the step is done."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from math import fsum, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

import numpy as np
from numpy.typing import NDArray

from wovenfab.parallel import on_root, world
from wovenfab.record.reading import UnreadableResultsError, read_table, text_of
from wovenfab.record.results import NothingToResumeError, write_whole

if TYPE_CHECKING:
    from mpi4py import MPI

    from wovenfab.stepping.step import Step

Values = NDArray[np.float64]
HISTORY = "history.csv"
REACTIONS = "reactions.csv"
#: Columns with the estimated errors of the time steps.
ERRORS = ("force_error_of_steps_N", "dissipated_error_of_steps_J")
#: Columns that every row has, and those that every history has.
KEYS = ("step", "time_s")
ESSENTIAL = (
    *(*KEYS, "displacement_m", "force_N", "energy_J", "dissipated_J", "work_J"),
    *("imbalance_J", "newton_iterations"),
)
#: Column with the displacement of a second program.
SECOND = ("second_displacement_m",)


class HistoryRows:
    """Rows of the history, from steps.

    Totals and the energy imbalance (work - change of stored energy - dissipated energy,
    from the first row on) are computed here.

    Attributes:
        columns: Names of the columns of ``history.csv``.
        reaction_columns: Those of ``reactions.csv``.
    """

    def __init__(
        self,
        stored: Sequence[str],
        dissipated: Sequence[str],
        edges: Sequence[str],
        errors: bool = False,
        probes: Sequence[str] = (),
        second: bool = False,
    ) -> None:
        """Start before the first step.

        Args:
            stored: Names of the effects that store energy.
            dissipated: Names of the effects that dissipate energy.
            edges: Names of the edges whose reactions are recorded.
            errors: Whether there are columns for the estimated errors of the time steps.
            probes: Names of the columns of probes.
            second: Whether there is a column for the displacement of a second program.
        """
        self._stored, self._dissipated = tuple(stored), tuple(dissipated)
        self._edges, self._errors, self._second = tuple(edges), errors, second
        self._initial_energy: float | None = None
        self._last_time = -float("inf")
        self.columns = (
            *("step", "time_s", "displacement_m", *(SECOND if second else ())),
            *("force_N", "force_transverse_N", "energy_J"),
            *(f"energy_{name}_J" for name in self._stored),
            "dissipated_J",
            *(f"dissipated_{name}_J" for name in self._dissipated),
            *("work_J", "imbalance_J", *(ERRORS if errors else ())),
            *("newton_iterations", "negative_eigenvalues", *probes),
        )
        reactions = (f"{edge}_{xy}_N" for edge in self._edges for xy in "xy")
        self.reaction_columns = ("step", "time_s", *reactions)

    def resume(self, history: Mapping[str, NDArray[np.float64]]) -> None:
        """Go on after the first rows of a history that has these columns."""
        self._initial_energy = float(history["energy_J"][0])

    def row(self, step: Step, probes: Sequence[float] = ()) -> tuple[list[float], list[float]]:
        """Return the values of a step and of its probes for the columns of both tables.

        Raises:
            ValueError: A number is not finite, the effects or edges are not the announced
                ones, or the time does not increase.
        """
        for what, given, announced in (
            ("stored energies", step.stored, self._stored),
            ("dissipated energies", step.dissipated, self._dissipated),
            ("reactions", step.reactions, self._edges),
        ):
            if set(given) != set(announced):
                raise ValueError(
                    f"{what} of {sorted(given)} given, but the history has {sorted(announced)}"
                )
        if step.time <= self._last_time:
            raise ValueError(f"time {step.time} s comes after {self._last_time} s in the history")
        stored = [float(step.stored[name]) for name in self._stored]
        dissipated = [float(step.dissipated[name]) for name in self._dissipated]
        energy, lost, work = fsum(stored), fsum(dissipated), float(step.work)
        initial = energy if self._initial_energy is None else self._initial_energy
        moved = step.displacement, *((step.second,) if self._second else ())
        driven = map(float, (step.time, *moved, step.force, step.force_transverse))
        balance = [work, work - (energy - initial) - lost]
        if self._errors:
            balance += [float(step.force_error), float(step.dissipated_error)]
        numbers = [*driven, energy, *stored, lost, *dissipated, *balance]
        reactions = [float(component) for e in self._edges for component in step.reactions[e]]
        if not all(map(isfinite, (*numbers, *reactions, *probes))):
            raise ValueError(f"step {step.number} has numbers that are not finite: {step}")
        self._initial_energy, self._last_time = initial, numbers[0]
        counts = int(step.iterations), int(step.negatives)
        row = [int(step.number), *numbers, *counts, *probes]
        return row, [row[0], row[1], *reactions]


class HistoryWriter(AbstractContextManager["HistoryWriter"]):
    """Writes ``history.csv`` and ``reactions.csv``, row by row; rank 0 writes, all call."""

    def __init__(
        self,
        directory: str | Path,
        rows: HistoryRows,
        comm: MPI.Comm | None = None,
        until: int = -1,
    ) -> None:
        """Start both files with their headers, or go on with earlier ones; collective.

        Args:
            directory: The results directory.
            rows: Makes the rows.
            comm: The ranks that call; the world communicator if None.
            until: Last step of earlier files that is kept; negative for none.

        Raises:
            NothingToResumeError: The earlier files have other columns, or end before that step.
        """
        self._until = until
        self._comm, self._rows = world() if comm is None else comm, rows
        self._files: list[TextIO] = []
        on_root(self._comm, lambda: self._open(Path(directory)))

    def append(self, step: Step, probes: Sequence[float] = ()) -> None:
        """Write a step and the values of its probes to both files and flush them; collective.

        Raises:
            ValueError: As :meth:`HistoryRows.row`; then nothing is written.
        """
        on_root(self._comm, lambda: self._write(self._rows.row(step, probes)))

    def sync(self) -> None:
        """Wait until all rows are on the disk; on the rank that writes."""
        for file in self._files:
            os.fsync(file.fileno())

    def close(self) -> None:
        """Close the files; a second call does nothing."""
        for file in self._files:
            file.close()

    def __exit__(self, *_: object) -> None:
        """Close the files."""
        self.close()

    def _open(self, directory: Path) -> None:
        kept = kept_rows(directory, self._rows, self._until)
        for name, header in _tables(self._rows):
            rows = kept.get(name, [])
            write_whole(directory / name, "\n".join([",".join(header), *rows, ""]))
            self._files.append((directory / name).open("a", encoding="utf-8", newline="\n"))
        if kept:
            self._rows.resume(read_history(directory))

    def _write(self, rows: tuple[list[float], list[float]]) -> None:
        for file, row in zip(self._files, rows, strict=True):
            file.write(",".join(map(repr, row)) + "\n")
            file.flush()


def _tables(rows: HistoryRows) -> tuple[tuple[str, Sequence[str]], ...]:
    """Return name and header of both files."""
    return (HISTORY, rows.columns), (REACTIONS, rows.reaction_columns)


def kept_rows(directory: Path, rows: HistoryRows, until: int) -> dict[str, list[str]]:
    """Return the rows of earlier files up to a step, as they are there, by the name of the file.

    There are none if ``until`` is negative.

    Raises:
        NothingToResumeError: A file is missing or damaged, has other columns, or ends before.
    """
    kept: dict[str, list[str]] = {}
    for name, header in _tables(rows) if until >= 0 else ():
        try:
            *text, _ = text_of(directory / name, until + 2).split("\n")
            read_history(directory, name, until + 1)
        except (OSError, UnreadableResultsError) as error:
            raise NothingToResumeError(f"the run cannot go on: {error}") from None
        if other := set(text[0].split(",")) ^ {*header}:
            raise NothingToResumeError(
                f"{directory / name} has other columns than this run would ({', '.join(other)}); "
                "keep output.probes, and whether there is a time.tolerance or a second_program, as "
                "they were"
            )
        kept[name] = text[1 : until + 2]
        steps = [row.partition(",")[0] for row in kept[name]]
        if text[:1] != [",".join(header)] or steps != [str(n) for n in range(until + 1)]:
            raise NothingToResumeError(
                f"{directory / name} is of another run, or ends before the checkpoint; "
                "run the case from its beginning"
            )
    return kept


def read_history(
    directory: str | Path, name: str = HISTORY, rows: int | None = None
) -> dict[str, NDArray[np.float64]]:
    """Return the columns of a table by name, each of shape (steps,), or of its first rows.

    A last row that a killed run left unfinished is dropped.

    Raises:
        FileNotFoundError: There is none.
        UnreadableResultsError: It is damaged, or not written by wovenfab.
    """
    required = ESSENTIAL if name == HISTORY else KEYS
    return read_table(Path(directory) / name, required, "time_s", rows)


def index_of_peak(forces: Sequence[float] | NDArray[np.float64]) -> int:
    """Return which of the recorded forces is the peak: the first one of largest size."""
    return int(np.abs(forces).argmax())


def peak_force(forces: Sequence[float] | NDArray[np.float64]) -> float:
    """Return ``peak_force_N``: the recorded force (N) of largest size, with its sign."""
    return float(forces[index_of_peak(forces)])
