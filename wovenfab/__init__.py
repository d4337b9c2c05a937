"""wovenfab: how woven fabrics stretch, shear, bend, slip and dissipate.

Three lines in a notebook or a script, also under ``mpirun``::

    case = wovenfab.read_case("configs/bias-1x3.yaml", {"program.amplitudes": "40 mm"})
    run = wovenfab.simulate(case)
    run.history["force"]

The same without a case, from any dolfinx mesh with tagged edges::

    sheet = wf.Sheet(mesh, tags, {"left": 1, "right": 2}, wf.directions((pi / 4, -pi / 4)))
    edges = [wf.clamp("left"), wf.move("right", (wf.PROGRAM, 0.0))]
    model = wf.build_model(sheet, [wf.stretch(5e5), wf.shear(40.0), wf.bending(0.02)], edges)
    run = wf.simulate(wf.Simulation(wf.Problem(model), wf.program(wf.Ramp(0.01))))

Effects are attributes by their names (``wf.stretch``), those of ``wf.effects()``.
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str
    from wovenfab.case import Case, CaseError, read_case
    from wovenfab.case.objects import sheet_of, simulation_of
    from wovenfab.forms import effects
    from wovenfab.forms.bending import EFFECT as bending
    from wovenfab.forms.coupling import EFFECT as coupling
    from wovenfab.forms.crimp import EFFECT as crimp
    from wovenfab.forms.effect import (
        DualFrictionLaw,
        Effect,
        InternalVariable,
        Needs,
        OfShearAngle,
        Parameter,
        Strain,
        Target,
        Term,
    )
    from wovenfab.forms.power_shear import EFFECT as power_shear
    from wovenfab.forms.shear import EFFECT as shear
    from wovenfab.forms.slip_friction import EFFECT as slip_friction
    from wovenfab.forms.spin_friction import EFFECT as spin_friction
    from wovenfab.forms.stretch import EFFECT as stretch
    from wovenfab.forms.table import ForceTable
    from wovenfab.forms.viscous_slip import EFFECT as viscous_slip
    from wovenfab.interface import (
        History,
        Run,
        SolvedStep,
        StepOverError,
        read_results,
        simulate,
        steps,
    )
    from wovenfab.model.constraints import PROGRAM, EdgeLoad, Grip, Held, clamp, load, move
    from wovenfab.model.model import Model, Numerics, build_model
    from wovenfab.model.probes import PointFields, Probes, points_of_yarn
    from wovenfab.record.output import Output
    from wovenfab.record.results import NothingToResumeError, ResultsExistError
    from wovenfab.sheet.aligned import fibre_sheet
    from wovenfab.sheet.errors import GeometryError
    from wovenfab.sheet.probes import (
        Extensometer,
        Line,
        PointProbe,
        Yarn,
        Zone,
        circle_zone,
        rectangle_zone,
    )
    from wovenfab.sheet.sheet import Sheet, directions
    from wovenfab.simulation.simulation import Outcome, Simulation
    from wovenfab.solver.equilibrium import EquilibriumSolver
    from wovenfab.solver.problem import OptionError, Problem, SolveResult, SolverOptions
    from wovenfab.stepping.program import Program
    from wovenfab.stepping.segments import Cycles, Hold, Ramp, Table, Trapezoid, program
    from wovenfab.stepping.stability import StabilityLostError
    from wovenfab.stepping.step import Step, StepFailedError

#: Public names by the modules that have them.
_PUBLIC = {
    "case": ("Case", "CaseError", "read_case"),
    "case.objects": ("sheet_of", "simulation_of"),
    "forms": ("effects",),
    "forms.effect": (
        *(
            "DualFrictionLaw",
            "Effect",
            "InternalVariable",
            "Needs",
            "OfShearAngle",
            "Parameter",
            "Strain",
        ),
        *("Parameter", "Strain", "Target", "Term"),
    ),
    "forms.table": ("ForceTable",),
    "interface": (
        *("History", "Run", "SolvedStep", "StepOverError"),
        *("read_results", "simulate", "steps"),
    ),
    "model.constraints": ("PROGRAM", "EdgeLoad", "Grip", "Held", "clamp", "load", "move"),
    "model.model": ("Model", "Numerics", "build_model"),
    "model.probes": ("PointFields", "Probes", "points_of_yarn"),
    "record.output": ("Output",),
    "record.results": ("NothingToResumeError", "ResultsExistError"),
    "sheet.aligned": ("fibre_sheet",),
    "sheet.errors": ("GeometryError",),
    "sheet.probes": (
        *("Extensometer", "Line", "PointProbe", "Yarn", "Zone"),
        *("circle_zone", "rectangle_zone"),
    ),
    "sheet.sheet": ("Sheet", "directions"),
    "simulation.simulation": ("Outcome", "Simulation"),
    "solver.equilibrium": ("EquilibriumSolver",),
    "solver.problem": ("OptionError", "Problem", "SolveResult", "SolverOptions"),
    "stepping.program": ("Program",),
    "stepping.segments": ("Cycles", "Hold", "Ramp", "Table", "Trapezoid", "program"),
    "stepping.stability": ("StabilityLostError",),
    "stepping.step": ("Step", "StepFailedError"),
}
_HOMES = {name: module for module, names in _PUBLIC.items() for name in names}
__all__ = ["__version__", *sorted(_HOMES)]


class _MpiFirst:
    """Loads MPI before the first module that needs its library, and starts PETSc before dolfinx.

    It finds no module itself, and makes sure of what MPI and dolfinx need at their start.

    Only what Python has loaded by itself is imported before: with ``python -m`` the current folder
    is still the first in which modules are looked for.
    """

    waits = True

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> None:
        """Load MPI if a module needs it, and leave the search to others."""
        if name == "mpi4py.MPI":
            from wovenfab.lacking import require_home
            from wovenfab.mpi import require_own_launcher

            require_home()
            require_own_launcher()
        if self.waits and name in ("dolfinx", "petsc4py"):
            from wovenfab.mpi import load, start_petsc

            self.waits = False
            try:
                load()
            except BaseException:
                self.waits = True
                raise
            if name == "dolfinx":
                start_petsc()


sys.meta_path.insert(0, _MpiFirst())


def _version() -> str:
    """Return the version of the source tree this file lies in, or the installed one."""
    import tomllib
    from importlib.metadata import PackageNotFoundError, version

    project = Path(__file__).parent.parent / "pyproject.toml"
    if project.is_file():
        return str(tomllib.loads(project.read_text(encoding="utf-8"))["project"]["version"])
    try:
        return version("wovenfab")
    except PackageNotFoundError:
        return "unknown"


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used: the command line needs only parts of it."""
    if name == "__version__":
        return _version()
    if name in _HOMES:
        return getattr(import_module(f"wovenfab.{_HOMES[name]}"), name)
    if not name.startswith("_"):
        known = import_module("wovenfab.forms").effects()
        if name in known:
            return known[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """Return the public names, too."""
    return sorted({*globals(), *__all__, *import_module("wovenfab.forms").effects()})
