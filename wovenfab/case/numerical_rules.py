"""Choices of elements, steps and output that make no sense together."""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil, sqrt

from . import needs
from .sampling import Finding
from .scene import Scene
from .schema import Discretisation, Output, Time, possible_fields
from .sheet import Rectangle, SheetFile

#: More triangles are a slip of the keyboard: no machine has the memory for them.
MOST_TRIANGLES = 1e7


def _degree(scene: Scene, discretisation: Discretisation) -> Iterator[Finding]:
    if discretisation.degree < 2 and needs.needs_of_scene(scene).second_gradient:
        yield (
            ("discretisation", "degree"),
            "must be at least 2, because an effect depends on second derivatives",
            "",
        )


def _fields(scene: Scene, output: Output) -> Iterator[Finding]:
    if "fields" in output.model_fields_set:
        possible = possible_fields(needs.needs_of_scene(scene))
        for i, field in enumerate(output.fields):
            if field not in possible:
                yield (("output", "fields", i), f"the effects of this case have no {field}", "")


def _mesh(sheet: Rectangle | SheetFile, discretisation: Discretisation) -> Iterator[Finding]:
    given = discretisation
    mesh = given.mesh or "fibres"
    if isinstance(sheet, Rectangle):
        side = min(sheet.length, sheet.width)
        if given.mesh_size and given.mesh_size > side:
            yield (
                ("discretisation", "mesh_size"),
                f"is larger than the shorter side, {side:g} m",
                "",
            )
        elif given.mesh_size and (least := _least_size(sheet)) > given.mesh_size:
            yield (
                ("discretisation", "mesh_size"),
                f"makes more than {MOST_TRIANGLES / 1e6:g} million triangles of this sheet",
                f"Take at least {ceil(1e5 * least) / 100:g} mm.",
            )
        graded: tuple[str, ...] = ("fibres", "unstructured")
    else:
        made = sheet.file.suffix == ".msh"
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
    if given.jumps and (mesh != "fibres" or not graded):
        reason = "placements can jump on a mesh along the fibres alone"
        yield ("discretisation", "jumps"), reason, "Use 'mesh: fibres', or leave this key out."


def _accuracy(
    accuracy: float | None, discretisation: Discretisation, time: Time
) -> Iterator[Finding]:
    if accuracy is None:
        return
    for section, name, keys in (
        (discretisation, "discretisation", ("degree", "mesh_size", "corner_size")),
        (time, "time", ("steps_per_cycle", "tolerance")),
    ):
        for key in keys:
            if key in section.model_fields_set and getattr(section, key) is not None:
                reason = "is chosen by the program where an accuracy is asked for"
                yield (name, key), reason, "Leave this key out, or leave 'accuracy' out."


def _tolerance(time: Time) -> Iterator[Finding]:
    if time.tolerance is not None and time.scheme != "bdf2":
        reason = f"the error of a step is not measured with {time.scheme}"
        yield ("time", "tolerance"), reason, "Use 'scheme: bdf2', or leave this key out."


def _least_size(sheet: Rectangle) -> float:
    """Return the size of cells (m) below which a rectangle has too many."""
    return sqrt(2 * sheet.length * sheet.width / MOST_TRIANGLES)


#: All of them, see :mod:`.rules`.
NUMERICAL = (_degree, _fields, _mesh, _accuracy, _tolerance)
