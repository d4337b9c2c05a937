"""The errors of a case: of its elements and of its steps, each measured by itself.

Both parts add up to leading order. That of the elements follows with few steps from three
degrees on the mesh of the case; that of the steps on a coarse mesh from three numbers of steps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wovenfab.compat import corners_of
from wovenfab.model.model import Model
from wovenfab.parallel import on_root
from wovenfab.record.field_file import ERROR
from wovenfab.record.fields import FieldSeries
from wovenfab.record.history import index_of_peak
from wovenfab.record.results import write_whole
from wovenfab.sheet.output_nodes import OutputNodes
from wovenfab.study.errors.elements import DegreeRefinement, error_shares
from wovenfab.study.errors.steps import PEAKS
from wovenfab.study.response import Response

Array = NDArray[np.float64]
#: Estimated errors that are stated, over the estimates: these are not exact.
SAFETY = 1.25
ERRORS = "error.csv"


@dataclass(frozen=True)
class Estimate:
    """The errors of a case and where they come from.

    Attributes:
        refinement: Responses with three or four degrees.
        degree: Degree of the elements of the case, the highest or that below it.
        time: Signed errors of the steps over the figures; None where they were not chosen.
        missed: Share of the peak of the force that is missed between steps.
        resolved: Whether elements are small enough for the waves that compressed yarns may form;
            if not, degrees may agree on what is wrong.
    """

    refinement: DegreeRefinement
    degree: int
    time: Mapping[str, float] | None = None
    missed: float = 0.0
    resolved: bool = True

    @property
    def response(self) -> Response:
        """The response with the elements of the case, with few steps."""
        return self.refinement.responses[self.refinement.degrees.index(self.degree)]

    @property
    def space(self) -> dict[str, float]:
        """Signed errors of the elements over the figures."""
        return self.refinement.errors(self.degree)

    @property
    def relative(self) -> dict[str, float]:
        """Size of both errors together over the figure, by name, on the safe side."""
        time, missed = self.time or {}, dict.fromkeys(PEAKS, self.missed)
        return {
            name: stated_error(e, time.get(name, 0.0), missed.get(name, 0.0))
            for name, e in self.space.items()
        }

    @property
    def worst(self) -> float:
        """The largest relative error of all figures."""
        return max(self.relative.values(), default=0.0)

    @property
    def models(self) -> tuple[Model, Model]:
        """Two models by whose difference the error is seen, with their fields.

        They are those of the case's degree and of the next higher one, or else of the highest two.
        """
        responses = self.refinement.responses
        place = min(self.refinement.degrees.index(self.degree), len(responses) - 2)
        return responses[place].model, responses[place + 1].model

    def history(self) -> dict[str, Array]:
        """Return the errors of the elements against time: columns of ``error.csv`` by name."""
        responses, own = self.refinement.responses, self.response
        columns = {"time_s": own.times, "displacement_m": own.displacements}
        answer = {"displacement": ("displacements", "m")} if own.loaded else {}
        names = {"force": ("forces", "N"), "dissipated": ("dissipated", "J"), **answer}
        for what, (name, unit) in names.items():
            values = np.array([getattr(r, name) for r in responses]).T
            errors = [self.refinement.error(v, self.degree) for v in values]
            columns[f"{what}_{unit}"] = getattr(own, name)
            columns[f"{what}_error_of_elements_{unit}"] = np.array(errors)
        return columns


def stated_error(elements: float, steps: float, missed: float = 0.0) -> float:
    """Return the size of all errors on the safe side; they might add up.

    Args:
        elements: Estimated error, which is not exact.
        steps: The same.
        missed: What is missed of a peak, which is measured.
    """
    return SAFETY * (abs(elements) + abs(steps)) + missed


def worst(errors: Mapping[str, float]) -> float:
    """Return the largest of signed errors in size."""
    return max(map(abs, errors.values()), default=0.0)


def write_errors(estimate: Estimate, directory: Path) -> None:
    """Write ``error.csv``, ``error.xdmf`` and ``error.h5``; collective."""
    columns = estimate.history()
    low, high = estimate.models
    comm, mesh = low.comm, low.sheet.mesh
    rows = [
        ",".join(columns),
        *(",".join(map(repr, map(float, r))) for r in zip(*columns.values(), strict=True)),
    ]
    on_root(comm, lambda: write_whole(directory / ERRORS, "\n".join(rows) + "\n"))
    shares = error_shares(low, high)
    corners = mesh.geometry.x[corners_of(mesh)[: len(shares)], :2]
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]) / 2
    series = FieldSeries(
        directory,
        comm,
        OutputNodes(1),
        corners.reshape(-1, 2),
        low.sheet.original_cells[: len(shares)],
        {"error_share": "1", "error_density": "1/m^2"},
        ERROR,
    )
    at_peak = float(columns["time_s"][index_of_peak(columns["force_N"])])
    fields = {"error_share": np.repeat(shares, 3), "error_density": np.repeat(shares / area, 3)}
    series.write(0, at_peak, fields)
