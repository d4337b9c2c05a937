"""Simulations leave no PETSc object behind, and live beside each other."""

from __future__ import annotations

import gc
import re
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from wovenfab.case import Case, CaseError, read_case
from wovenfab.case.objects import sheet_of, simulation_of
from wovenfab.sheet.sheet import Sheet
from wovenfab.stepping.step import Step

CONFIGS = Path(__file__).parents[2] / "configs"
SMALL = (
    *("discretisation.mesh_size=150 mm", "discretisation.degree=2", "output.pictures=false"),
    "program={type: ramp, to: 10 mm, steps: 2, velocity: 0.1 m/s}",
)


#: Classes of the objects that hold much memory, and of the solvers.
LARGE = ("Matrix", "Preconditioner", "Krylov Solver", "SNES")


def objects_alive(folder: Path) -> dict[str, int]:
    """Return how many PETSc objects of each class were created and not destroyed."""
    file = folder / "log.txt"
    viewer = PETSc.Viewer().createASCII(str(file), "w", comm=PETSc.COMM_SELF)
    PETSc.Log.view(viewer)
    viewer.destroy()
    rows = re.findall(r"^ *([A-Za-z][\w ]*?) +(\d+) +(\d+)$", file.read_text(), re.M)
    assert {"Matrix", "Vector", "Krylov Solver"} <= {name.strip() for name, *_ in rows}
    return {name: int(made) - int(gone) for name, made, gone in rows if name != "Viewer"}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("bias-1x3", marks=pytest.mark.slow),
        "coulomb",
        pytest.param("force-cycles", marks=pytest.mark.slow),
        pytest.param("compression", marks=pytest.mark.slow),
    ],
)
def test_simulations_that_are_dropped_leave_no_object(name: str, tmp_path: Path) -> None:
    PETSc.Log.begin()
    case = read_case(CONFIGS / f"{name}.yaml", SMALL[:-1] if name == "force-cycles" else SMALL)
    sheet = sheet_of(case, MPI.COMM_SELF)

    def make() -> None:
        with simulation_of(case, sheet) as simulation:
            steps = simulation.steps()
            for _ in range(3):
                next(steps)

    make()  # what is made once for all
    gc.collect()
    before = objects_alive(tmp_path)
    gc.disable()
    try:
        for _ in range(3):
            make()
        # matrices and factors do not wait for the collector; vectors of fields are dolfinx's
        now = objects_alive(tmp_path)
        assert [name for name in LARGE if now.get(name) != before.get(name)] == []
    finally:
        gc.enable()
    gc.collect()
    assert objects_alive(tmp_path) == before


def test_simulations_that_live_at_the_same_time_do_not_disturb_each_other() -> None:
    case = read_case(CONFIGS / "bias-1x3.yaml", SMALL)
    stiff = case.changed("effects.shear.stiffness=4000 N/m")
    sheet = sheet_of(case, MPI.COMM_SELF)
    alone = {id(c): [step.force for step in _steps(c, sheet)] for c in (case, stiff)}
    with simulation_of(case, sheet) as one, simulation_of(stiff, sheet) as other:
        pairs = list(zip(one.steps(), other.steps(), strict=True))
    for index, c in enumerate((case, stiff)):
        forces = [pair[index].force for pair in pairs]
        np.testing.assert_allclose(forces, alone[id(c)], rtol=1e-9, atol=1e-12)


def _steps(case: Case, sheet: Sheet) -> list[Step]:
    with simulation_of(case, sheet) as simulation:
        return list(simulation.steps())


def test_a_state_that_is_not_there_leaves_no_options(tmp_path: Path) -> None:
    changes = (*SMALL, f"from_state={tmp_path}")
    case = read_case(CONFIGS / "elastic-1x3.yaml", changes)
    before = PETSc.Options().getAll()
    with pytest.raises(CaseError, match="checkpoint"):
        simulation_of(case, sheet_of(case, MPI.COMM_SELF))
    assert PETSc.Options().getAll() == before
