"""Combinations of valid values that make no sense together.

A rule is a function of the sections it concerns, by name; it is asked once these
are valid, and yields what is wrong.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from itertools import combinations
from typing import Any

from . import needs
from .boundary import EdgeCondition
from .mobility import EDGES, free_motion
from .needs import Values
from .problems import Path, near_miss, one_of
from .program import Hold, Ramp, Segment, Table
from .schema import Discretisation, Output, Rectangle, SheetFile, possible_fields

#: Where, what and the remedy.
Finding = tuple[Path, str, str]
Rule = Callable[..., Iterator[Finding]]

Boundary = Mapping[str, EdgeCondition]
Program = tuple[Segment, ...]

_RULES: list[Rule] = []


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
def _sound(effects: Mapping[str, Values]) -> Iterator[Finding]:
    if lack := needs.lacking(effects):
        resistance, reason = lack
        resisting = one_of(needs.providers(resistance))
        yield ("effects",), reason, f"That takes {resisting}, with values above zero."


@_rule
def _known_edges(sheet: Rectangle | SheetFile, boundary: Boundary) -> Iterator[Finding]:
    if isinstance(sheet, Rectangle):
        for name in boundary:
            if name not in EDGES:
                remedy = f"{near_miss(name, EDGES)} The edges are {', '.join(EDGES)}.".strip()
                yield ("boundary", name), "unknown edge", remedy


@_rule
def _held(
    sheet: Rectangle | SheetFile, effects: Mapping[str, Values], boundary: Boundary
) -> Iterator[Finding]:
    if isinstance(sheet, Rectangle):
        known = {name: boundary[name] for name in boundary if name in EDGES}
        sheared = "shear" in needs.resisted(effects)
        motion = free_motion((sheet.length, sheet.width), sheet.fibres, known, sheared)
    else:
        held = [any(e.components[i].held for e in boundary.values()) for i in (0, 1)]
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
    for one, other in combinations((name for name in boundary if name in EDGES), 2):
        pairs = zip(boundary[one].components, boundary[other].components, strict=True)
        apart = [
            axis for axis, (a, b) in zip("xy", pairs, strict=True) if a.held and b.held and a != b
        ]
        if apart and set(EDGES[one]) & set(EDGES[other]):
            reason = f"moves away along {apart[0]} from '{one}', which it meets in a corner"
            yield ("boundary", other), reason, "Free one of them, or move both alike."


@_rule
def _program_used(boundary: Boundary, program: Program) -> Iterator[Finding]:
    moves = any(not isinstance(segment, Hold) for segment in program)
    if moves and not any(edge.moves for edge in boundary.values()):
        yield (
            ("program",),
            "no edge uses the program",
            "For example 'right: {displacement: [program, 0]}' in boundary.",
        )


@_rule
def _held_directions(effects: Mapping[str, Values], boundary: Boundary) -> Iterator[Finding]:
    for name, edge in boundary.items():
        if edge.rotation and not needs.needs_of(effects).second_gradient:
            yield (
                ("boundary", name),
                "yarn directions cannot be held, because no effect depends on their change",
                f"Hold the placement only, or add {one_of(needs.with_second_gradient())}.",
            )


@_rule
def _degree(effects: Mapping[str, Values], discretisation: Discretisation) -> Iterator[Finding]:
    if discretisation.degree < 2 and needs.needs_of(effects).second_gradient:
        yield (
            ("discretisation", "degree"),
            "must be at least 2, because an effect depends on second derivatives",
            "",
        )


@_rule
def _speed_of_ramps(effects: Mapping[str, Values], program: Program) -> Iterator[Finding]:
    for i, segment in enumerate(program):
        timeless = isinstance(segment, Ramp) and not (segment.velocity or segment.duration)
        if timeless and needs.needs_of(effects).rate:
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


@_rule
def _fields(effects: Mapping[str, Values], output: Output) -> Iterator[Finding]:
    if "fields" in output.model_fields_set:
        possible = possible_fields(needs.needs_of(effects))
        for i, field in enumerate(output.fields):
            if field not in possible:
                yield (("output", "fields", i), f"the effects of this case have no {field}", "")


@_rule
def _mesh(sheet: Rectangle | SheetFile, discretisation: Discretisation) -> Iterator[Finding]:
    given = discretisation
    if isinstance(sheet, Rectangle):
        if given.corner_size and given.mesh != "unstructured":
            yield (
                ("discretisation", "corner_size"),
                "only an unstructured mesh can be graded",
                "Add 'mesh: unstructured'.",
            )
        side = min(sheet.length, sheet.width)
        if given.mesh_size and given.mesh_size > side:
            yield (
                ("discretisation", "mesh_size"),
                f"is larger than the shorter side, {side:g} m",
                "",
            )
        return
    fixed = ("mesh", "corner_size") + (("mesh_size",) if sheet.file.suffix == ".msh" else ())
    for key in fixed:
        if getattr(given, key) is not None:
            reason = f"does not apply to {sheet.file.name}"
            yield ("discretisation", key), reason, "Leave this key out."
