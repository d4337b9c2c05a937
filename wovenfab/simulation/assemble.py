"""From a case to the sheet, model, constraints, program and solver that it describes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from math import pi
from pathlib import Path
from typing import Any

from mpi4py import MPI

from forms.catalogue import effects
from wovenfab.case import Case, Component, Cycles, Hold, Ramp, Rectangle, Table
from wovenfab.model.constraints import Constraints, Grip, Held
from wovenfab.model.model import Model, Numerics, build_model
from wovenfab.sheet.gmsh_model import from_file, graded_rectangle
from wovenfab.sheet.rectangle import rectangle
from wovenfab.sheet.sheet import Sheet, directions
from wovenfab.solver.equilibrium import Controls, Equilibrium
from wovenfab.stepping.program import Program, Stretch, cycle, program_of, ramp, table
from wovenfab.stepping.scheme import SCHEMES, Scheme


class UnknownEdgeError(Exception):
    """A case names an edge that its sheet does not have.

    Attributes:
        edge: The name.
        known: Names of the sheet's edges.
    """

    def __init__(self, edge: str, known: Sequence[str]) -> None:
        """Keep both for the message."""
        super().__init__(f"the sheet has no edge {edge!r}; it has {', '.join(known)}")
        self.edge, self.known = edge, tuple(known)


def sheet_of(case: Case, comm: MPI.Comm) -> Sheet:
    """Return the meshed sheet of a case; collective.

    Raises:
        GeometryError: If a geometry file cannot be meshed, on every rank.
        UnknownEdgeError: If a condition is for an edge that the sheet lacks.
    """
    d = case.discretisation
    if isinstance(case.sheet, Rectangle):
        length, width = case.sheet.length, case.sheet.width
        assert d.mesh_size is not None  # a case that has been read has one
        size = d.mesh_size
        if d.mesh == "unstructured":
            parts = graded_rectangle(comm, length, width, size, d.corner_size)
        else:
            parts = rectangle(comm, length, width, size, d.mesh or "crossed")
    else:
        parts = from_file(comm, Path(case.sheet.file), d.mesh_size)
    sheet = Sheet(*parts, directions(case.sheet.fibres))
    for name in case.boundary:
        if name not in sheet.edges:
            raise UnknownEdgeError(name, sorted(sheet.edges))
    return sheet


def model_of(case: Case, sheet: Sheet) -> Model:
    """Return the compiled model of a case on a sheet; collective."""
    d = case.discretisation
    return build_model(
        sheet,
        [effects()[name] for name in case.effects],
        case.effects,
        Numerics(
            degree=d.degree,
            quadrature=None if d.quadrature_degree == "auto" else d.quadrature_degree,
            penalty=None if d.penalty == "auto" else d.penalty,
            history=scheme_of(case).memory,
            mixed=case.solver.tangent == "mixed",
        ),
        [name for name, edge in case.boundary.items() if edge.rotation],
    )


def constraints_of(case: Case, model: Model) -> Constraints:
    """Return the prescribed placements of a case."""
    grips: dict[str, Grip] = {
        name: (_held(edge.components[0]), _held(edge.components[1]))
        for name, edge in case.boundary.items()
    }
    return Constraints(model.space, model.sheet, grips)


def _held(component: Component) -> Held | None:
    return Held(component.factor, component.offset) if component.held else None


def equilibrium_of(case: Case, model: Model, constraints: Constraints) -> Equilibrium:
    """Return the solver of a case."""
    s = case.solver
    return Equilibrium(model, constraints, Controls(s.max_iterations, s.tolerance, s.petsc))


def scheme_of(case: Case) -> Scheme:
    """Return the time scheme of a case."""
    return SCHEMES[case.time.scheme]


def driven_edge(case: Case) -> tuple[str, tuple[float, float]]:
    """Return the first edge that the program moves, and its direction of motion."""
    for name, edge in case.boundary.items():
        if edge.moves:
            x, y = (c.factor for c in edge.components)
            size = (x * x + y * y) ** 0.5
            return name, (x / size, y / size)
    raise ValueError("no edge follows the program")  # a validated case has one


def program_of_case(case: Case) -> Program:
    """Return the load program of a case; each segment starts where the last one ended."""
    stretches: list[Stretch] = []
    position = 0.0
    for segment in case.program:
        added, position = _stretches(segment, position, case.time.steps_per_cycle)
        stretches += added
    return program_of(stretches)


def _stretches(segment: Any, start: float, per_cycle: int) -> tuple[list[Stretch], float]:
    """Return a segment's stretches and the displacement (m) at its end."""
    if isinstance(segment, Cycles):
        turn = partial(cycle, start, steps=per_cycle)
        period = _period(segment)
        return [s for a in segment.amplitudes for s in turn(a, period=period(a))], start
    if isinstance(segment, Ramp):
        way = abs(segment.to - start)
        duration = segment.duration or (way / segment.velocity if segment.velocity else 1.0)
        return [ramp(start, segment.to, duration, segment.steps)], segment.to
    if isinstance(segment, Hold):
        return [ramp(start, start, segment.duration, segment.steps)], start
    assert isinstance(segment, Table)
    displacements = segment.samples.displacements
    return table(start, segment.samples.times, displacements), displacements[-1]


def _period(segment: Cycles) -> Any:
    """Return the period (s) as a function of the amplitude (m)."""
    if segment.frequency is not None:
        frequency = segment.frequency
        return lambda amplitude: 1 / frequency
    assert segment.max_velocity is not None
    velocity = segment.max_velocity
    return lambda amplitude: pi * amplitude / velocity
