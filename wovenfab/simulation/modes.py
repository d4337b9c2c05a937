"""Losses of stability on disk: the modes as fields, and the figures of each."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wovenfab.model.fields import FieldProbe
from wovenfab.model.model import Model
from wovenfab.record.field_file import MODE
from wovenfab.record.fields import FieldSeries, Lattice
from wovenfab.stepping.stability import StabilityLoss


class Modes:
    """Writes ``mode.h5`` and ``mode.xdmf``: at each loss the displacement and the mode.

    Attributes:
        figures: Of each loss: its time (s), displacement (m), how far from there the first
            saddle is (m), force on the driven edge along the program (N), and the number
            of negative eigenvalues there.
    """

    def __init__(
        self, model: Model, directory: Path, edge: str, direction: tuple[float, float]
    ) -> None:
        """Write nothing yet.

        Args:
            model: The model.
            directory: The results directory.
            edge: The driven edge.
            direction: Along the program, shape (2,).
        """
        self._model, self._directory = model, directory
        self._edge, self._direction = edge, direction
        self._files: tuple[FieldProbe, FieldSeries] | None = None
        self.figures: list[dict[str, float]] = []

    def add(self, loss: StabilityLoss) -> None:
        """Write a loss; collective. The model's field is left as it is."""
        probe, series = self._files = self._files or self._start()
        data = {}
        for part, values in (("displacement", loss.saddle), ("mode", loss.mode)):
            for name, found in self._evaluated(probe, values).items():
                data[name.replace("displacement", part)] = found
        series.write(len(self.figures), loss.time, data)
        self.figures.append(
            {
                "time_s": loss.time,
                "displacement_m": loss.displacement,
                "known_to_m": abs(loss.increment),
                "force_N": float(np.dot(self._direction, loss.reactions[self._edge])),
                "negative_eigenvalues": loss.negatives,
            }
        )

    def _start(self) -> tuple[FieldProbe, FieldSeries]:
        lattice = Lattice(self._model.balance.degree)
        probe = FieldProbe(self._model, ["displacement"], lattice.points)
        units = {f.name: f.unit for f in probe.fields}
        series = FieldSeries(
            self._directory,
            self._model.comm,
            lattice,
            probe.positions().reshape(-1, 2),
            self._model.sheet.original_cells[probe.cells],
            units | {name.replace("displacement", "mode"): "1" for name in units},
            MODE,
        )
        return probe, series

    def _evaluated(
        self, probe: FieldProbe, values: NDArray[np.float64]
    ) -> dict[str, NDArray[np.float64]]:
        """Return the displacements of given unknowns at the points, shape (n, 2)."""
        field = self._model.field.x.array
        kept = field.copy()
        field[:] = values
        found = probe.values()
        field[:] = kept
        return {name: v.reshape(-1, v.shape[2]) for name, v in found.items()}
