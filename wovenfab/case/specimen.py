"""Which standard test a case is: from how the sheet is held, and how the program moves it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray
from shapely import get_coordinates

from wovenfab.case.boundary import EDGES, Boundary, EdgeCondition, conditions_of, programs_in
from wovenfab.case.program import Finding, SegmentSection, reached
from wovenfab.case.schema import OutputSection, Rectangle, ZoneSection
from wovenfab.record.bias_extension import BiasExtension
from wovenfab.record.figures import StandardTest
from wovenfab.record.jaws import Jaws
from wovenfab.record.kes import WIDTHS, KesShear, KesTension
from wovenfab.record.picture_frame import PictureFrame

if TYPE_CHECKING:
    from wovenfab.case.case import Case
    from wovenfab.sheet.sheet import Sheet

Array = NDArray[np.float64]
#: Names of standard tests.
TestName = Literal["kes-shear", "kes-tension", "picture-frame", "bias-extension"]
#: Rounding error of lengths, displacements and directions, relative.
ROUNDING = 1e-6
TWO_JAWS = "Hold two opposite edges, and leave the others out."


class OtherTestError(Exception):
    """A case is not the test that it is taken for.

    Attributes:
        reason: Why, in words.
        remedy: What to do.
    """

    def __init__(self, reason: str, remedy: str = TWO_JAWS) -> None:
        """Keep both."""
        super().__init__(reason)
        self.reason, self.remedy = reason, remedy


@dataclass(frozen=True)
class Shape:
    """A sheet at rest.

    Attributes:
        edges: Points of each named edge, its ends among them, shape (n, 2), m.
        area: m^2.
    """

    edges: Mapping[str, Array]
    area: float


@dataclass(frozen=True)
class Setup:
    """What makes a case one test or another.

    Attributes:
        shape: The sheet.
        fibres: Directions of both families, shape (2, 2).
        boundary: Conditions on its edges.
        program: The first program.
        zones: Corners at rest of each zone that is a probe, shape (n, 2), m.
    """

    shape: Shape
    fibres: Array
    boundary: Boundary
    program: Sequence[SegmentSection]
    zones: Mapping[str, Array]

    def sign(self, direction: Array) -> float:
        """Return 1 where the families' angle grows as both turn to a direction, else -1."""
        one, two = self.fibres @ direction
        return float(np.sign(one * two))


def rectangle_shape(sheet: Rectangle) -> Shape:
    """Return the shape of a rectangle."""
    sides = np.array([sheet.length, sheet.width])
    edges = {name: np.array(ends) * sides for name, ends in EDGES.items()}
    return Shape(edges, sheet.length * sheet.width)


def mesh_shape(sheet: Sheet, names: Sequence[str]) -> Shape:
    """Return the shape of a meshed sheet with the edges named; collective."""
    return Shape({name: sheet.edge_points(name) for name in names}, sheet.area())


def setup_of(
    shape: Shape,
    fibres: tuple[float, float],
    boundary: Boundary,
    program: Sequence[SegmentSection],
    output: OutputSection,
) -> Setup:
    """Return what makes a case one test or another, from its sections."""
    zones = {
        name: get_coordinates(probe.probe.region)
        for name, probe in output.probes.items()
        if isinstance(probe, ZoneSection)
    }
    return Setup(shape, np.array([_unit(angle) for angle in fibres]), boundary, program, zones)


def standard_test(name: TestName, setup: Setup) -> StandardTest:
    """Return a standard test as a case sets it up.

    Raises:
        OtherTestError: It is not that test.
    """
    return _TESTS[name](setup)


def other_tests(names: Sequence[TestName], setup: Setup) -> Iterator[Finding]:
    """Yield each test that a case names in ``figures`` and is not, and the remedy."""
    for i, name in enumerate(names):
        try:
            standard_test(name, setup)
        except OtherTestError as error:
            yield ("figures", i), f"this is no test of {name}: {error.reason}", error.remedy


def standard_tests_of(case: Case) -> tuple[StandardTest, ...]:
    """Return the standard tests that a case with a rectangle names; they measure by no zone."""
    if not isinstance(case.sheet, Rectangle):
        return ()
    shape, output = rectangle_shape(case.sheet), OutputSection()
    setup = setup_of(shape, case.sheet.fibres, case.boundary, case.program, output)
    return tuple(standard_test(name, setup) for name in case.figures)


#: A test whose shear angle follows from its displacement.
ShearTest = BiasExtension | PictureFrame


def shear_test_of(case: Case) -> ShearTest | None:
    """Return the test if a rectangle is set up as bias extension or picture frame, else None."""
    return _test_of(case, _bias_extension) or _test_of(case, _picture_frame)


def bias_extension_of(case: Case) -> BiasExtension | None:
    """Return the test if a rectangle is set up as one of bias extension, else None."""
    return _test_of(case, _bias_extension)


