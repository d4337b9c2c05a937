"""``wovenfab check``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from forms import effects
from forms.effect import Needs
from wovenfab.case import Case, Rectangle, read_case
from wovenfab.case.effects import acting
from wovenfab.cli.console import Console
from wovenfab.simulation.progress import memory
from wovenfab.stepping.program import planned_steps

if TYPE_CHECKING:
    from wovenfab.sheet.sheet import Sheet


#: Triangles above which unknowns are estimated: a mesh takes time to make.
MOST_COUNTED = 1_500


def check_case(path: Path, overrides: Sequence[str], resolved: bool = False) -> int:
    """Validate a case file, say what would be built and return the exit code."""
    console = Console()
    case = read_case(path, overrides)
    if resolved:
        console.say(case.to_yaml().rstrip())
        return 0
    for line in case.remarks():
        console.say(line)
    from mpi4py import MPI

    from wovenfab.simulation.from_case import estimated_unknowns, sheet_of
    from wovenfab.simulation.progress import require_memory

    comm = MPI.COMM_WORLD
    unknowns = estimated_unknowns(case, comm)
    most = MOST_COUNTED * case.discretisation.degree**2 * case.needs.placements
    if exact := unknowns < most:
        unknowns = count_unknowns(case, sheet_of(case, comm))
    require_memory(case, unknowns, comm)
    for line in (*edges_of(case), *describe(case, unknowns, exact)):
        console.say(line)
    return 0


def edges_of(case: Case) -> list[str]:
    """Return in words the edges of a geometry from a file, with their lengths and places."""
    if isinstance(case.sheet, Rectangle):
        return []
    from wovenfab.sheet.geometry_file import edge_lines, read_geometry
    from wovenfab.simulation.from_case import geometry_of

    return edge_lines(read_geometry(geometry_of(case.sheet), follow_curves=True).curves)


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
    inert = [e.name for e in case.scene if e not in acting(case.scene)]
    count = _grouped(unknowns) if exact else f"about {_grouped(round(unknowns, -3))}"
    brought: dict[str, list[str]] = {}
    for effect in effects().values():
        if effect.name not in case.effects:
            brought.setdefault(_brought(needs, effect.needs), []).append(effect.name)
    return [
        f"{case.name}: {case.title}" if case.title else case.name,
        f"effects: {', '.join(present)}",
        f"{PLACEMENTS[needs.placements]}, {facets}, {time}: {count} unknowns, "
        f"{planned_steps(case)} load steps, about {memory(unknowns) / 1e9:.1f} GB of memory",
        *(f"{name} has a value of zero and changes nothing: leave it out" for name in inert),
        *(f"adding {_listed(names)} would bring {what}" for what, names in brought.items()),
        "the case is valid",
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
