"""What each way to a solution costs on steps that are hard, as a table."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.hard.measurement import Measurement
from benchmarks.hard.row import Setting
from benchmarks.hard.trials import Counted, Halving, Patient, Shifted, TrustRegion
from wovenfab.stepping.step_size import StepSizeControl

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
#: Shares of the yarns' stiffness with which a continuation comes to the whole.
SOFTENED = (1e-3, 1e-2, 1e-1, 1.0)


@dataclass(frozen=True)
class Tally:
    """What a case cost.

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
    measurement.destroy()
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
    whole = [float(k.value) for k in stiff]
    force = None
    for step in range(1, program.steps + 1):  # type: ignore[union-attr]
        measurement.constraints.set(program.to * step / program.steps)  # type: ignore[union-attr]
        for share in SOFTENED:
            for k, value in zip(stiff, whole, strict=True):
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


def compare(tell: Callable[[str], None] = print) -> dict[str, dict[str, Tally]]:
    """Return the tallies by way and case."""
    found: dict[str, dict[str, Tally]] = {}
    for way, run in WAYS.items():
        found[way] = {}
        for name, setting in CASES.items():
            found[way][name] = run(setting)
            tell(f"{way}: {name}: {found[way][name]}")
    return found


def section(found: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> str:
    """Return the section of the page."""
    lines = [TEXT, "| | " + " | ".join(CASES) + " |", "|---|" + "---:|" * len(CASES)]
    for way, tallies in found.items():
        lines.append(f"| {way} | " + " | ".join(_cell(tallies[name]) for name in CASES) + " |")
    return "\n".join(lines) + "\n"


def _cell(tally: Mapping[str, Any]) -> str:
    end = "not reached" if tally["force"] is None else f"{tally['force'] / 1e3:.4g} kN"
    return f"{tally['solves']}, {tally['iterations']}, {end}"


if __name__ == "__main__":
    tallies = compare(lambda text: print(text, flush=True))
    plain = {way: {n: asdict(t) for n, t in row.items()} for way, row in tallies.items()}
    Path(sys.argv[1]).write_text(json.dumps(plain), encoding="utf-8")