def _test_of[T](case: Case, test: Callable[[Setup], T]) -> T | None:
    """Return the test if a rectangle is set up as it, else None."""
    if not isinstance(case.sheet, Rectangle):
        return None
    shape = rectangle_shape(case.sheet)
    setup = setup_of(shape, case.sheet.fibres, case.boundary, case.program, case.output)
    try:
        return test(setup)
    except OtherTestError:
        return None


def _bias_extension(setup: Setup) -> BiasExtension:
    """Return the test of a rectangle that is pulled along its long side, yarns at 45 degrees."""
    jaws = _jaws(setup, along=False)
    if jaws.distance < 2 * jaws.width * (1 - ROUNDING):
        reason = f"the jaws are {jaws.distance:g} m apart, and {jaws.width:g} m wide"
        raise OtherTestError(reason, "The sample is twice as long as wide at least.")
    pull = np.array(jaws.direction)
    if not np.allclose((setup.fibres @ pull) ** 2, 0.5, rtol=0, atol=ROUNDING):
        raise OtherTestError(
            "the families are not at 45° to the pull", "For example 'fibres: [45 deg, -45 deg]'."
        )
    plain = BiasExtension(jaws)
    zones = (name for name, corners in setup.zones.items() if plain.in_centre(corners).all())
    return BiasExtension(jaws, next(zones, None), setup.sign(pull))


def _kes_shear(setup: Setup) -> KesShear:
    """Return the test of jaws that move along themselves, yarns along and across them."""
    jaws = _jaws(setup, along=True)
    aligned = np.abs(setup.fibres @ np.array(jaws.direction))
    if not np.allclose(np.sort(aligned), [0, 1], rtol=0, atol=ROUNDING):
        remedy = "One family runs from jaw to jaw, the other one along them."
        raise OtherTestError("the families are not along and across the jaws", remedy)
    test = KesShear(jaws)
    angles = test.shear_angle(jaws.travel(np.array(reached(setup.program))))
    least = max(WIDTHS.values())
    moves_by_force = len(angles) < 2
    if not moves_by_force and (angles.max() < least or angles.min() > -least):
        low, high = np.degrees([angles.min(), angles.max()])
        reason = f"the program shears from {low:.3g}° to {high:.3g}° only"
        raise OtherTestError(reason, "The test goes to 8° on both sides; figures need 5°.")
    return test


def _kes_tension(setup: Setup) -> KesTension:
    """Return the test of jaws that move apart."""
    jaws = _jaws(setup, along=False)
    ends = jaws.travel(np.array(reached(setup.program)))
    if len(ends) > 1 and ends.max() <= 0:
        raise OtherTestError("the program moves the jaws together", "They move apart.")
    return KesTension(jaws)


def _picture_frame(setup: Setup) -> PictureFrame:
    """Return the test of a frame that holds all edges named, yarns along its bars."""
    held = [condition for _, _, condition in conditions_of(setup.boundary)]
    frames = [condition.frame for condition in held if condition.frame]
    if len(frames) < len(held) or not frames:
        raise OtherTestError("not all edges are held by a frame", "Hold each by 'frame'.")
    if len(setup.boundary) < len(EDGES):
        raise OtherTestError("an edge is free", "The frame holds all four.")
    bars = np.array([_unit(frames[0].angle + turn) for turn in (0.0, np.pi / 2)])
    if not np.allclose(np.sort(np.abs(setup.fibres @ bars[0])), [0, 1], rtol=0, atol=ROUNDING):
        remedy = "They are along the bars: at 'angle' of the frame and at right angles to it."
        raise OtherTestError("the families are not along the bars", remedy)
    zone, sign = next(iter(setup.zones), None), setup.sign(bars.sum(axis=0))
    return PictureFrame(frames[0].length, setup.shape.area, zone, sign)


_TESTS: Mapping[TestName, Callable[[Setup], StandardTest]] = {
    "kes-shear": _kes_shear,
    "kes-tension": _kes_tension,
    "picture-frame": _picture_frame,
    "bias-extension": _bias_extension,
}


