"""A results directory like that of a bias-extension run, from closed formulas.

The placement is the exact one of an inextensible net, chi = a(X·D_1) + b(X·D_2) with unit
a' and b': both clamps move rigidly and the centre shears. A small slip, which jumps across
the fibres through the clamped corners, is laid over it.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.integrate import cumulative_simpson
from scipy.optimize import brentq

from wovenfab.record.fields import FieldSeries
from wovenfab.record.history import HistoryRows, HistoryWriter, read_history
from wovenfab.record.results import open_results
from wovenfab.record.summary import summarise, write_summary
from wovenfab.sheet.output_nodes import OutputNodes
from wovenfab.stepping.step import Step

Array = NDArray[np.float64]
LENGTH, WIDTH, SLIP, ROUNDING = 0.9, 0.3, 2e-3, 0.02
FIBRES = np.array([[1.0, 1.0], [1.0, -1.0]]) / np.sqrt(2)
CASE = """\
title: {title}
sheet:
  shape: rectangle
  length: 0.9
  width: 0.3
  fibres: [45 deg, -0.7853981633974483]
"""
UNITS = {
    "displacement_1": "m",
    "displacement_2": "m",
    "relative_displacement": "m",
    "beta": "m",
    "curvature_1": "1/m",
    "curvature_2": "1/m",
    "shear_angle": "rad",
    "stretch_1": "1",
    "stretch_2": "1",
}
SINGLE = {"displacement": "m", "shear_angle": "rad"}


def angle(s: Array, start: float, end: float, turn: float) -> Array:
    """Return the yarn angle (rad): 45 degrees, less by ``turn`` between start and end."""
    step = np.tanh((s - start) / ROUNDING) - np.tanh((s - end) / ROUNDING)
    return np.pi / 4 - turn / 2 * step


def yarn(s: Array, start: float, end: float, turn: float) -> Array:
    """Return the inextensible curve (m), shape (len(s), 2), that is s·(1, 1)/√2 at rest."""
    grid = np.linspace(-WIDTH, LENGTH + WIDTH, 4001)
    phi = angle(grid, start, end, turn)
    tangent = np.column_stack([np.cos(phi), np.sin(phi)])
    curve = cumulative_simpson(tangent, x=grid, axis=0, initial=0)
    curve += tangent[0] * (grid[0])
    return np.column_stack([np.interp(s, grid, curve[:, i]) for i in (0, 1)])


def placement(points: Array, turn: float) -> Array:
    """Return the placement (m) of the bonded net, shape of ``points``."""
    s1, s2 = points @ FIBRES[0], points @ FIBRES[1]
    r = np.sqrt(2)
    a = yarn(s1, WIDTH / r, LENGTH / r, turn)
    b = yarn(s2, 0.0, (LENGTH - WIDTH) / r, turn) * [1, -1]
    return a + b


def turn_of(displacement: float) -> float:
    """Return the turn (rad) of the yarns at which the right clamp has moved so far (m)."""
    corner = np.array([[LENGTH, WIDTH / 2]])
    return brentq(
        lambda turn: placement(corner, turn)[0, 0] - LENGTH - displacement, -0.1, np.pi / 4
    )


def slips(points: Array, side: Array, displacement: float) -> tuple[Array, Array]:
    """Return the slip of each family along its yarns (m), which jumps at the corner fibres."""
    x, y = points.T
    bump = np.sin(np.pi * np.clip((x - WIDTH / 2) / (LENGTH - WIDTH), 0, 1)) ** 2
    size = SLIP * displacement / 0.06
    s = [
        size * bump * (np.cos(2 * np.pi * (x + sign * (y - WIDTH / 2)) / LENGTH) + 0.3 * jump)
        for sign, jump in zip((1, -1), side, strict=True)
    ]
    return s[0][:, None] * FIBRES[0] / 2, s[1][:, None] * FIBRES[1] / 2


def fields(points: Array, side: Array, displacement: float) -> dict[str, Array]:
    """Return all fields at the points, as a run writes them."""
    turn = turn_of(displacement)
    mean = placement(points, turn)
    first, second = slips(points, side, displacement)
    r = np.sqrt(2)
    bounds = ((WIDTH / r, LENGTH / r), (0.0, (LENGTH - WIDTH) / r))
    phi = [partial(angle, start=start, end=end, turn=turn) for start, end in bounds]
    s = [points @ d for d in FIBRES]
    h = 1e-5
    curvature = [np.abs(f(t + h) - f(t - h)) / (2 * h) for f, t in zip(phi, s, strict=True)]
    relative = second - first
    return {
        "displacement_1": mean + first - points,
        "displacement_2": mean + second - points,
        "relative_displacement": relative,
        "beta": np.hypot(*relative.T),
        "curvature_1": curvature[0],
        "curvature_2": curvature[1],
        "shear_angle": np.pi / 2 - phi[0](s[0]) - phi[1](s[1]),
        "stretch_1": np.zeros(len(points)),
        "stretch_2": np.zeros(len(points)),
    }


def mesh(size: float = 0.05) -> Array:
    """Return the corners (m) of a crossed mesh, shape (cells, 3, 2)."""
    cells = []
    for x in np.arange(round(LENGTH / size)) * size:
        for y in np.arange(round(WIDTH / size)) * size:
            ring = np.array([[x, y], [x + size, y], [x + size, y + size], [x, y + size]])
            centre = ring.mean(axis=0)
            cells += [[ring[i], ring[(i + 1) % 4], centre] for i in range(4)]
    return np.array(cells)


def on_lattices(lattice: OutputNodes, cells: Array) -> Array:
    """Return the points (m) of a lattice on each cell, given by its corners: shape (n, 2)."""
    shape = np.column_stack([1 - lattice.points.sum(axis=1), lattice.points])
    return np.einsum("pk,ckd->cpd", shape, cells).reshape(-1, 2)


def cycles(amplitudes: list[float], speed: float = 0.5, count: int = 80) -> tuple[Array, ...]:
    """Return time, displacement and its rate of growing cycles, and the cycles' bounds."""
    periods = np.pi * np.array(amplitudes) / speed
    bounds = np.concatenate([[0], np.cumsum(periods)])
    time, u, rate = [np.zeros(1)], [np.zeros(1)], [np.zeros(1)]
    for start, period, amplitude in zip(bounds, periods, amplitudes, strict=False):
        phase = 2 * np.pi * np.arange(1, count + 1) / count
        time.append(start + period * phase / (2 * np.pi))
        u.append(amplitude / 2 * (1 - np.cos(phase)))
        rate.append(speed * np.sin(phase))
    return np.concatenate(time), np.concatenate(u), np.concatenate(rate), bounds


