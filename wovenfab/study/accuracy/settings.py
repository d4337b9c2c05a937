"""What an accuracy study varies: methods in space and in time, each with ever finer settings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import count
from math import log2

from wovenfab.case import Case, CaseError, Cycles, Rectangle
from wovenfab.case.program import planned_steps
from wovenfab.simulation.response import has_fixed_steps
from wovenfab.stepping.schemes import SCHEMES

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
class Method:
    """A way to discretise: one curve of a work-precision diagram.

    Attributes:
        name: In a few words.
        overrides: Values of the case, as for :func:`wovenfab.case.read_case`.
        order: Order in theory at best: the elements' degree, or the scheme's.
        first_size: Mesh size of the first run, m; 0 for a method in time.
        grading: Corner size over mesh size of the first run; 0 for none.
        tolerance: Error of a step in the first run; 0 for planned steps.
    """

    name: str
    overrides: tuple[str, ...]
    order: float
    first_size: float = 0.0
    grading: float = 0.0
    tolerance: float = 0.0


@dataclass(frozen=True)
class Setting:
    """One run of a study.

    Attributes:
        stage: ``space``, ``time`` or ``both``.
        method: The method's name.
        order: That of the method.
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


@dataclass(frozen=True)
class Steps:
    """Planned steps of a case, all segments multiplied by the same factor."""

    case: Case

    @property
    def can_vary(self) -> bool:
        """Whether there is a segment whose steps are not given one by one."""
        return not has_fixed_steps(self.case)

    def planned(self, factor: float) -> int:
        """Return the number of planned steps."""
        scaled = (
            s if number is None else s.model_copy(update={"steps": number})
            for s, number in zip(self.case.program, self._counts(factor), strict=True)
        )
        return planned_steps(scaled, self._per_cycle(factor))

    def with_factor(self, factor: float) -> tuple[str, ...]:
        """Return the values of the case that multiply its steps."""
        cyclic = any(isinstance(s, Cycles) for s in self.case.program)
        values = [f"time.steps_per_cycle={self._per_cycle(factor)}"] if cyclic else []
        for place, number in enumerate(self._counts(factor)):
            if number is not None:
                values.append(f"{self._place(place)}.steps={number}")
        return tuple(values)

    def _per_cycle(self, factor: float) -> int:
        return max(2 * round(factor * self.case.time.steps_per_cycle / 2), 4)

    def _counts(self, factor: float) -> list[int | None]:
        """Return the steps of each segment that says how many it has."""
        given = [getattr(segment, "steps", None) for segment in self.case.program]
        return [steps and max(round(factor * steps), 1) for steps in given]

    def _place(self, number: int) -> str:
        """Return the key of a segment: a program of one may be written without a list."""
        try:
            self.case.changed("program.steps=1")
        except CaseError:
            return f"program.{number}"
        return "program"


def space_methods(case: Case) -> list[Method]:
    """Return the methods in space that are worth comparing for a case; its own is among them.

    Degree, mesh along the fibres or not, and with or without a part of what the singularities
    ask for: jumps of two placements, and for one, cells that are graded by themselves or
    towards the corners alone.
    """
    two = case.needs.placements == 2
    kinds = [("fibres", degree, "default") for degree in (2, 3, 4)]
    kinds += [("fibres", 3, "no jumps" if two else "corners alone"), ("crossed", 2, "")]
    if not isinstance(case.sheet, Rectangle):
        kinds = [("unstructured" if k == "crossed" else k, d, s) for k, d, s in kinds]
    methods = [_method(case, *kind) for kind in kinds]
    d = case.discretisation
    if d.corner_size or d.penalty != "auto" or d.quadrature_degree != "auto":
        assert d.mesh_size is not None
        grading = (d.corner_size or 0.0) / d.mesh_size
        first = _first(case, d.mesh or "fibres")
        methods.append(Method("as in the case", (), d.degree, first, grading))
    return methods


def _method(case: Case, mesh: str, degree: int, kind: str) -> Method:
    words = {"default": "on fibres", "": mesh}
    name = f"P{degree} {words.get(kind, f'on fibres, {kind}')}"
    jumps = "false" if kind == "no jumps" else "null"
    where = mesh if isinstance(case.sheet, Rectangle) or mesh == "fibres" else "unstructured"
    overrides = (
        f"discretisation.mesh={where}",
        f"discretisation.degree={degree}",
        f"discretisation.jumps={jumps}",
        "discretisation.corner_size=null",
        "discretisation.penalty=auto",
        "discretisation.quadrature_degree=auto",
    )
    return Method(
        name, overrides, degree, _first(case, mesh), _GRADING if kind == "corners alone" else 0.0
    )


def _first(case: Case, mesh: str) -> float:
    """Return the largest mesh size (m): the case's times a power of two."""
    own = case.discretisation.mesh_size
    assert own is not None
    if not isinstance(case.sheet, Rectangle):
        return 2 * own
    side = min(case.sheet.length, case.sheet.width)
    return min(own * 2.0 ** round(log2(side / _FIRST_CELLS[mesh] / own)), side)


def space_refinement(method: Method, coarse_steps: Sequence[str]) -> Iterator[Setting]:
    """Yield the settings of a method in space, each with half the mesh size of the last."""
    for level in count():
        size = method.first_size / 2**level
        overrides = [*method.overrides, f"discretisation.mesh_size={size:.6g} m"]
        what = f"{1e3 * size:.4g} mm"
        if method.grading:
            corner = size * method.grading / 2**level
            overrides.append(f"discretisation.corner_size={corner:.6g} m")
            what += f" (corners {1e3 * corner:.3g} mm)"
        yield Setting(
            "space", method.name, method.order, what, tuple(overrides), tuple(coarse_steps)
        )


def time_methods(case: Case) -> list[Method]:
    """Return the methods in time: every scheme, and steps that adapt where their error is known."""
    equal = [Method(s.name, (f"time.scheme={s.name}",), s.order) for s in SCHEMES.values()]
    if not case.needs.rate:
        return equal
    adaptive = SCHEMES["bdf2"]
    overrides = (f"time.scheme={adaptive.name}",)
    return [
        *equal,
        Method(f"{adaptive.name}, adaptive", overrides, adaptive.order, tolerance=_FIRST_TOLERANCE),
    ]


def time_refinement(method: Method, mesh: Sequence[str], steps: Steps) -> Iterator[Setting]:
    """Yield the settings of a method on a mesh, each with about twice the steps of the last."""
    steps_of = _adaptive if method.tolerance else _equal
    for level in count():
        what, size, values = steps_of(method, steps, level)
        overrides = (*method.overrides, *values)
        yield Setting("time", method.name, method.order, what, tuple(mesh), overrides, size)


#: Steps in words, what their length is proportional to where their number does not tell, and
#: their values of the case.
_Steps = tuple[str, float | None, tuple[str, ...]]


def _equal(_: Method, steps: Steps, level: int) -> _Steps:
    factor = COARSEST * 2**level
    values = ("time.tolerance=null", *steps.with_factor(factor))
    return f"{steps.planned(factor)} steps", None, values


def _adaptive(method: Method, steps: Steps, level: int) -> _Steps:
    tolerance = method.tolerance / 2 ** (method.order * level)
    values = (f"time.tolerance={tolerance:.6g}", *steps.with_factor(COARSEST))
    return f"tolerance {100 * tolerance:.2g} %", tolerance ** (1 / method.order), values
