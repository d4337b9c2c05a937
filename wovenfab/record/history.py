"""The history of a run: one row a step, on disk as soon as the step is done."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from math import fsum, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

import numpy as np
from numpy.typing import NDArray

from wovenfab.parallel import on_root, world

if TYPE_CHECKING:
    from mpi4py import MPI

    from wovenfab.stepping.step import Step

HISTORY = "history.csv"
REACTIONS = "reactions.csv"
#: Columns with the estimated errors of the time steps.
ERRORS = ("force_error_of_steps_N", "dissipated_error_of_steps_J")


@dataclass(frozen=True)
class StepRecord:
    """A row of the history as plain values, for callers that have no ``Step``."""

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


class History(AbstractContextManager["History"]):
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
            comm: The ranks that call; the world communicator if None.
            errors: Whether there are columns for the estimated errors of the time steps.
        """
        self._comm = world() if comm is None else comm
        self._stored, self._dissipated = tuple(stored), tuple(dissipated)
        self._edges, self._errors = tuple(edges), ERRORS if errors else ()
        self._initial_energy: float | None = None
        self._last_time = -float("inf")
        self._files: list[TextIO] = []
        on_root(self._comm, lambda: self._open(Path(directory)))

    def append(
        self,
        step: Step | StepRecord,
        force: tuple[float, float] = (0.0, 0.0),
        errors: tuple[float, float] | None = None,
    ) -> None:
        """Write one row to both files and flush them; collective.

        Args:
            step: The accepted step. A ``StepRecord`` brings its own force and errors.
            force: Reaction on the driven edge (N), along the program and across it.
            errors: Estimated errors of the time steps in force (N) and in dissipated
                energy (J), if the history has columns for them.

        Raises:
            ValueError: A number is not finite, the effects or edges are not the announced
                ones, or the time does not increase; then nothing is written.
        """
        if isinstance(step, StepRecord):
            force, errors = (step.force, step.force_transverse), step.errors
        on_root(self._comm, lambda: self._write(step, force, errors or ()))

    def close(self) -> None:
        """Close the files; a second call does nothing."""
        for file in self._files:
            file.close()

    def __exit__(self, *_: object) -> None:
        """Close the files."""
        self.close()

    def _open(self, directory: Path) -> None:
        history = (
            ["step", "time_s", "displacement_m", "force_N", "force_transverse_N", "energy_J"]
            + [f"energy_{name}_J" for name in self._stored]
            + ["dissipated_J"]
            + [f"dissipated_{name}_J" for name in self._dissipated]
            + ["work_J", "imbalance_J", *self._errors]
            + ["newton_iterations", "negative_eigenvalues"]
        )
        reactions = ["step", "time_s"] + [f"{e}_{xy}_N" for e in self._edges for xy in "xy"]
        for name, header in ((HISTORY, history), (REACTIONS, reactions)):
            file = (directory / name).open("w", encoding="utf-8", newline="\n")
            self._files.append(file)
            _write_row(file, header)

    def _write(
        self, step: Step | StepRecord, force: tuple[float, float], errors: Sequence[float]
    ) -> None:
        for what, given, announced in (
            ("stored energies", step.stored, self._stored),
            ("dissipated energies", step.dissipated, self._dissipated),
            ("reactions", step.reactions, self._edges),
            ("errors", ERRORS if errors else (), self._errors),
        ):
            if set(given) != set(announced):
                raise ValueError(
                    f"{what} of {sorted(given)} given, but the history has {sorted(announced)}"
                )
        number = int(step.step if isinstance(step, StepRecord) else step.number)
        if step.time <= self._last_time:
            raise ValueError(f"time {step.time} s comes after {self._last_time} s in the history")
        stored = [float(step.stored[name]) for name in self._stored]
        dissipated = [float(step.dissipated[name]) for name in self._dissipated]
        energy, lost, work = fsum(stored), fsum(dissipated), float(step.work)
        initial = energy if self._initial_energy is None else self._initial_energy
        driven = [float(value) for value in (step.time, step.displacement, *force)]
        balance = [work, work - (energy - initial) - lost, *map(float, errors)]
        numbers = [*driven, energy, *stored, lost, *dissipated, *balance]
        reactions = [float(component) for e in self._edges for component in step.reactions[e]]
        if not all(map(isfinite, (*numbers, *reactions))):
            raise ValueError(f"step {number} has numbers that are not finite: {step}")
        history, forces = self._files
        counts = int(step.iterations), int(step.negatives)
        _write_row(history, [str(number), *map(repr, numbers), *map(str, counts)])
        _write_row(forces, [str(number), *map(repr, [numbers[0], *reactions])])
        self._initial_energy, self._last_time = initial, numbers[0]


def read_history(directory: str | Path, name: str = HISTORY) -> dict[str, NDArray[np.float64]]:
    """Return the columns of a table by name, each of shape (steps,).

    A last row that a killed run left unfinished is dropped.
    """
    text = (Path(directory) / name).read_text(encoding="utf-8")
    header, *rows = text[: text.rfind("\n")].split("\n")
    names = header.split(",")
    values = np.array([row.split(",") for row in rows], dtype=np.float64)
    values = values.reshape(len(rows), len(names))
    return {column: values[:, i] for i, column in enumerate(names)}


def index_of_peak(forces: Sequence[float] | NDArray[np.float64]) -> int:
    """Return which of the recorded forces is the peak: the first one of largest size."""
    return int(np.abs(forces).argmax())


def peak_force(forces: Sequence[float] | NDArray[np.float64]) -> float:
    """Return ``peak_force_N``: the recorded force (N) of largest size, with its sign."""
    return float(forces[index_of_peak(forces)])


def _write_row(file: TextIO, cells: Sequence[str]) -> None:
    file.write(",".join(cells) + "\n")
    file.flush()
