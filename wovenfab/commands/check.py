"""``wovenfab check``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from wovenfab.case import Case, read_case
from wovenfab.commands.sheet import sheet_for
from wovenfab.commands.voice import Voice

if TYPE_CHECKING:
    from wovenfab.sheet.sheet import Sheet


def check_case(path: Path, overrides: Sequence[str]) -> int:
    """Validate a case file, say what would be built and return the exit code."""
    voice = Voice()
    case = read_case(path, overrides)
    sheet = sheet_for(case, path, overrides)
    from wovenfab.simulation.assemble import program_of_case

    steps = len(program_of_case(case).milestones) - 1
    for line in describe(case, count_unknowns(case, sheet), steps):
        voice.say(line)
    return 0


def count_unknowns(case: Case, sheet: Sheet) -> int:
    """Return the number of unknowns without building the space."""
    mesh, p = sheet.mesh, case.discretisation.degree
    mesh.topology.create_entities(1)
    points, edges, cells = (mesh.topology.index_map(d).size_global for d in (0, 1, 2))
    nodes = points + (p - 1) * edges + (p - 1) * (p - 2) // 2 * cells
    return int(2 * case.needs.placements * nodes)


def describe(case: Case, unknowns: int, steps: int) -> list[str]:
    """Return in words what a run would build."""
    needs = case.needs
    placements = "two placements" if needs.placements == 2 else "one placement"
    facets = "facet integrals (bending)" if needs.second_gradient else "no facet integrals"
    time = f"rates by {case.time.scheme}" if needs.rate else "rate-independent"
    return [
        f"{case.name}: {case.title}" if case.title else case.name,
        f"effects: {', '.join(case.effects)}",
        f"{placements}, {facets}, {time}: {_grouped(unknowns)} unknowns, {steps} load steps, "
        f"about {memory(unknowns) / 1e9:.1f} GB of memory",
        "the case is valid",
    ]


def memory(unknowns: int) -> float:
    """Return a rough estimate of the memory of a run on one rank (bytes).

    Fitted to runs of 8 000 to 500 000 unknowns, P3 with two placements; ``make bench``
    prints the measured values beside it.
    """
    return float(1.0e8 + 7.0e3 * unknowns * (max(unknowns, 1) / 8e3) ** 0.09)


def _grouped(number: int) -> str:
    return f"{number:,}".replace(",", " ")
