"""Other ways to a solution, and their cost on hard steps: the solver with one part replaced.

``python -m benchmarks.hard.alternatives`` prints all tallies as a line of JSON.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from petsc4py import PETSc

from benchmarks.hard.measurement import Measurement
from benchmarks.hard.row import Setting
from wovenfab.record.results import markdown
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.solver.newton import NewtonSolver
from wovenfab.solver.problem import Problem, SolveResult, SolverOptions
from wovenfab.stepping.step import CUT, StepSizeControl

BONDED = Setting("bonded-1x3", ("discretisation.penalty=auto", "solver.stability=ignore"))
GRADED = (
    "sheet.length=600 mm",
    "discretisation.mesh=unstructured",
    "discretisation.mesh_size=80 mm",
    "discretisation.corner_size=0.5 mm",
    "discretisation.degree=3",
)
CASES: Mapping[str, Setting] = {
    "1:3 to 260 mm in one step": BONDED.but("program.to=260 mm", "program.steps=1"),
    "1:3 to 260 mm in 24 steps, K_s = 4 N/m": BONDED.but(
        "program.to=260 mm", "program.steps=24", "effects.shear.stiffness=4 N/m"
    ),
    "1:2 to 130 mm in one step, graded": BONDED.but(
        *GRADED, "program.to=130 mm", "program.steps=1"
    ),
    "1:2 to 200 mm in 8 steps, graded": BONDED.but(*GRADED, "program.to=200 mm", "program.steps=8"),
    "1:2 to 200 mm in 6 steps of at most 5 iterations": BONDED.but(
        "sheet.length=600 mm", "program.to=200 mm", "program.steps=6", "solver.max_iterations=5"
    ),
}
#: Shares of the yarns' stiffness with which a continuation comes to the full one.
SOFTENED = (1e-3, 1e-2, 1e-1, 1.0)


Reason = PETSc.SNES.ConvergedReason
#: Iterations of a trust region, whose steps are shorter.
MANY = 60


class Counted(EquilibriumSolver):
    """The solver as it is, with its efforts counted.

    Attributes:
        solves: Number of solves, failed ones included.
        iterations: Their iterations.
    """

    solves = 0
    iterations = 0

    def solve(self, allow_fallback: bool = True) -> SolveResult:
        """Solve and count."""
        result = super().solve(allow_fallback)
        self.solves += 1
        self.iterations += result.iterations
        return result


class _UnlimitedNewton(NewtonSolver):
    """Newton's method whose steps may cross the families."""

    def admissible_length(self, y: Any) -> float:
        """Note the step and take all of it."""
        super().admissible_length(y)
        return 1.0


class Unlimited(EquilibriumSolver):
    """The solver without the step limit."""

    newton_solver = _UnlimitedNewton


class _UnsearchedNewton(NewtonSolver):
    """Newton's method without line search."""

    def search_line(self, x: Any, y: Any, longest: float) -> float:
        """Take the longest step."""
        self.line_search.forget()
        return longest


class Unsearched(EquilibriumSolver):
    """The solver without line search."""

    newton_solver = _UnsearchedNewton


class _PatientNewton(NewtonSolver):
    """Goes on after searches that find no lower potential, to the last iteration."""

    def test(self, snes: Any, iteration: int, norms: tuple[float, float, float]) -> int:
        """End as usual, but for searches without success."""
        self.line_search.failures = 0
        return super().test(snes, iteration, norms)


class Patient(Counted):
    """Goes on after searches that find no lower potential, to the last iteration."""

    newton_solver = _PatientNewton


class _TrustRegionNewton(NewtonSolver):
    """Newton's method whose first step moves the grips, and a trust region after it."""

    def test(self, snes: Any, iteration: int, norms: tuple[float, float, float]) -> int:
        """End as usual, or when the grips are in place."""
        if snes.getType() == "newtonls" and self.problem.attained:
            self.norm = norms[2]
            return int(Reason.CONVERGED_ITS)
        return super().test(snes, iteration, norms)

    def evaluate_objective(self, snes: Any, x: Any) -> float:
        """Return the potential, J; infinite where families cross."""
        energy = super().evaluate_objective(snes, x)
        return energy if self.crossing.margin() > 0 else float("inf")

    def evaluate_jacobian(self, snes: Any, x: Any, matrix: Any, preconditioner: Any) -> None:
        """Put the tangent in the matrix, in a trust region the plain one."""
        if snes.getType() == "newtontr":
            self.problem.load(x)
            self.problem.model.last.x.array[:] = self.problem.model.field.x.array
        self.form_tangent(x)


class TrustRegion(Counted):
    """PETSc's trust region with the plain tangent, once the grips are in place.

    The first step must raise the potential, for it moves the grips: it is Newton's.
    """

    newton_solver = _TrustRegionNewton

    def solve(self, allow_fallback: bool = True) -> SolveResult:
        """Move the grips by Newton's method and go on with a trust region."""
        snes = self.newton.snes
        snes.setType("newtonls")
        snes.setTolerances(max_it=self.newton.options.max_iterations)
        first = super().solve(allow_fallback)
        if not first.converged:
            return first
        snes.setType("newtontr")
        snes.setTolerances(max_it=MANY)
        second = super().solve(allow_fallback)
        self.solves -= 1
        return replace(second, iterations=first.iterations + second.iterations)


