"""Cost and influence of each effect: the scene with all, without each, and with each alone.

Everything is measured in this process; no results are written.
"""

from __future__ import annotations

import csv
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, fields
from itertools import combinations
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

from wovenfab.case import Case, CaseError
from wovenfab.record.history import peak_force
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.from_case import sheet_of
from wovenfab.simulation.simulation import Simulation
from wovenfab.solver.problem import TANGENT


@dataclass(frozen=True)
class Cost:
    """Cost and results of a scene.

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
        peak_force: Recorded force of largest size of the driven edge along its motion, N.
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
    """Run a case from an empty kernel cache and return its cost; collective.

    Args:
        case: The case.
        sheet: Its meshed sheet, or that of a case with which it is compared.
    """
    with ExitStack() as stack:
        with _empty_cache(sheet.mesh.comm):
            start = time.perf_counter()
            simulation = stack.enter_context(Simulation(case, sheet, "ignore"))
            compiled = time.perf_counter() - start
        PETSc.Log.begin()
        tangent, factor = _Event(TANGENT), _Event("MatCholFctrNum")
        start = time.perf_counter()
        recorded = list(simulation.steps())
        whole = time.perf_counter() - start
        steps, model = max(len(recorded) - 1, 1), simulation.model
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
            iterations=sum(step.iterations for step in recorded) / steps,
            peak_force=peak_force([step.force for step in recorded]),
            dissipated=sum(recorded[-1].dissipated.values()),
        )


class _Event:
    """A PETSc event, counted from its creation on."""

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


#: Returns the case with the named effects only, or raises CaseError.
Reader = Callable[[Sequence[str]], Case]


@dataclass(frozen=True)
class Row:
    """One scene of the study.

    Attributes:
        scene: ``"all effects"``, ``"without <effect>"`` or ``"<effect> alone"``, where a
            case that is not well posed alone has the fewest others that make it so.
        cost: Its cost, or None where it is not a well-posed problem.
        refused: Why not, else empty.
    """

    scene: str
    cost: Cost | None
    refused: str = ""


def reader(case: Case) -> Reader:
    """Return how a case is read with some of its effects."""
    names = tuple(case.effects)

    def read(present: Sequence[str]) -> Case:
        return case.changed(*(f"effects.{name}=null" for name in names if name not in present))

    return read


def study(
    names: Sequence[str], read: Reader, comm: MPI.Comm, report: Callable[[Row], None]
) -> list[Row]:
    """Measure all scenes of a case one after the other; collective.

    Args:
        names: The effects of the case.
        read: Returns the case with some of them.
        comm: The ranks that compute.
        report: Called with each row.
    """
    sheet = sheet_of(read(names), comm)  # one mesh for all, so that only the effects differ
    rows: dict[frozenset[str], Row] = {}
    for scene, present in _scenes(names, read):
        if frozenset(present) in rows:
            continue
        try:
            case = read(present)
        except CaseError as error:
            row = Row(scene, None, error.problems[0].message)
        else:
            row = Row(scene, measure(case, sheet))
        report(row)
        rows[frozenset(present)] = row
    return list(rows.values())


def _scenes(names: Sequence[str], read: Reader) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield each scene's name and its effects."""
    yield "all effects", tuple(names)
    for name in names:
        yield f"without {name}", tuple(n for n in names if n != name)
    for name in names:
        others = _fewest(name, names, read)
        scene = f"{name} with {' and '.join(others)}" if others else f"{name} alone"
        yield scene, (name, *others)


def _fewest(name: str, names: Sequence[str], read: Reader) -> tuple[str, ...]:
    """Return the fewest other effects with which ``name`` makes a well-posed problem."""
    others = [n for n in names if n != name]
    for count in range(len(others)):
        for chosen in combinations(others, count):
            try:
                read((name, *chosen))
            except CaseError:
                continue
            return chosen
    return ()


def line(row: Row) -> str:
    """Return the main figures of a row in words."""
    if row.cost is None:
        return f"{row.scene}: not well posed: {row.refused}"
    c = row.cost
    return (
        f"{row.scene}: {c.unknowns} unknowns, {c.compile:.1f} s to compile, "
        f"{1e3 * c.step:.0f} ms a step, peak force {c.peak_force:.5g} N, "
        f"dissipated {c.dissipated:.4g} J"
    )


def write_csv(rows: Sequence[Row], path: Path) -> None:
    """Write the table in SI units."""
    names = [f.name for f in fields(Cost)]
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, ["scene", *names, "refused"])
        writer.writeheader()
        for row in rows:
            values = asdict(row.cost) if row.cost else {}
            writer.writerow({"scene": row.scene, **values, "refused": row.refused})


#: Heading, unit and how a cost is shown in the table.
COLUMNS: tuple[tuple[str, Callable[[Cost], str]], ...] = (
    ("unknowns", lambda c: f"{c.unknowns}"),
    ("facet integrals", lambda c: f"{c.facet_integrals}"),
    ("compile (s)", lambda c: f"{c.compile:.1f}"),
    ("assembly (ms)", lambda c: f"{1e3 * c.assembly:.0f}"),
    ("factorisation (ms)", lambda c: f"{1e3 * c.factorisation:.0f}"),
    ("step (ms)", lambda c: f"{1e3 * c.step:.0f}"),
    ("all steps (s)", lambda c: f"{c.whole:.1f}"),
    ("iterations", lambda c: f"{c.iterations:.1f}"),
    ("tangents", lambda c: f"{c.tangents:.1f}"),
    ("peak force (N)", lambda c: f"{c.peak_force:.4g}"),
    ("dissipated (J)", lambda c: f"{c.dissipated:.3g}"),
)


def markdown(rows: Sequence[Row]) -> str:
    """Return the table in Markdown; scenes that are not well posed with the reason."""
    lines = [
        "| scene | " + " | ".join(title for title, _ in COLUMNS) + " |",
        "|---|" + "---:|" * len(COLUMNS),
    ]
    for row in rows:
        if row.cost is not None:
            cost = row.cost
            lines.append(f"| {row.scene} | " + " | ".join(show(cost) for _, show in COLUMNS) + " |")
    refused = [f"- {row.scene}: {row.refused}" for row in rows if row.cost is None]
    if refused:
        lines += ["", "Not well posed, and refused:", "", *refused]
    return "\n".join(lines) + "\n"
