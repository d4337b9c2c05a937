"""Combinations of valid values that make no sense together."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain, combinations, islice, product
from math import acos, ceil, cos, degrees, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wovenfab.case.boundary import (
    BOTH,
    EDGES,
    Boundary,
    EdgeCondition,
    apart,
    conditions_of,
    free_motion,
)
from wovenfab.case.effects import (
    Scene,
    SceneEffect,
    Value,
    acting_effects,
    effects_that_resist,
    missing_resistance,
    needs_of_scene,
    quantity,
    resisted,
    with_second_gradient,
    with_two_placements,
)
from wovenfab.case.errors import KeyPath, near_miss, one_of
from wovenfab.case.formula import SHEAR_ANGLE, Expression
from wovenfab.case.petsc import refused
from wovenfab.case.program import (
    Finding,
    HoldSection,
    SegmentSection,
    force_control,
    joints,
    reached,
    second,
    speeds,
)
from wovenfab.case.quantities import Quantity
from wovenfab.case.schema import (
    Discretisation,
    OutputSection,
    Rectangle,
    SheetFile,
    Solver,
    Time,
    possible_fields,
)
from wovenfab.case.specimen import TestName, other_tests, rectangle_shape, setup_of
from wovenfab.forms.table import TABLE, ForceTable
from wovenfab.model.spline import pieces_of

Array = NDArray[np.float64]
Program = tuple[SegmentSection, ...]

#: A force that follows the program, as a remedy.
GROWING = "'10 N/m * program/40 mm'"
_REMEDY = "Keep it in bounds, as with max(..., ...) or if(..., ..., ...)."
#: More triangles are a typing error: no machine has the memory for them.
MOST_TRIANGLES = 1e7
MOST_TRIED = 500  # displacements of a program with which formulas are tried


def _initial_loads(scene: Scene, boundary: Boundary) -> Iterator[Finding]:
    """Yield conditions that act from the start where only friction could resist them.

    At rest friction carries nothing, so that there is no state to begin with.
    """
    acts = acting_effects(scene)
    lack = missing_resistance(scene, [e for e in acts if not e.effect.dissipative])
    if not lack or missing_resistance(scene, acts):
        return
    for name, i, condition in conditions_of(boundary):
        if condition.acts_initially:
            yield (
                ("boundary", name, i),
                f"acts from the start, but without friction {lack[1]}, so that there is no rest",
                f"Let it follow the program, as in {GROWING} or 'min(program, 5 mm)'.",
            )


def _sound(scene: Scene) -> Iterator[Finding]:
    if lack := missing_resistance(scene, acting_effects(scene)):
        resistance, reason = lack
        resisting = one_of(effects_that_resist(resistance, scene))
        yield ("effects",), reason, f"That takes {resisting}, with values above zero."


def _tables(sheet: Rectangle | SheetFile, scene: Scene) -> Iterator[Finding]:
    """Yield tables against an angle that end where the yarns already lie on each other."""
    aligned = acos(abs(cos(sheet.fibres[1] - sheet.fibres[0])))
    for e in scene:
        if e.effect.table is None or e.effect.table.strain.unit != "rad":
            continue
        tables = e.table if isinstance(e.table, tuple) else (e.table,)
        last = max(t.strains[-1] for t in tables if t is not None)
        if last >= aligned:
            reason = (
                f"ends at {degrees(last):.4g} deg, but yarns align at {degrees(aligned):.4g} deg"
            )
            remedy = "Leave rows out: beyond the last one the force grows without bound by itself."
            yield ("effects", e.name, TABLE), reason, remedy


def _known_edges(sheet: Rectangle | SheetFile, boundary: Boundary) -> Iterator[Finding]:
    if isinstance(sheet, Rectangle):
        for name in boundary:
            if name not in EDGES:
                remedy = f"{near_miss(name, EDGES)} The edges are {', '.join(EDGES)}.".strip()
                yield ("boundary", name), "unknown edge", remedy


def _held(sheet: Rectangle | SheetFile, scene: Scene, boundary: Boundary) -> Iterator[Finding]:
    if isinstance(sheet, Rectangle):
        known = {name: boundary[name] for name in boundary if name in EDGES}
        sheared = "shearing" in resisted(acting_effects(scene))
        motion = free_motion((sheet.length, sheet.width), sheet.fibres, known, sheared)
    else:
        components = [c.components for _, _, c in conditions_of(boundary)]
        held = [any(c[i].held for c in components) for i in (0, 1)]
        motion = None if all(held) else f"move along {'y' if held[0] else 'x'}"
    if motion:
        reason = f"the held edges leave the sheet free to {motion}"
        yield ("boundary",), reason, "Clamp an edge, as in 'left: clamp'."


def _corners(sheet: Rectangle | SheetFile, boundary: Boundary) -> Iterator[Finding]:
    if not isinstance(sheet, Rectangle):
        return
    known = {name: boundary[name] for name in boundary if name in EDGES}
    size = max(sheet.length, sheet.width)
    for (one, _, a), (other, i, b) in combinations(conditions_of(known), 2):
        corners = set(EDGES[one]) & set(EDGES[other]) if one != other else ()
        for x, y in corners if set(a.families) & set(b.families) else ():
            if axis := apart(a, b, x * sheet.length, y * sheet.width, size):
                reason = f"moves away along {axis} from '{one}', which it meets in a corner"
                yield ("boundary", other, i), reason, "Free one of them, or move both alike."


def _points(sheet: Rectangle) -> tuple[Array, Array]:
    """Return the coordinates (m) of the points of a rectangle where formulas are tried."""
    sides = np.linspace(0, sheet.length, 50), np.linspace(0, sheet.width, 50)
    x, y = (coordinate.ravel() for coordinate in np.meshgrid(*sides))
    return x, y


def _values_everywhere(sheet: Rectangle | SheetFile, scene: Scene) -> Iterator[Finding]:
    if isinstance(sheet, Rectangle):
        x, y = _points(sheet)
        yield from list(unfit_values(scene, x, y)) or unsound_places(scene, x, y)


def _edges_everywhere(
    sheet: Rectangle | SheetFile, boundary: Boundary, program: Program,
    second_program: Program | None,
) -> Iterator[Finding]:  # fmt: skip
    values = [np.unique(reached(p)) for p in (program, second_program or ())]
    tried = list(product(*(v[:: len(v) // MOST_TRIED + 1] for v in values)))
    programs = tried[:: len(tried) // MOST_TRIED + 1]
    if isinstance(sheet, Rectangle):
        for edge, ends in EDGES.items():
            if edge in boundary:
                x, y = np.linspace(*ends, 50).T * [[sheet.length], [sheet.width]]
                yield from unfit_conditions(edge, boundary[edge], x, y, programs)


def _frames(boundary: Boundary, program: Program) -> Iterator[Finding]:
    """Yield frames that the program folds flat, and those of one sheet that differ."""
    frames = [(name, i, c.frame) for name, i, c in conditions_of(boundary) if c.frame]
    travel = reached(program) if frames else []
    for name, i, frame in frames:
        here: KeyPath = ("boundary", name, i, "frame")
        if frame != frames[0][2]:
            reason = f"differs from that of '{frames[0][0]}'"
            yield here, reason, "All edges in a frame have the same one."
        opens, closes = frame.length * (2 - sqrt(2)), frame.length * sqrt(2)
        if max(travel) >= opens or min(travel) <= -closes:
            reason = "the bars lie side by side before the end of the program"
            remedy = f"The crosshead can travel less than {opens:.4g} m, or {closes:.4g} m back."
            yield (*here, "length"), reason, remedy


def _one_family(scene: Scene, boundary: Boundary) -> Iterator[Finding]:
    if needs_of_scene(scene).placements == 2:
        return
    for name, i, condition in conditions_of(boundary):
        placed = condition.force or any(c.held for c in condition.components)
        if placed and condition.families != BOTH:
            apart = one_of(with_two_placements())
            yield (
                ("boundary", name, i, "family"),
                "both families have the same placement here, so that neither is held or loaded "
                "alone",
                f"Leave 'family' out, or add {apart} to the effects.",
            )


def _program_used(boundary: Boundary, program: Program) -> Iterator[Finding]:
    conditions = [c for _, _, c in conditions_of(boundary)]
    moves = any(not isinstance(segment, HoldSection) for segment in program)
    if moves and not any("program" in c.follows for c in conditions):
        remedy = "For example 'right: {displacement: [program, 0]}' in boundary."
        if any(c.force for c in conditions):
            remedy = (
                f"A force may follow it, as in {GROWING}; one that is there from the start takes "
                "{type: hold, duration: 1 s, steps: 1}."
            )
        yield ("program",), "no edge uses the program", remedy


def _held_directions(scene: Scene, boundary: Boundary) -> Iterator[Finding]:
    for name, i, condition in conditions_of(boundary):
        if condition.rotation and not needs_of_scene(scene).second_gradient:
            yield (
                ("boundary", name, i),
                "yarn directions cannot be held, because no effect depends on their change",
                f"Hold the placement only, or add {one_of(with_second_gradient())}.",
            )


def _degree(scene: Scene, discretisation: Discretisation) -> Iterator[Finding]:
    if discretisation.degree < 2 and needs_of_scene(scene).second_gradient:
        reason = "must be at least 2, because an effect depends on second derivatives"
        yield ("discretisation", "degree"), reason, ""


def _fields(scene: Scene, output: OutputSection) -> Iterator[Finding]:
    if output.lines and not output.fields:
        reason = "the list is empty, and probes of lines and yarns are of stored fields"
        yield ("output", "fields"), reason, "Leave the key out, or name a field."
    if "fields" in output.model_fields_set:
        possible = possible_fields(needs_of_scene(scene))
        for i, field in enumerate(output.fields):
            if field not in possible:
                yield (("output", "fields", i), f"the effects of this case have no {field}", "")


def _mesh(sheet: Rectangle | SheetFile, discretisation: Discretisation) -> Iterator[Finding]:
    given = discretisation
    mesh = given.mesh or "fibres"
    if isinstance(sheet, Rectangle):
        side = min(sheet.length, sheet.width)
        least = sqrt(2 * sheet.length * sheet.width / MOST_TRIANGLES)
        if given.mesh_size and given.mesh_size > side:
            too_large = f"is larger than the shorter side, {side:g} m"
            yield ("discretisation", "mesh_size"), too_large, ""
        elif given.mesh_size and given.mesh_size < least:
            yield (
                ("discretisation", "mesh_size"),
                f"makes more than {MOST_TRIANGLES / 1e6:g} million triangles of this sheet",
                f"Take at least {ceil(1e5 * least) / 100:g} mm.",
            )
        graded: tuple[str, ...] = ("fibres", "unstructured")
    else:
        made = sheet.file.suffix.lower() == ".msh"
        known = ("fibres", "unstructured") if not made else ()
        graded = ("fibres",) if not made else ()
        fixed = ("mesh", "mesh_size") if made else () if mesh in known else ("mesh",)
        for key in fixed:
            if getattr(given, key) is not None:
                reason = f"does not apply to {sheet.file.name}"
                yield ("discretisation", key), reason, "Leave this key out."
    if given.corner_size and mesh not in graded:
        reason = f"a mesh that is {mesh} cannot be graded" if given.mesh else "does not apply here"
        yield ("discretisation", "corner_size"), reason, "Leave this key out."
    if given.graded and given.corner_size:
        yield ("discretisation", "graded"), "excludes 'corner_size'", "Leave one of both keys out."
    if given.graded and (mesh != "fibres" or not graded):
        reason = "only a mesh along the fibres is graded by itself"
        yield ("discretisation", "graded"), reason, "Use 'mesh: fibres', or leave this key out."
    if given.jumps and (mesh != "fibres" or not graded):
        reason = "placements can jump on a mesh along the fibres alone"
        yield ("discretisation", "jumps"), reason, "Use 'mesh: fibres', or leave this key out."


def _accuracy(
    accuracy: float | None, discretisation: Discretisation, time: Time, from_state: Path | None
) -> Iterator[Finding]:
    if accuracy is None:
        return
    if from_state is not None:
        yield ("from_state",), "brings its own elements", "Leave out this key or 'accuracy'."
    for section, name, keys in (
        (discretisation, "discretisation", ("degree", "mesh_size", "corner_size", "graded")),
        (time, "time", ("steps_per_cycle", "tolerance")),
    ):
        for key in keys:
            if key in section.model_fields_set and getattr(section, key) is not None:
                reason = "is chosen by the program where an accuracy is asked for"
                yield (name, key), reason, "Leave this key out, or leave 'accuracy' out."


def _tolerance(time: Time) -> Iterator[Finding]:
    if time.tolerance is not None and not time.scheme.startswith("bdf"):
        reason = f"the error of a step is not measured with {time.scheme}"
        yield ("time", "tolerance"), reason, "Use 'scheme: bdf3', or leave this key out."


def _end_of_step(time: Time, scene: Scene) -> Iterator[Finding]:
    yields = [e.name for e in scene if e.effect.lost]
    if time.scheme == "midpoint" and yields:
        reason = f"the elastic law of {yields[0]} needs equilibrium at the end of a step"
        yield ("time", "scheme"), reason, "Use 'scheme: bdf2'."


def values_at(value: Value, x: Array, y: Array, *programs: float) -> Array:
    """Return a parameter's value at points, or a force's for the programs (m)."""
    values: Array = np.full_like(x, 0.0 if isinstance(value, Expression) else value)
    return values + value.at(x, y, *programs) if isinstance(value, Expression) else values


#: Shear angles (rad) at which formulas of the angle are evaluated: all that yarns can take.
ANGLES = np.deg2rad(np.linspace(-89.0, 89.0, 179))
#: A strength that changes less than this share within 60 degrees hardly depends on the angle.
LEAST_GROWTH = 0.01


def unfit_values(scene: Scene, x: Array, y: Array) -> Iterator[Finding]:
    """Yield each formula of a scene that is out of bounds at any of some points.

    Args:
        scene: The effects with their values.
        x: First coordinates of the points, m.
        y: Second coordinates, m.
    """
    for path, value, bounds in _values_of(scene):
        angles = ANGLES if SHEAR_ANGLE in value.variables else ANGLES[:1]
        found = (_unfit(bounds, path, value, x, y, angle) for angle in angles)
        yield from islice(chain.from_iterable(found), 1)


def _values_of(scene: Scene) -> Iterator[tuple[KeyPath, Expression, Quantity]]:
    """Yield the formulas of all parameters, each with how it is read."""
    for e in scene:
        for p in e.effect.parameters:
            for path, value in _formulas(("effects", e.name, p.name), e.values[p.name]):
                yield path, value, quantity(p)


def _unfit(
    bounds: Quantity, path: KeyPath, value: Expression, x: Array, y: Array, angle: float
) -> Iterator[Finding]:
    """Yield a formula that is out of bounds at any of some points and an angle (rad)."""
    values = value.at(x, y, angle=angle)
    worst = int(np.argmin(values))
    where = f", gamma = {np.rad2deg(angle):g} deg" if SHEAR_ANGLE in value.variables else ""
    if not np.isfinite(values).all():
        yield from _infinite(path, values, x, y, where)
    elif broken := bounds.broken(values[worst]):
        place = _place(x, y, worst) + where
        yield path, f"must {broken}, but is {values[worst]:g} at {place}", _REMEDY


def unsound_places(scene: Scene, x: Array, y: Array) -> Iterator[Finding]:
    """Yield what nothing resists at any of some points, where formulas vanish."""
    if missing_resistance(scene, acting_effects(scene)):
        return  # which is so everywhere
    active = np.array([_acting(e, x, y) for e in scene])
    patterns, first = np.unique(active, axis=1, return_index=True)
    for pattern, i in zip(patterns.T, first, strict=True):
        lack = missing_resistance(scene, [e for e, on in zip(scene, pattern, strict=True) if on])
        if lack:
            place = _place(x, y, int(i))
            yield ("effects",), f"{lack[1]} at {place}", "Keep the values above zero there."
            return


def doubts(sheet: Rectangle | SheetFile, scene: Scene) -> Iterator[Finding]:
    """Yield what may go wrong in some programs only.

    Formulas are tried on rectangles; on other sheets the values at the origin are taken.
    """
    x, y = _points(sheet) if isinstance(sheet, Rectangle) else (np.zeros(1), np.zeros(1))
    yield from _softening(scene, x, y)
    yield from _hardly_growing(scene, x, y)


def _softening(scene: Scene, x: Array, y: Array) -> Iterator[Finding]:
    """Yield an effect with a negative stiffness by stretch that the others do not outweigh.

    The stored energy may then lose its convexity in the stretches, and results depend on the mesh.
    """
    bounds = {e.name: b for e in scene if (b := _stretch_stiffness(e, x, y)) is not None}
    names = [name for name, bound in bounds.items() if bound.min() < 0]
    if not names:
        return
    each = np.array(list(bounds.values()))
    needed, found = np.maximum(-each, 0).sum(axis=0), np.maximum(each, 0).sum(axis=0)
    lacks = np.where(needed > 0, needed - found, -np.inf)
    family, i = np.unravel_index(int(np.argmax(lacks)), lacks.shape)
    if lacks[family, i] >= 0:
        where = "" if len(np.unique(lacks[family])) == 1 else f" at {_place(x, y, int(i))}"
        reason = (
            f"compressed yarns of family {family + 1} may lose stability, since the least "
            f"stiffness of the others is {found[family, i]:.4g} N/m{where}"
        )
        others = one_of([n for n in effects_that_resist("stretching", scene) if n not in names])
        remedy = (
            f"More than {np.ceil(needed.max()):g} N/m of {others} is enough; sheets without "
            "compressed yarns need none."
        )
        yield ("effects", names[0]), reason, remedy


def _hardly_growing(scene: Scene, x: Array, y: Array) -> Iterator[Finding]:
    """Yield formulas of the shear angle that hardly depend on it: a unit is probably missing."""
    small = ANGLES[np.abs(ANGLES) < np.deg2rad(60.5)]
    for path, value, _ in _values_of(scene):
        if SHEAR_ANGLE in value.variables:
            values = np.array([value.at(x, y, angle=angle) for angle in small])
            if (np.ptp(values, axis=0) <= LEAST_GROWTH * values.max(axis=0)).all():
                reason = f"hardly depends on {SHEAR_ANGLE}, which is in rad"
                remedy = f"Degrees have their unit, as in '({SHEAR_ANGLE}/20 deg)^2'."
                yield path, reason, remedy


def _stretch_stiffness(e: SceneEffect, x: Array, y: Array) -> Array | None:
    """Return the bound (N/m) of each family at points, shape (2, points); None if it is zero."""
    if e.effect.stretch_stiffness is None:
        return None

    def numbers(given: Any) -> Any:
        if isinstance(given, tuple):
            return tuple(map(numbers, given))
        return pieces_of(given) if isinstance(given, ForceTable) else values_at(given, x, y)

    table = {} if e.table is None else {TABLE: e.table}
    values = {name: numbers(given) for name, given in (*e.values.items(), *table.items())}
    with np.errstate(all="ignore"):
        bounds = e.effect.stretch_stiffness(values)
    return np.array([np.broadcast_to(bound, x.shape) for bound in bounds], dtype=float)


def unfit_conditions(
    edge: str, conditions: Sequence[EdgeCondition], x: Array, y: Array,
    programs: Iterable[tuple[float, ...]],
) -> Iterator[Finding]:  # fmt: skip
    """Yield each formula of an edge that has no finite value at any of its points.

    Args:
        edge: Name of the edge.
        conditions: What is prescribed there.
        x: First coordinates of points on the edge, m.
        y: Second coordinates, m.
        programs: Displacements (m) that the programs reach, together.
    """
    for i, condition in enumerate(conditions):
        here: KeyPath = ("boundary", edge, i)
        given = [
            ((*here, "displacement", k), c.expression)
            for k, c in enumerate(condition.displacement)
            if isinstance(c.expression, Expression)
        ]
        for path, value in (*given, *_formulas((*here, "force"), condition.force or ())):
            over = [values_at(value, x, y, *together) for together in programs]
            yield from _infinite(path, np.sum(over, axis=0), x, y)


def _formulas(path: KeyPath, given: Any) -> Iterator[tuple[KeyPath, Expression]]:
    """Yield a parameter's formula, or those of a pair."""
    if isinstance(given, tuple):
        same = len(set(given)) == 1
        for i, value in enumerate(given[:1] if same else given):
            yield from _formulas(path if same else (*path, i), value)
    elif isinstance(given, Expression):
        yield path, given