class Shifted(Counted):
    """Shifts every indefinite tangent until it is definite."""

    def __init__(self, problem: Problem, options: SolverOptions) -> None:
        """Create it as usual, with shifts."""
        super().__init__(problem, replace(options, descend=True))


class Halving(StepSizeControl):
    """Halves a step that fails, without memory of earlier steps."""

    def __init__(self, smallest: float) -> None:
        """Start with planned steps."""
        super().__init__(smallest)
        self._targets: list[float] = []
        self._now = 0.0

    def next(self, now: float, end: float) -> float:
        """Return the nearest time that is still to be reached."""
        self._now = now
        self._targets = self._targets or [end]
        return self._targets[-1]

    def accepted(self, length: float, iterations: int) -> None:
        """Go on to the next time."""
        self._targets.pop()

    def reduce(self, length: float, planned: float) -> bool:
        """Step half as far first."""
        self._targets.append(self._now + CUT * length)
        return CUT * length >= self._smallest * planned

    def bisect(self, until: float, length: float) -> None:
        """Step half as far first."""
        self._targets.append(self._now + CUT * length)


@dataclass(frozen=True)
class Tally:
    """The cost of a case.

    Attributes:
        solves, iterations: Of Newton's method, failed attempts included.
        force: At the end, N; None if the end was not reached.
    """

    solves: int
    iterations: int
    force: float | None


def _by(
    solver: type[Counted],
    step_size: Callable[[float], StepSizeControl] = StepSizeControl,
) -> Callable[[Setting], Tally]:
    def run(setting: Setting) -> Tally:
        return _tally(Measurement(setting, solver=solver, step_size=step_size).run())

    return run


def _tally(measurement: Measurement) -> Tally:
    equilibrium = measurement.equilibrium
    assert isinstance(equilibrium, Counted)
    force = float(measurement.force[-1]) if measurement.end == "finished" else None
    return Tally(equilibrium.solves, equilibrium.iterations, force)


def _continued(setting: Setting) -> Tally:
    """Make each step with softer yarns first; no cut-backs."""
    measurement = Measurement(setting, solver=Counted)
    model, program, equilibrium = (
        measurement.model,
        setting.case.program[0],
        measurement.equilibrium,
    )
    assert isinstance(equilibrium, Counted)
    stretches = [t for t in model.balance.terms if "stretching" in t.effect.resists]
    stiff = [k for t in stretches for k in t.values["stiffness"]]
    full = [float(k.value) for k in stiff]
    force = None
    for step in range(1, program.steps + 1):  # type: ignore[union-attr]
        measurement.constraints.set(program.to * step / program.steps)  # type: ignore[union-attr]
        for share in SOFTENED:
            for k, value in zip(stiff, full, strict=True):
                k.value = share * value
            model.last.x.array[:] = model.field.x.array
            if not equilibrium.solve().converged:
                measurement.destroy()
                return Tally(equilibrium.solves, equilibrium.iterations, None)
        force = float(measurement.constraints.reactions(equilibrium.problem.force)["right"][0])
    measurement.destroy()
    return Tally(equilibrium.solves, equilibrium.iterations, force)


WAYS: Mapping[str, Callable[[Setting], Tally]] = {
    "**as it is**": _by(Counted),
    "searches without success go on": _by(Patient),
    "halving, without memory": _by(Counted, Halving),
    "halving, searches go on": _by(Patient, Halving),
    "shift to a definite tangent": _by(Shifted),
    "trust region (newtontr)": _by(TrustRegion),
    "continuation in K_e, no cuts": _continued,
}

TEXT = """## What else was tried

Solves and iterations of Newton's method, those of rejected attempts included, and the force at
the end. *As it is*: a solve ends after two searches in
a row without a lower potential, the second of them with the plain tangent, and a cut step is
remembered and doubled after an easy step. A shift makes every direction one of descent and may
end on another branch than small steps do; where the force differs it did.
"""


def compare() -> dict[str, dict[str, Tally]]:
    """Return the tallies by way and case."""
    return {
        way: {name: run(setting) for name, setting in CASES.items()} for way, run in WAYS.items()
    }


def section(tallies: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> str:
    """Return the section of the page."""
    rows = [[way, *(_cell(of_way[name]) for name in CASES)] for way, of_way in tallies.items()]
    return f"{TEXT}\n{markdown(['', *CASES], rows)}\n"


def _cell(tally: Mapping[str, Any]) -> str:
    end = "not reached" if tally["force"] is None else f"{tally['force'] / 1e3:.4g} kN"
    return f"{tally['solves']}, {tally['iterations']}, {end}"


if __name__ == "__main__":
    print(json.dumps({w: {n: asdict(t) for n, t in row.items()} for w, row in compare().items()}))
