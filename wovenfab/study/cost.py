"""What one scene costs, measured in this process without writing any results."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

from wovenfab.case import Case
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.rig import Rig, rig_of
from wovenfab.solver.system import TANGENT


@dataclass(frozen=True)
class Cost:
    """What a scene costs and gives.

    Attributes:
        unknowns: Number of unknowns.
        placements: 1 or 2.
        facet_integrals: Number of integrals over interior facets in the tangent.
        compile: Time from UFL to machine code with an empty cache, s.
        assembly: Time to assemble one tangent, s.
        factorisation: Time of one numerical factorisation, s.
        tangents: Mean number assembled in a step.
        factorisations: Mean number in a step.
        step: Mean time of a step, s.
        whole: Time of all steps, s.
        iterations: Mean Newton iterations of a step.
        peak_force: Largest force of the driven edge along its motion, N.
        dissipated: Energy dissipated at the end, J.
    """

    unknowns: int
    placements: int
    facet_integrals: int
    compile: float
    assembly: float
    factorisation: float
    tangents: float
    factorisations: float
    step: float
    whole: float
    iterations: float
    peak_force: float
    dissipated: float


def measure(case: Case, sheet: Sheet) -> Cost:
    """Run a case from an empty kernel cache and return what it cost; collective.

    Args:
        case: The case.
        sheet: Its meshed sheet, or that of a case with which it is compared.
    """
    comm = sheet.mesh.comm
    with ExitStack() as stack:
        with _empty_cache(comm):
            start = time.perf_counter()
            rig = stack.enter_context(rig_of(case, sheet, "ignore"))
            compiled = time.perf_counter() - start
        return _march(rig, compiled)


def _march(rig: Rig, compiled: float) -> Cost:
    """Go through the program and return what it cost, with the time to compile (s)."""
    PETSc.Log.begin()
    tangent, factor = _Event(TANGENT), _Event("MatCholFctrNum")
    forces, iterations, lost = [], [], 0.0
    start = time.perf_counter()
    for step in rig.march.steps():
        forces.append(rig.force(step.reactions)[0])
        iterations.append(step.iterations)
        lost = sum(step.dissipated.values())
    whole = time.perf_counter() - start
    steps, model = max(len(forces) - 1, 1), rig.model
    tangents, assembly = tangent.since()
    factorisations, factorisation = factor.since()
    return Cost(
        unknowns=model.unknowns,
        placements=model.placements.count,
        facet_integrals=model.facet_integrals,
        compile=compiled,
        assembly=assembly,
        factorisation=factorisation,
        tangents=tangents / steps,
        factorisations=factorisations / steps,
        step=whole / steps,
        whole=whole,
        iterations=sum(iterations) / steps,
        peak_force=max(forces, key=abs),
        dissipated=lost,
    )


class _Event:
    """A PETSc event, counted from now on."""

    def __init__(self, name: str) -> None:
        self._event = PETSc.Log.Event(name)
        self._before = self._event.getPerfInfo()

    def since(self) -> tuple[int, float]:
        """Return how often it has happened since the start, and its mean time, s."""
        now = self._event.getPerfInfo()
        count = now["count"] - self._before["count"]
        return count, float((now["time"] - self._before["time"]) / max(count, 1))


@contextmanager
def _empty_cache(comm: MPI.Comm) -> Iterator[None]:
    """Let kernels be compiled anew inside, in a folder that all ranks share."""
    before = os.environ.get("XDG_CACHE_HOME")
    folder = tempfile.TemporaryDirectory() if comm.rank == 0 else None
    os.environ["XDG_CACHE_HOME"] = comm.bcast(folder.name if folder else None)
    try:
        yield
    finally:
        if before is None:
            del os.environ["XDG_CACHE_HOME"]
        else:
            os.environ["XDG_CACHE_HOME"] = before
        comm.barrier()
        if folder:
            folder.cleanup()
