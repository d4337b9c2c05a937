"""What an accuracy study varies: methods in space and in time, each with ever finer settings."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import count
from math import log2

from wovenfab.case import Case, Rectangle
from wovenfab.case.program import steps_of_case
from wovenfab.case.quantities import plain
from wovenfab.stepping.schemes import SCHEMES, Scheme
from wovenfab.study.response import with_steps

#: Cells across a rectangle's shorter side with which the mesh sizes start, roughly.
_FIRST_CELLS = {"fibres": 2, "crossed": 5, "right": 5, "unstructured": 5}
#: Planned steps of a study's first run in time, as a share of the case's.
COARSEST = 1 / 4
#: Error of a step in the first run with adaptive steps.
_FIRST_TOLERANCE = 0.02
#: Smallest cells over cells elsewhere where corners alone are graded, at two cells across: then it
#: falls with the mesh size, since corners are singular, which shows with elements of higher order.
_GRADING = 1 / 4


@dataclass(frozen=True)
class Setting:
    """One run of a study.

    Attributes:
        stage: ``space``, ``time`` or ``both``.
        method: Name of the way to discretise: one curve of a work-precision diagram.
        order: Order of the method in theory at best: the elements' degree, or the scheme's.
        what: The mesh size or steps that distinguish it from other runs of the method.
        mesh: Values of the case that make the mesh and the elements.
        steps: Values of the case that make the steps.
        size: What goes to zero where steps adapt, which refines some of them more than others.
    """

    stage: str
    method: str
    order: float
    what: str
    mesh: tuple[str, ...] = field(repr=False)
    steps: tuple[str, ...] = field(repr=False)
    size: float | None = None

    @property
    def overrides(self) -> tuple[str, ...]:
        """Everything that replaces values of the case."""
        return (*self.mesh, *self.steps)

    @property
    def label(self) -> str:
        """The setting in words."""
        return f"{self.method}, {self.what}"


def planned(case: Case, factor: float) -> Case:
    """Return a case with planned steps, in all segments so many times as in the given one."""
    return with_steps(case, factor, fewest=1)


def steps_of(case: Case) -> tuple[str, ...]:
    """Return the values of a case that make its planned steps."""
    programs = (
        f"{name}={json.dumps([plain(segment) for segment in segments])}"
        for name, segments in case.programs.items()
    )
    return f"time.steps_per_cycle={case.time.steps_per_cycle}", *programs


def in_space(case: Case) -> list[Iterator[Setting]]:
    """Return the settings, with coarse steps, of each method in space that is worth comparing.

    Degree, mesh along the fibres or not, and with or without a part of what the singularities
    ask for: jumps of two placements, and for one, cells that are graded by themselves or
    towards the corners alone. The discretisation of the case is among them.
    """
    other = "crossed" if isinstance(case.sheet, Rectangle) else "unstructured"
    part = "no jumps" if case.needs.placements == 2 else "corners alone"
    methods = [
        *((f"P{degree} on fibres", "fibres", degree) for degree in (2, 3, 4)),
        (f"P3 on fibres, {part}", "fibres", 3),
        (f"P2 {other}", other, 2),
    ]
    settings = []
    for name, mesh, degree in methods:
        overrides = (
            f"discretisation.mesh={mesh}",
            f"discretisation.degree={degree}",
            f"discretisation.jumps={'false' if name.endswith('no jumps') else 'null'}",
            "discretisation.corner_size=null",
            "discretisation.penalty=auto",
            "discretisation.quadrature_degree=auto",
        )
        grading = _GRADING if name.endswith("corners alone") else 0.0
        settings.append(_finer_meshes(case, name, overrides, degree, mesh, grading))
    d = case.discretisation
    if d.corner_size or d.penalty != "auto" or d.quadrature_degree != "auto":
        assert d.mesh_size is not None
        grading = (d.corner_size or 0.0) / d.mesh_size
        own = _finer_meshes(case, "as in the case", (), d.degree, d.mesh or "fibres", grading)
        settings.append(own)
    return settings


def _finer_meshes(
    case: Case, name: str, overrides: Sequence[str], degree: int, mesh: str, grading: float
) -> Iterator[Setting]:
    """Yield settings, each with half the mesh size of the last.

    ``grading`` is corner size over mesh size of the first; 0 for none.
    """
    first, steps = _first_size(case, mesh), steps_of(planned(case, COARSEST))
    for level in count():
        size = first / 2**level
        values = [*overrides, f"discretisation.mesh_size={size:.6g} m"]
        what = f"{1e3 * size:.4g} mm"
        if grading:
            corner = size * grading / 2**level
            values.append(f"discretisation.corner_size={corner:.6g} m")
            what += f" (corners {1e3 * corner:.3g} mm)"
        yield Setting("space", name, degree, what, tuple(values), steps)


def _first_size(case: Case, mesh: str) -> float:
    """Return the largest mesh size (m): the case's times a power of two."""
    own = case.discretisation.mesh_size
    assert own is not None
    if not isinstance(case.sheet, Rectangle):
        return 2 * own
    side = min(case.sheet.length, case.sheet.width)
    return min(own * 2.0 ** round(log2(side / _FIRST_CELLS[mesh] / own)), side)


def in_time(case: Case, mesh: Sequence[str]) -> list[Iterator[Setting]]:
    """Return the settings of each method in time on a mesh.

    Every scheme with planned steps, and steps that adapt where their error is known.
    """
    methods = [_finer_steps(case, mesh, scheme, adaptive=False) for scheme in SCHEMES.values()]
    adaptive = [s for s in SCHEMES.values() if s.measures_error] if case.needs.rate else []
    return [*methods, *(_finer_steps(case, mesh, s, adaptive=True) for s in adaptive)]


def _finer_steps(
    case: Case, mesh: Sequence[str], scheme: Scheme, adaptive: bool
) -> Iterator[Setting]:
    """Yield settings, each with about twice the steps of the last."""
    name = f"{scheme.name}, adaptive" if adaptive else scheme.name
    for level in count():
        with_these = planned(case, COARSEST if adaptive else COARSEST * 2**level)
        what, size, tolerance = f"{steps_of_case(with_these)} steps", None, "null"
        if adaptive:
            error = _FIRST_TOLERANCE / 2 ** (scheme.order * level)
            what, tolerance = f"tolerance {100 * error:.2g} %", f"{error:.6g}"
            size = error ** (1 / scheme.order)
        values = (f"time.scheme={scheme.name}", f"time.tolerance={tolerance}")
        steps = (*values, *steps_of(with_these))
        yield Setting("time", name, scheme.order, what, tuple(mesh), steps, size)