def _acting(e: SceneEffect, x: Array, y: Array) -> NDArray[np.bool_]:
    everywhere = np.ones_like(x, dtype=bool)
    for given in e.values.values():
        values: Iterable[Value] = given if isinstance(given, tuple) else (given,)
        for value in values:
            everywhere &= values_at(value, x, y) > 0
    return everywhere


def _infinite(
    path: KeyPath, values: Array, x: Array, y: Array, where: str = ""
) -> Iterator[Finding]:
    finite = np.isfinite(values)
    if not finite.all():
        yield path, f"has no finite value at {_place(x, y, int(np.argmin(finite)))}{where}", ""


def _place(x: Array, y: Array, i: int) -> str:
    return f"x = {x[i]:.4g} m, y = {y[i]:.4g} m"


def _figures(
    figures: Sequence[TestName], sheet: Rectangle | SheetFile, boundary: Boundary, program: Program,
    output: OutputSection,
) -> Iterator[Finding]:  # fmt: skip
    """Yield tests that the case of a rectangle is not; of other sheets a mesh has to tell."""
    if isinstance(sheet, Rectangle) and boundary.keys() <= EDGES.keys():
        setup = setup_of(rectangle_shape(sheet), sheet.fibres, boundary, program, output)
        yield from other_tests(figures, setup)


