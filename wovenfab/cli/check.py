"""``wovenfab check`` and ``wovenfab schema``: what a case would build, and what a case may say."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wovenfab.case import Case, Rectangle, read_case
from wovenfab.case.document import FROM
from wovenfab.case.effects import acting_effects
from wovenfab.case.program import steps_of_case
from wovenfab.case.quantities import Json
from wovenfab.case.schema import Fabric
from wovenfab.cli.console import Console
from wovenfab.forms import effects
from wovenfab.forms.effect import Effect, Needs, Parameter
from wovenfab.forms.table import TABLE, TableParameter
from wovenfab.simulation.progress import memory

if TYPE_CHECKING:
    from wovenfab.sheet.geometry_file import Geometry
    from wovenfab.sheet.sheet import Outline, Sheet


#: Triangles above which unknowns are estimated: a mesh takes time to make.
MOST_COUNTED = 1_500


def check_case(
    path: Path, overrides: Sequence[str], resolved: bool = False, fabric: Path | None = None
) -> int:
    """Validate a case file, say what would be built and return the exit code."""
    console = Console()
    case = read_case(path, overrides, fabric)
    if resolved:
        console.say(case.to_yaml().rstrip())
        return 0
    for line in case.remarks():
        console.say(line)
    file = None if isinstance(case.sheet, Rectangle) else case.sheet.file
    kind = file.suffix.lower() if file else ""
    if file and kind == ".geo":
        console.say(f"runs the geometry program {file.name}")
    from mpi4py import MPI

    from wovenfab.case.limits import require_memory
    from wovenfab.case.objects import coarse_geometry, estimated_unknowns, sheet_of
    from wovenfab.case.resume import state_checkpoint

    comm = MPI.COMM_WORLD
    if case.from_state is not None:
        state_checkpoint(case, comm)
    is_mesh = kind == ".msh"  # of which the head tells whether it is too large to be read
    geometry = None if is_mesh else coarse_geometry(case, comm)
    unknowns = estimated_unknowns(case, geometry, comm)
    most = MOST_COUNTED * case.discretisation.degree**2 * case.needs.placements
    if exact := unknowns < most:
        unknowns = count_unknowns(case, sheet_of(case, comm))
    require_memory(case, unknowns, comm)
    geometry = coarse_geometry(case, comm) if is_mesh else geometry
    for line in (*edges_of(geometry), *describe(case, unknowns, exact)):
        console.say(line)
    return 0


def edges_of(geometry: Geometry | None) -> list[str]:
    """Return in words the edges of a geometry from a file, with their lengths and places."""
    if geometry is None:
        return []
    from wovenfab.sheet.geometry_file import edge_lines

    return [*edge_lines(geometry.curves), *_narrow(geometry.outline)]


def _narrow(outline: Outline) -> list[str]:
    """Return in words where a sheet is narrowest, and whether that is too narrow."""
    from wovenfab.sheet.narrow import narrowest

    if (place := narrowest(outline)) is None:
        return []
    warning = ": the computation may fail there; make it wider or remove it"
    return [f"{place}{warning if place.is_too_narrow else ''}"]


def count_unknowns(case: Case, sheet: Sheet) -> int:
    """Return the number of unknowns without compiling anything."""
    from wovenfab.model.spaces import placements_on

    degree, count = case.discretisation.degree, case.needs.placements
    return placements_on(sheet.mesh, degree, count, sheet.jumps).unknowns


def describe(case: Case, unknowns: int, exact: bool = True) -> list[str]:
    """Return in words what a run would build, and what other effects would change."""
    needs = case.needs
    curving = [e.name for e in case.scene if e.effect.needs.second_gradient]
    facets = f"facet integrals ({', '.join(curving)})" if curving else "no facet integrals"
    time = f"rates by {case.time.scheme}" if needs.rate else "rate-independent"
    present = [f"{e.name} ({e.effect.law})" if e.effect.law else e.name for e in case.scene]
    inert = [e.name for e in case.scene if e not in acting_effects(case.scene)]
    count = _grouped(unknowns) if exact else f"about {_grouped(round(unknowns, -3))}"
    brought: dict[str, list[str]] = {}
    for effect in effects().values():
        if effect.name not in case.effects:
            brought.setdefault(_brought(needs, effect.needs), []).append(effect.name)
    return [
        f"{case.name}: {case.title}" if case.title else case.name,
        *_fabric_lines(case.fabric),
        f"effects: {', '.join(present)}",
        f"{PLACEMENTS[needs.placements]}, {facets}, {time}: {count} unknowns, "
        f"{steps_of_case(case)} load steps, about {memory(unknowns) / 1e9:.1f} GB of memory",
        *(f"{name} has a value of zero and changes nothing: leave it out" for name in inert),
        *_time_for_accuracy(case),
        *(f"adding {_listed(names)} would bring {what}" for what, names in brought.items()),
        "the case is valid",
    ]


def _fabric_lines(fabric: Fabric | None) -> list[str]:
    """Return in words what a fabric is, and where its values are from."""
    if fabric is None:
        return []
    return [
        f"fabric: {fabric.name}",
        f"source: {fabric.source}",
        *(f"measured: {text}" for text in fabric.measured),
        *(f"assumed: {text}" for text in fabric.assumed),
    ]


def _time_for_accuracy(case: Case) -> list[str]:
    """Return in words how long a wanted accuracy takes."""
    if case.accuracy is None:
        return []
    from wovenfab.study.errors.report import expected_seconds

    seconds = float(f"{expected_seconds(case):.1g}")
    words = f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"
    return [
        f"{100 * case.accuracy:g} % takes about {words} on two processors like those of "
        "docs/random-fabrics.md, by experience with other fabrics (a third to three times of that)"
    ]


PLACEMENTS = {1: "one placement", 2: "two placements"}


def _brought(now: Needs, more: Needs) -> str:
    """Return in words what an effect with other needs would bring to a scene."""
    news = (
        (more.placements > now.placements, "a second placement"),
        (
            more.second_gradient and not now.second_gradient,
            "second gradients and facet integrals",
        ),
        (more.rate and not now.rate, "rates, so that speed matters"),
        (more.increment and not now.history, "history"),
    )
    return " and ".join(what for is_new, what in news if is_new) or "its own terms only"


def _listed(names: Sequence[str]) -> str:
    return " or ".join(part for part in (", ".join(names[:-1]), names[-1]) if part)


def _grouped(number: int) -> str:
    return f"{number:,}".replace(",", " ")


#: Ends the name of the definition of what says only a part.
_PART = "_part"


def published_schema(whole: Json) -> Json:
    """Return a schema for both kinds of cases, given that of a whole one.

    A case that starts from another may leave out every key, and take one out by null.
    """
    head = {key: whole[key] for key in ("$schema", "title", "description")}
    case = {key: value for key, value in whole.items() if key not in (*head, "$defs")}
    parts = {name + _PART: _part(value) for name, value in whole["$defs"].items()}
    return {
        **head,
        "if": {"type": "object", "required": [FROM]},
        "then": _part(case),
        "else": case,
        "$defs": whole["$defs"] | parts,
    }


def _part(schema: Any) -> Any:
    """Return the schema of something of which any part may be said."""
    if isinstance(schema, list):
        return [_part(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    left = {k: v for k, v in schema.items() if k not in ("required", "discriminator", "default")}
    part = {{"oneOf": "anyOf"}.get(k, k): _part(v) for k, v in left.items()}
    if "$ref" in part:
        part["$ref"] += _PART
    if isinstance(schema.get("properties"), dict):
        part["properties"] = {k: _or_null(_part(v)) for k, v in schema["properties"].items()}
    return part


def _or_null(schema: Json) -> Json:
    text = {"description": schema["description"]} if "description" in schema else {}
    return text | {"anyOf": [schema, {"type": "null"}]}


_HEAD = """\
# The effects and their parameters

