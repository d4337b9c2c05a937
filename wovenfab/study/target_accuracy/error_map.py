"""Where the error of the elements comes from: the energy of the correction, cell by cell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray

from forms.variation import second_variation
from wovenfab.model.compiler import compile_form
from wovenfab.model.model import Model
from wovenfab.parallel import on_root
from wovenfab.record.field_file import ERROR
from wovenfab.record.fields import FieldSeries, Lattice
from wovenfab.record.history import index_of_peak
from wovenfab.record.results import write_whole
from wovenfab.simulation.prolongation import prolongated
from wovenfab.study.target_accuracy.estimate import Estimate

Array = NDArray[np.float64]
ERRORS = "error.csv"


def shares(low: Model, high: Model) -> Array:
    """Return each own cell's share of the error of elements; all together they make 1.

    The error of the energy is half the second variation by the correction, which is the
    difference of the answers of both degrees; that is summed over cells, by size. Facets
    are left out: their part is that of the cells beside them.

    Args:
        low: The model whose field has the error, on the same mesh as
        high: that of higher degree, both with their fields.
    """
    correction = fem.Function(high.space)
    correction.x.array[:] = high.field.x.array - prolongated(low.field.x.array, low, high)
    balance = high.balance
    point, step = balance._point(high.field), balance._vary(correction)
    stored = [t for t in balance.terms if not t.effect.dissipative]
    density = second_variation(balance._density_of(stored), point, step, step)
    test = ufl.TestFunction(fem.functionspace(high.sheet.mesh, ("DG", 0)))
    own = high.sheet.mesh.topology.index_map(2).size_local
    found = np.abs(fem.assemble_vector(compile_form(test * density * balance._dx)).array[:own])
    whole = high.comm.allreduce(float(found.sum()), op=MPI.SUM)
    return np.asarray(found / whole if whole else found)


def write_errors(estimate: Estimate, directory: Path) -> None:
    """Write ``error.csv``, ``error.xdmf`` and ``error.h5``; collective."""
    columns = estimate.history()
    place = estimate.ladder.degrees.index(estimate.degree)
    traces = estimate.ladder.traces
    low, high = traces[place].model, traces[min(place + 1, len(traces) - 1)].model
    comm, mesh = low.comm, low.sheet.mesh
    rows = [
        ",".join(columns),
        *(",".join(map(repr, map(float, r))) for r in zip(*columns.values(), strict=True)),
    ]
    on_root(comm, lambda: write_whole(directory / ERRORS, "\n".join(rows) + "\n"))
    found = shares(low, high)
    corners = mesh.geometry.x[mesh.geometry.dofmap[: len(found)], :2]
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]) / 2
    series = FieldSeries(
        directory,
        comm,
        Lattice(1),
        corners.reshape(-1, 2),
        low.sheet.original_cells[: len(found)],
        {"error_share": "1", "error_density": "1/m^2"},
        ERROR,
    )
    when = float(traces[place].times[index_of_peak(traces[place].forces)])
    fields = {"error_share": np.repeat(found, 3), "error_density": np.repeat(found / area, 3)}
    series.write(0, when, fields)