def _jaws(setup: Setup, along: bool) -> Jaws:
    """Return both jaws of a rectangular sample.

    Args:
        setup: The case.
        along: Whether one moves along itself against the other, as in shear, or away from it, as
            in tension.

    Raises:
        OtherTestError: There are no two such jaws.
    """
    if len(setup.boundary) != 2:
        raise OtherTestError(f"not two edges are held or loaded, but {len(setup.boundary)}")
    ends = {name: _straight(name, setup.shape.edges[name]) for name in setup.boundary}
    names = sorted(ends, key=lambda name: tuple(ends[name].sum(axis=0).round(9)))
    rest = _between([ends[name] for name in names], setup.shape.area)
    farthest = float(np.abs(reached(setup.program)).max()) or rest.distance / 10
    values = farthest * np.linspace(-1, 1, 9)
    first, second = (_motion(name, setup.boundary[name], ends[name], values) for name in names)
    ahead = np.array(rest.direction)
    axes = np.array([ahead, [-ahead[1], ahead[0]]])
    free = [m.free for m in (first, second) if m.free is not None]
    if free and not (along and all(abs(axes[1] @ axis) < ROUNDING for axis in free)):
        remedy = "Prescribe both; in shear a jaw may be free on the line from jaw to jaw."
        raise OtherTestError("a displacement of a jaw is free", remedy)
    travels = (second.values - first.values) @ axes.T
    way, other = travels[:, int(along)], travels[:, int(not along)]
    offset, factor = way[len(way) // 2], (way[-1] - way[0]) / (2 * farthest)
    wrong = max(np.abs(way - factor * values - offset).max(), np.abs(other).max())
    if not factor or wrong > ROUNDING * farthest:
        where = "along themselves" if along else "apart"
        remedy = "The displacement of a jaw is a multiple of program, which nothing is added to."
        raise OtherTestError(f"the program does not just move the jaws {where}", remedy)
    return replace(rest, factor=_rounded(factor), offset=_rounded(offset), free=len(free) > 0)


def _between(lines: Sequence[Array], area: float) -> Jaws:
    """Return jaws at rest from the ends of each, shape (2, 2), m, and the area between them (m^2).

    Raises:
        OtherTestError: There is no rectangle between them.
    """
    middles = [line.mean(axis=0) for line in lines]
    distance = float(np.linalg.norm(middles[1] - middles[0]))
    direction = (middles[1] - middles[0]) / distance
    width, other = (float(np.linalg.norm(line[1] - line[0])) for line in lines)
    aslant = [abs((line[1] - line[0]) @ direction) for line in lines]
    size = max(distance, width)
    if max(abs(area - distance * width) / size, abs(other - width), *aslant) > ROUNDING * size:
        remedy = "The sample is a rectangle, and the jaws are two opposite sides of it."
        raise OtherTestError("there is no rectangle between the edges held", remedy)
    x, y, dx, dy = map(_rounded, np.concatenate([np.mean(middles, axis=0), direction]))
    return Jaws(_rounded(distance), _rounded(width), (x, y), (dx, dy))


def _unit(angle: float) -> Array:
    """Return the unit vector at an angle (rad) from x."""
    return np.array([np.cos(angle), np.sin(angle)])


def _rounded(value: float) -> float:
    """Return a value without rounding errors."""
    return float(f"{value:.12g}")


def _straight(name: str, points: Array) -> Array:
    """Return both ends of an edge, shape (2, 2), m.

    Raises:
        OtherTestError: It is no straight line.
    """
    away = points - points[0]
    one = points[np.linalg.norm(away, axis=1).argmax()]
    two = points[np.linalg.norm(points - one, axis=1).argmax()]
    ahead, size = two - one, float(np.linalg.norm(two - one))
    aside = (points - one) @ np.array([-ahead[1], ahead[0]]) / size
    if np.abs(aside).max() > ROUNDING * size:
        raise OtherTestError(f"the edge '{name}' is not straight", "A jaw holds a straight edge.")
    return np.array([one, two])


@dataclass(frozen=True)
class _Motion:
    """How a jaw moves: displacements (m) against the program, and what is free of them.

    Attributes:
        values: Shape (n, 2), m; zero where it is free.
        free: Unit vector along which it is free, or None.
    """

    values: Array
    free: Array | None


def _motion(
    name: str, conditions: Sequence[EdgeCondition], ends: Array, programs: Array
) -> _Motion:
    """Return the motion of an edge for values of the program (m), shape (n,).

    Raises:
        OtherTestError: It does not move as one piece by the program alone.
    """
    components = conditions[0].components
    families = sorted(family for c in conditions for family in c.families)
    if families != [1, 2] or any(c.components != components for c in conditions):
        raise OtherTestError(f"'{name}' does not hold both families alike", "A jaw holds both.")
    if any(programs_in(load) for c in conditions for load in c.force or ()):
        remedy = "A tension across the jaws is constant."
        raise OtherTestError(f"the force on '{name}' follows the program", remedy)
    held = [c.held for c in components]
    if not any(held):
        raise OtherTestError(f"'{name}' is not held")
    if any("second_program" in c.follows for c in components if c.held):
        raise OtherTestError(f"'{name}' follows second_program", "A jaw follows program alone.")
    x, y = ends[:, 0], ends[:, 1]
    moved = np.array(
        [[c.at(x, y, p) if c.held else 0 * x for c in components] for p in programs]
    )  # program, component, end
    if np.ptp(moved, axis=2).max() > ROUNDING * np.abs(programs).max():
        raise OtherTestError(f"'{name}' does not move as one piece", "A jaw does not deform.")
    free = None if all(held) else np.array([0.0, 1.0] if held[0] else [1.0, 0.0])
    return _Motion(moved[:, :, 0], free)