Written by `make docs` from the files in [forms/](../forms). Energies and potentials are in
[the model](model.md); units are those in which results are given, a case may use any other.

| effect | what it is | parameters | what it needs |
|---|---|---|---|
"""


def effects_page() -> str:
    """Return the page in Markdown."""
    known = effects().values()
    return _HEAD + "".join(_row(law, law is effect) for effect in known for law in effect.all_laws)


def _row(effect: Effect, default: bool) -> str:
    name = f"`{effect.name}`" if default else f"`{effect.name}` with `law: {effect.law}`"
    table = [] if effect.table is None else [_table(effect.table)]
    parameters = "; ".join([*table, *map(_parameter, effect.parameters)])
    needs = (
        (effect.needs.placements == 2, "two placements"),
        (effect.needs.second_gradient, "second gradients"),
        (effect.needs.rate, "rates"),
        (effect.needs.increment or bool(effect.memory), "history"),
    )
    needed = ", ".join(what for is_needed, what in needs if is_needed)
    cells = (name, effect.summary, parameters, needed)
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |\n"


def _table(table: TableParameter) -> str:
    family = " (may differ between the families)" if table.per_family else ""
    return f"`{TABLE}`{family}: {table.meaning}"


def _parameter(p: Parameter) -> str:
    unit = "a number" if p.unit == "1" else p.unit
    bound = "" if p.zero_allowed else ", above 0"
    bound = bound if p.above is None else f", above {p.above:g}"
    default = "" if p.default is None else f", {p.default:g} unless given"
    family = ", may differ between the families" if p.per_family else ""
    return f"`{p.name}` ({unit}{bound}{default}{family}): {p.meaning}"