def _petsc(solver: Solver) -> Iterator[Finding]:
    for name, message, remedy in refused(solver.petsc):
        yield ("solver", "petsc", name), message, remedy


#: What is asked of the sections of a case together, each with the names of those that it takes.
COMBINATIONS: tuple[tuple[Callable[..., Iterator[Finding]], tuple[str, ...]], ...] = (
    (_initial_loads, ("scene", "boundary")),
    (_sound, ("scene",)),
    (_tables, ("sheet", "scene")),
    (_known_edges, ("sheet", "boundary")),
    (_held, ("sheet", "scene", "boundary")),
    (_corners, ("sheet", "boundary")),
    (_values_everywhere, ("sheet", "scene")),
    (_edges_everywhere, ("sheet", "boundary", "program", "second_program")),
    (_frames, ("boundary", "program")),
    (_one_family, ("scene", "boundary")),
    (_program_used, ("boundary", "program")),
    (_held_directions, ("scene", "boundary")),
    (speeds, ("scene", "program")),
    (joints, ("program",)),
    (force_control, ("boundary", "program", "solver", "accuracy")),
    (second, ("scene", "boundary", "second_program", "accuracy")),
    (_degree, ("scene", "discretisation")),
    (_fields, ("scene", "output")),
    (_mesh, ("sheet", "discretisation")),
    (_accuracy, ("accuracy", "discretisation", "time", "from_state")),
    (_tolerance, ("time",)),
    (_end_of_step, ("time", "scene")),
    (_petsc, ("solver",)),
    (_figures, ("figures", "sheet", "boundary", "program", "output")),
)


def findings(sections: Mapping[str, Any]) -> Iterator[Finding]:
    """Yield what makes no sense together.

    Args:
        sections: The valid sections of a case by name; what takes others is not asked.
    """
    for rule, names in COMBINATIONS:
        if sections.keys() >= set(names):
            yield from rule(*(sections[name] for name in names))
