"""Cost and influence of each effect: the scene with all, without each, and with each alone.

Everything is measured in this process; no results are written. Influence of each parameter: the
derivatives of force and dissipated energy along the program.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, fields, replace
from itertools import combinations
from pathlib import Path
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

from wovenfab.case import Case, CaseError
from wovenfab.case.formula import Expression, coefficients
from wovenfab.case.objects import differentiate, simulation_of
from wovenfab.forms.effect import Target
from wovenfab.parallel import compute_on_root
from wovenfab.record.history import peak_force
from wovenfab.record.results import markdown, write_csv
from wovenfab.sheet.sheet import Sheet
from wovenfab.solver.problem import TANGENT
from wovenfab.stepping.step import Step
from wovenfab.study.errors.report import settled


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
    """Run a case on a meshed sheet from an empty kernel cache and return its cost; collective."""
    with ExitStack() as stack:
        with _empty_cache(sheet.mesh.comm):
            start = time.perf_counter()
            simulation = stack.enter_context(simulation_of(case, sheet, "ignore"))
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
    folders: list[tempfile.TemporaryDirectory[str]] = []

    def make() -> str:
        folders.append(tempfile.TemporaryDirectory())
        return folders[0].name

    os.environ["XDG_CACHE_HOME"] = compute_on_root(comm, make)
    try:
        yield
    finally:
        if before is None:
            del os.environ["XDG_CACHE_HOME"]
        else:
            os.environ["XDG_CACHE_HOME"] = before
        comm.barrier()
        for folder in folders:
            folder.cleanup()


@dataclass(frozen=True)
class EffectRow:
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


def with_effects(case: Case, names: Sequence[str]) -> Case:
    """Return a case with some of its effects.

    Raises:
        CaseError: The problem is not well posed.
    """
    return case.changed(*(f"effects.{name}=null" for name in case.effects if name not in names))


def study(
    case: Case,
    comm: MPI.Comm,
    report: Callable[[EffectRow], None],
    say: Callable[[str], None] = lambda text: None,
) -> list[EffectRow]:
    """Measure all scenes of a case one after the other, and report each row; collective.

    All have the same elements and steps, so that only the effects differ: those of the case, or
    what its accuracy takes with all effects, of which ``say`` is told.
    """
    case, sheet = settled(case, comm, say)
    rows: dict[frozenset[str], EffectRow] = {}
    for scene, names in _scenes(case):
        if frozenset(names) in rows:
            continue
        try:
            row = EffectRow(scene, measure(with_effects(case, names), sheet))
        except CaseError as error:
            row = EffectRow(scene, None, error.problems[0].message)
        report(row)
        rows[frozenset(names)] = row
    return list(rows.values())


def _scenes(case: Case) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield each scene's name and its effects."""
    names = tuple(case.effects)
    yield "all effects", names
    for name in names:
        yield f"without {name}", tuple(n for n in names if n != name)
    for name in names:
        others = _fewest(name, case)
        scene = f"{name} with {' and '.join(others)}" if others else f"{name} alone"
        yield scene, (name, *others)


def _fewest(name: str, case: Case) -> tuple[str, ...]:
    """Return the fewest other effects with which ``name`` makes a well-posed problem."""
    others = [n for n in case.effects if n != name]
    for count in range(len(others)):
        for chosen in combinations(others, count):
            with suppress(CaseError):
                with_effects(case, (name, *chosen))
                return chosen
    return ()


def line(row: EffectRow) -> str:
    """Return the main figures of a row in words."""
    if row.cost is None:
        return f"{row.scene}: not well posed: {row.refused}"
    c = row.cost
    return (
        f"{row.scene}: {c.unknowns} unknowns, {c.compile:.1f} s to compile, "
        f"{1e3 * c.step:.0f} ms a step, peak force {c.peak_force:.5g} N, "
        f"dissipated {c.dissipated:.4g} J"
    )


def write_table(rows: Sequence[EffectRow], path: Path) -> None:
    """Write the table in SI units."""
    empty = dict.fromkeys(f.name for f in fields(Cost))
    costs = ((row, asdict(row.cost) if row.cost else empty) for row in rows)
    write_csv(path, [{"scene": r.scene, **cost, "refused": r.refused} for r, cost in costs])


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


def printed(rows: Sequence[EffectRow]) -> str:
    """Return the table in Markdown; scenes that are not well posed with the reason."""
    costs = [(row.scene, row.cost) for row in rows if row.cost is not None]
    cells = [[scene, *(show(cost) for _, show in COLUMNS)] for scene, cost in costs]
    table = markdown(["scene", *(title for title, _ in COLUMNS)], cells)
    refused = [f"- {row.scene}: {row.refused}" for row in rows if row.cost is None]
    if refused:
        table += "\n".join(["", "", "Not well posed, and refused:", "", *refused])
    return f"{table}\n"


def parameters_of(case: Case) -> list[Target]:
    """Return all parameters of a case; those of both families as one."""
    return [Target(name, parameter) for name, of in case.effects.items() for parameter in of]


def by_factor(target: Target, case: Case) -> Target:
    """Return a target by a common factor where it is not one number: an unequal pair, a formula."""
    values = _values(target, case)
    several = any(isinstance(v, Expression) or v != values[0] for v in values)
    return replace(target, relative=several and not target.coefficient)


def value_of(target: Target, case: Case) -> float:
    """Return what a derivative is multiplied by for once more of the parameter: its value.

    That of a common factor is 1, that of a coefficient its number as written.
    """
    value = _values(target, case)[0]
    if target.relative:
        return 1.0
    return coefficients(value)[target.coefficient - 1][0] if target.coefficient else float(value)


def _values(target: Target, case: Case) -> list[Any]:
    value = case.effects[target.effect][target.parameter]
    return [value[f] for f in target.families] if isinstance(value, tuple) else [value]


def sensitivities(
    case: Case,
    targets: Sequence[Target],
    comm: MPI.Comm,
    report: Callable[[Step], None],
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, list[float]]:
    """Return force, dissipated energy and their derivatives at each step; collective.

    Args:
        case: The case; for an accuracy its elements and steps are chosen as for a run.
        targets: The parameters.
        comm: The ranks.
        report: Called with each step.
        say: Gets messages.

    Returns:
        Columns by name: ``force_N``, ``d_force/d_shear.stiffness``, ... in SI units; by the
        logarithm of a common factor, ``d_force/d_ln(bending.stiffness)``, where the values of a
        pair differ or are formulas.

    Raises:
        TargetError: If the case has no such parameter.
        StepFailedError: If a step cannot be made.
        StabilityLostError: If the sheet buckles and the case says to stop there.
    """
    rows: list[dict[str, float]] = []
    case, sheet = settled(case, comm, say)
    with simulation_of(case, sheet) as simulation:
        differentiate(simulation, case, targets)
        for step in simulation.steps():
            assert step.derivatives is not None
            row = {
                "step": step.number,
                "time_s": step.time,
                "displacement_m": step.displacement,
                "force_N": step.force,
                "dissipated_J": sum(step.dissipated.values()),
            }
            for what in ("force", "dissipated"):
                values = getattr(step.derivatives, what)
                pairs = zip(targets, values, strict=True)
                row |= {f"d_{what}/d_{target}": float(value) for target, value in pairs}
            rows.append(row)
            report(step)
    return {name: [row[name] for row in rows] for name in rows[0]}
