"""The history of a run: one row a step, on disk as soon as the step is done."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import fsum, isfinite
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, TextIO

import numpy as np
from numpy.typing import NDArray

from wovenfab.parallel import on_root, world

if TYPE_CHECKING:
    from mpi4py import MPI

HISTORY = "history.csv"
REACTIONS = "reactions.csv"
#: Columns with the estimated errors of steps.
ERRORS = ("force_error_of_steps_N", "dissipated_error_of_steps_J")


@dataclass(frozen=True)
class StepRecord:
    """What is known of one step when it has converged.

    Attributes:
        step: Number of the step; 0 is the start.
        time: Time (s).
        displacement: Displacement of the driven edge along the program (m).
        force: Reaction on it along the program (N).
        force_transverse: Reaction on it across the program (N).
        stored: Energy stored now by each effect (J).
        dissipated: Energy lost since the start by each effect (J).
        work: Work done by the driven edges since the start (J).
        iterations: Newton iterations of the step.
        reactions: Reaction of each named edge, x and y (N).
        negatives: Negative eigenvalues of the tangent; 0 where the state is a minimum.
        errors: Estimated errors of the steps in force (N) and dissipated energy (J); only where
            the history has them.
    """

    step: int
    time: float
    displacement: float
    force: float
    force_transverse: float
    stored: Mapping[str, float]
    dissipated: Mapping[str, float]
    work: float
    iterations: int
    reactions: Mapping[str, tuple[float, float]]
    negatives: int = 0
    errors: tuple[float, float] | None = None


class History:
    """Writes ``history.csv`` and ``reactions.csv``, row by row; rank 0 writes, all call.

    Totals and the energy imbalance (work - change of stored energy - dissipated energy,
    from the first row on) are computed here, from the numbers that are written.
    """

    def __init__(
        self,
        directory: str | Path,
        stored: Sequence[str],
        dissipated: Sequence[str],
        edges: Sequence[str],
        comm: MPI.Comm | None = None,
        errors: bool = False,
    ) -> None:
        """Start both files with their headers; collective.

        Args:
            directory: The results directory.
            stored: Names of the effects that store energy.
            dissipated: Names of the effects that dissipate energy.
            edges: Names of the edges whose reactions are recorded.
            comm: The ranks that call; all of MPI's if None.
            errors: Whether the errors of steps are recorded, too.
        """
        self._has_errors = errors
        self._comm = world() if comm is None else comm
        self._stored, self._dissipated, self._edges = (
            tuple(stored),
            tuple(dissipated),
            tuple(edges),
        )
        self._initial_energy: float | None = None
        self._last_time = -float("inf")
        self._files: list[TextIO] = []
        on_root(self._comm, lambda: self._open(Path(directory)))

    def append(self, row: StepRecord) -> None:
        """Write one row to both files and flush them; collective.

        Raises:
            ValueError: A number is not finite, the effects or edges are not the announced
                ones, or the time does not grow; then nothing is written.
        """
        on_root(self._comm, lambda: self._write(row))

    def close(self) -> None:
        """Close the files; a second call does nothing."""
        for file in self._files:
            file.close()

    def __enter__(self) -> History:
        """Return the history itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the files."""
        self.close()

    def _open(self, directory: Path) -> None:
        history = (
            ["step", "time_s", "displacement_m", "force_N", "force_transverse_N", "energy_J"]
            + [f"energy_{name}_J" for name in self._stored]
            + ["dissipated_J"]
            + [f"dissipated_{name}_J" for name in self._dissipated]
            + ["work_J", "imbalance_J", *(ERRORS if self._has_errors else ())]
            + ["newton_iterations", "negative_eigenvalues"]
        )
        reactions = ["step", "time_s"] + [f"{e}_{xy}_N" for e in self._edges for xy in "xy"]
        for name, header in ((HISTORY, history), (REACTIONS, reactions)):
            file = (directory / name).open("w", encoding="utf-8", newline="\n")
            self._files.append(file)
            _write_row(file, header)

    def _write(self, row: StepRecord) -> None:
        for what, given, wanted in (
            ("stored energies", row.stored, self._stored),
            ("dissipated energies", row.dissipated, self._dissipated),
            ("reactions", row.reactions, self._edges),
            ("errors", ERRORS if row.errors else (), ERRORS if self._has_errors else ()),
        ):
            if set(given) != set(wanted):
                raise ValueError(
                    f"{what} of {sorted(given)} given, but the history has {sorted(wanted)}"
                )
        if row.time <= self._last_time:
            raise ValueError(f"time {row.time} s comes after {self._last_time} s in the history")
        stored = [float(row.stored[name]) for name in self._stored]
        dissipated = [float(row.dissipated[name]) for name in self._dissipated]
        energy, lost, work = fsum(stored), fsum(dissipated), float(row.work)
        initial = energy if self._initial_energy is None else self._initial_energy
        driven = [float(v) for v in (row.displacement, row.force, row.force_transverse)]
        balance = [work, work - (energy - initial) - lost, *(map(float, row.errors or ()))]
        numbers = [float(row.time), *driven, energy, *stored, lost, *dissipated, *balance]
        reactions = [float(row.reactions[edge][i]) for edge in self._edges for i in (0, 1)]
        bad = [value for value in (*numbers, *reactions) if not isfinite(value)]
        if bad:
            raise ValueError(f"step {row.step} has numbers that are not finite: {row}")
        history, forces = self._files
        counts = [str(int(row.iterations)), str(int(row.negatives))]
        _write_row(history, [str(int(row.step)), *map(repr, numbers), *counts])
        _write_row(forces, [str(int(row.step)), *map(repr, [numbers[0], *reactions])])
        self._initial_energy, self._last_time = initial, numbers[0]


def read_history(directory: str | Path) -> dict[str, NDArray[np.float64]]:
    """Return the columns of ``history.csv`` by name, each of shape (steps,)."""
    return _read(Path(directory) / HISTORY)


def read_reactions(directory: str | Path) -> dict[str, NDArray[np.float64]]:
    """Return the columns of ``reactions.csv`` by name, each of shape (steps,)."""
    return _read(Path(directory) / REACTIONS)


def _write_row(file: TextIO, cells: Sequence[str]) -> None:
    file.write(",".join(cells) + "\n")
    file.flush()


def _read(path: Path) -> dict[str, NDArray[np.float64]]:
    """Read a table; a last row that a killed run left unfinished is dropped."""
    text = path.read_text(encoding="utf-8")
    header, *rows = text[: text.rfind("\n")].split("\n")
    names = header.split(",")
    values = np.array([row.split(",") for row in rows], dtype=np.float64)
    values = values.reshape(len(rows), len(names))
    return {name: values[:, i] for i, name in enumerate(names)}
