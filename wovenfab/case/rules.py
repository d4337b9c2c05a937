"""Combinations of valid values that make no sense together.

A rule is a function of the sections it concerns, by name; it is asked once these
are valid, and yields what is wrong.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from itertools import combinations
from typing import Any

import numpy as np

from . import needs
from .boundary import BOTH, Boundary, EdgeCondition, conditions_of
from .mobility import EDGES, free_motion
from .numerical_rules import NUMERICAL
from .problems import near_miss, one_of
from .program import Hold, Ramp, Segment, Table, reached
from .rest import GROWING, rest_at_start
from .sampling import Finding, samples_of, unfit_conditions, unfit_values, unsound_places
from .scene import Scene
from .sheet import Rectangle, SheetFile

Rule = Callable[..., Iterator[Finding]]

Program = tuple[Segment, ...]

_RULES: list[Rule] = [rest_at_start, *NUMERICAL]


def findings(sections: Mapping[str, Any]) -> Iterator[Finding]:
    """Ask all rules whose sections are there.

    Args:
        sections: The valid sections of a case by name.
    """
    for rule in _RULES:
        concerns = inspect.signature(rule).parameters
        if concerns.keys() <= sections.keys():
            yield from rule(**{name: sections[name] for name in concerns})


def _rule(function: Rule) -> Rule:
    _RULES.append(function)
    return function


@_rule
def _sound(scene: Scene) -> Iterator[Finding]:
    if lack := needs.lacking(scene, needs.acting(scene)):
        resistance, reason = lack
        resisting = one_of(needs.providers(resistance, scene))
        yield ("effects",), reason, f"That takes {resisting}, with values above zero."


@_rule
def _known_edges(sheet: Rectangle | SheetFile, boundary: Boundary) -> Iterator[Finding]:
    if isinstance(sheet, Rectangle):
        for name in boundary:
            if name not in EDGES:
                remedy = f"{near_miss(name, EDGES)} The edges are {', '.join(EDGES)}.".strip()
                yield ("boundary", name), "unknown edge", remedy


@_rule
def _held(sheet: Rectangle | SheetFile, scene: Scene, boundary: Boundary) -> Iterator[Finding]:
    if isinstance(sheet, Rectangle):
        known = {name: boundary[name] for name in boundary if name in EDGES}
        sheared = "shearing" in needs.resisted(needs.acting(scene))
        motion = free_motion((sheet.length, sheet.width), sheet.fibres, known, sheared)
    else:
        components = [c.components for _, _, c in conditions_of(boundary)]
        held = [any(c[i].held for c in components) for i in (0, 1)]
        motion = None if all(held) else f"move along {'y' if held[0] else 'x'}"
    if motion:
        yield (
            ("boundary",),
            f"the held edges leave the sheet free to {motion}",
            "Clamp an edge, as in 'left: clamp'.",
        )


@_rule
def _corners(sheet: Rectangle | SheetFile, boundary: Boundary) -> Iterator[Finding]:
    if not isinstance(sheet, Rectangle):
        return
    known = {name: boundary[name] for name in boundary if name in EDGES}
    size = max(sheet.length, sheet.width)
    for (one, _, a), (other, i, b) in combinations(conditions_of(known), 2):
        corners = set(EDGES[one]) & set(EDGES[other]) if one != other else ()
        for x, y in corners if set(a.families) & set(b.families) else ():
            if axis := _apart(a, b, x * sheet.length, y * sheet.width, size):
                reason = f"moves away along {axis} from '{one}', which it meets in a corner"
                yield ("boundary", other, i), reason, "Free one of them, or move both alike."


def _apart(a: EdgeCondition, b: EdgeCondition, x: float, y: float, size: float) -> str:
    """Return the axis along which two conditions differ at a point, if there is one."""
    programs = size * np.array([0.0, 0.01, 0.1, 0.3])
    for axis, c, d in zip("xy", a.components, b.components, strict=True):
        if c.held and d.held:
            gap = np.abs(c.at(x, y, programs) - d.at(x, y, programs))
            if not np.all(gap <= 1e-9 * size):
                return axis
    return ""


@_rule
def _values_everywhere(sheet: Rectangle | SheetFile, scene: Scene) -> Iterator[Finding]:
    if isinstance(sheet, Rectangle):
        x, y = samples_of(sheet.length, sheet.width)
        yield from list(unfit_values(scene, x, y)) or unsound_places(scene, x, y)


@_rule
def _edges_everywhere(
    sheet: Rectangle | SheetFile, boundary: Boundary, program: Program
) -> Iterator[Finding]:
    if isinstance(sheet, Rectangle):
        for edge, ends in EDGES.items():
            if edge in boundary:
                x, y = np.linspace(*ends, 50).T * [[sheet.length], [sheet.width]]
                yield from unfit_conditions(edge, boundary[edge], x, y, reached(program))


@_rule
def _one_family(scene: Scene, boundary: Boundary) -> Iterator[Finding]:
    if needs.needs_of_scene(scene).placements == 2:
        return
    for name, i, condition in conditions_of(boundary):
        placed = condition.force or any(c.held for c in condition.components)
        if placed and condition.families != BOTH:
            apart = one_of(needs.with_two_placements())
            yield (
                ("boundary", name, i, "family"),
                "both families have the same placement here, so that neither is held or loaded "
                "alone",
                f"Leave 'family' out, or add {apart} to the effects.",
            )


@_rule
def _program_used(boundary: Boundary, program: Program) -> Iterator[Finding]:
    conditions = [c for _, _, c in conditions_of(boundary)]
    moves = any(not isinstance(segment, Hold) for segment in program)
    if moves and not any(c.moves or c.grows for c in conditions):
        remedy = "For example 'right: {displacement: [program, 0]}' in boundary."
        if any(c.force for c in conditions):
            remedy = (
                f"A force may follow it, as in {GROWING}; one that is there from the start takes "
                "{type: hold, duration: 1 s, steps: 1}."
            )
        yield ("program",), "no edge uses the program", remedy


@_rule
def _held_directions(scene: Scene, boundary: Boundary) -> Iterator[Finding]:
    for name, i, condition in conditions_of(boundary):
        if condition.rotation and not needs.needs_of_scene(scene).second_gradient:
            yield (
                ("boundary", name, i),
                "yarn directions cannot be held, because no effect depends on their change",
                f"Hold the placement only, or add {one_of(needs.with_second_gradient())}.",
            )


@_rule
def _speed_of_ramps(scene: Scene, program: Program) -> Iterator[Finding]:
    for i, segment in enumerate(program):
        timeless = isinstance(segment, Ramp) and not (segment.velocity or segment.duration)
        if timeless and needs.needs_of_scene(scene).rate:
            yield (
                ("program", i),
                "a velocity or a duration is needed, because an effect depends on rates",
                "For example 'velocity: 0.1 m/s'.",
            )


@_rule
def _joints(program: Program) -> Iterator[Finding]:
    here = 0.0
    for i, segment in enumerate(program):
        match segment:
            case Ramp(to=end):
                if end == here:
                    already = f"the displacement is {here:g} m already"
                    yield ("program", i, "to"), already, "Use {type: hold} to wait."
                here = end
            case Table(samples=samples):
                path, start = ("program", i, "file"), samples.displacements[0]
                if samples.times[0] == 0 and start != here:
                    jump = f"the table starts at {start:g} m, where the program is at {here:g} m"
                    yield path, jump, "Give the first row a later time, to ramp to it."
                if samples.times[-1] == 0:
                    yield path, "the table has no row after time zero", ""
                here = samples.displacements[-1]