def steps(time: Array, u: Array, rate: Array) -> list[tuple[Step, float]]:
    """Return the steps of a hardening spring beside a rounded slider, with their force (N)."""

    def integral(force: Array) -> Array:
        return np.concatenate([[0], np.cumsum(np.diff(u) * (force[1:] + force[:-1]) / 2)])

    friction = 60 * np.tanh(6 * rate) * np.sqrt(u / 0.06)
    force = 4e3 * u + 3e6 * u**3 + friction
    work, lost = integral(force), integral(friction)
    return [
        (
            Step(
                number=i,
                time=time[i],
                displacement=u[i],
                reactions={"left": (-force[i], 0.0), "right": (force[i], 0.0)},
                stored={"stretch": work[i] - lost[i]},
                dissipated={"slip_friction": lost[i]},
                work=work[i],
                iterations=4,
                cutbacks=0,
                milestone=None,
            ),
            force[i],
        )
        for i in range(len(time))
    ]


def make(
    directory: Path,
    amplitudes: list[float] | None = None,
    placements: int = 2,
    every: int = 20,
    title: str = "Bias extension 1:3, made from formulas",
    stop: int | None = None,
) -> Path:
    """Write the results directory of a made-up run and return it.

    Args:
        directory: Where to.
        amplitudes: Amplitude of each cycle (m); 20, 40 and 60 mm if None.
        placements: 1 or 2.
        every: Steps between two writings of the fields.
        title: Title of the case.
        stop: Number of rows after which the run ends early.
    """
    comm = MPI.COMM_SELF
    time, u, rate, bounds = cycles(amplitudes or [0.02, 0.04, 0.06])
    open_results(directory, comm=comm)
    (directory / "case.yaml").write_text(CASE.format(title=json.dumps(title)))
    lattice, corners = OutputNodes(3), mesh()
    points = on_lattices(lattice, corners)
    centres = np.repeat(corners.mean(axis=1), len(lattice.points), axis=0)
    side = np.array([np.sign(centres[:, 1] - centres[:, 0]), np.sign(WIDTH - centres.sum(axis=1))])
    cells = np.arange(len(corners))
    units = UNITS if placements == 2 else SINGLE
    series = FieldSeries(directory, comm, lattice, points, cells, units)
    rows = HistoryRows(["stretch"], ["slip_friction"], ["left", "right"])
    with HistoryWriter(directory, rows, comm) as history:
        for step, force in steps(time, u, rate)[:stop]:
            history.append(replace(step, force=force))
            if step.number % every == 0:
                values = fields(points, side, step.displacement)
                values["displacement"] = (values["displacement_1"] + values["displacement_2"]) / 2
                series.write(step.number, step.time, {name: values[name] for name in units})
    summary = summarise(
        read_history(directory),
        list(pairwise(bounds)),
        outcome="finished",
        unknowns=2 * len(points),
        cut_backs=0,
        seconds={"solve": 1.0},
        ranks=1,
    )
    write_summary(directory, summary, comm)
    return directory


if __name__ == "__main__":
    make(Path(sys.argv[1]))
