"""What a case may ask of a machine: steps, unknowns and memory."""

from __future__ import annotations

from mpi4py import MPI

from wovenfab.case.case import Case
from wovenfab.case.errors import CaseError
from wovenfab.case.schema import Rectangle
from wovenfab.simulation.progress import memory, memory_of_machines

#: Steps that a program may have in all.
MOST_STEPS = 2_000_000


def require_possible(case: Case, comm: MPI.Comm) -> None:
    """Refuse more steps, or a rectangle with more unknowns, than there can be; collective.

    Raises:
        CaseError: On every rank.
    """
    if (steps := case.planned_steps) > MOST_STEPS:
        message = f"has {steps:.3g} steps; at most {MOST_STEPS:.3g} are possible"
        raise CaseError([case.problem("program", message, "Take fewer steps a cycle or cycles.")])
    if isinstance(case.sheet, Rectangle) and (size := case.discretisation.mesh_size):
        triangles = 2 * case.sheet.length * case.sheet.width / size**2
        nodes = triangles * case.discretisation.degree**2 / 2
        require_memory(case, int(2 * nodes * case.needs.placements), comm)


def require_memory(case: Case, unknowns: int, comm: MPI.Comm) -> None:
    """Refuse what the memory of all machines together cannot hold; collective.

    Raises:
        CaseError: On every rank.
    """
    have = memory_of_machines(comm)
    if (need := memory(unknowns)) > have:
        message = (
            f"about {unknowns:.3g} unknowns need about {need / 1e9:.3g} GB of memory, "
            f"and there are {have / 1e9:.3g} GB"
        )
        remedy = "Take larger cells or a lower degree, or more machines."
        raise CaseError([case.problem("discretisation.mesh_size", message, remedy)])
