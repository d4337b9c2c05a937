"""What a step takes beside its arithmetic: assembly, factorisations and solutions."""

from __future__ import annotations

import cProfile
import pstats
import time

from mpi4py import MPI

from benchmarks.figure import Figure
from benchmarks.probe import CASE
from wovenfab.case import Case, read_case
from wovenfab.case.objects import sheet_of, simulation_of
from wovenfab.sheet.sheet import Sheet

SETTINGS = ("program.amplitudes=40 mm", "time.steps_per_cycle=40")
#: Functions that are arithmetic alone, by file and name; of PETSc's those of its linear solver.
ARITHMETIC = {
    ("fem/petsc.py", "assemble_matrix_mat"),
    ("fem/petsc.py", "_assemble_vector_vec"),
    ("fem/petsc.py", "apply_lifting"),
    ("fem/assemble.py", "assemble_scalar"),
    ("~", "<method 'setUp' of 'petsc4py.PETSc.KSP' objects>"),
    ("~", "<method 'solve' of 'petsc4py.PETSc.KSP' objects>"),
}
REPEATS = 3


def step_cost() -> list[Figure]:
    """Return the time of the default case's steps over that of their arithmetic."""
    case = read_case(CASE, SETTINGS)
    sheet = sheet_of(case, MPI.COMM_SELF)
    _run(case, sheet)  # compiles
    ratios = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        unknowns, steps = _run(case, sheet)
        whole = time.perf_counter() - start
        profile = cProfile.Profile()
        profile.runcall(_run, case, sheet)
        arithmetic = _arithmetic(profile)
        ratios.append(whole / arithmetic)
        print(f"{steps} steps of {unknowns} unknowns: {whole:.2f} s, arithmetic {arithmetic:.2f} s")
    ratio = sorted(ratios)[REPEATS // 2]
    note = f"{unknowns} unknowns, {steps} steps, 1 rank; median of {REPEATS} pairs"
    return [Figure("time of a step over its arithmetic", ratio, 1.5, "x", note)]


def _run(case: Case, sheet: Sheet) -> tuple[int, int]:
    """Make all steps; return the number of unknowns and of steps."""
    with simulation_of(case, sheet) as simulation:
        count = sum(1 for _ in simulation.steps())
        return simulation.model.unknowns, count - 1


def _arithmetic(profile: cProfile.Profile) -> float:
    """Return the time in arithmetic, s."""
    stats: dict[tuple[str, int, str], tuple[int, int, float, float, object]]
    stats = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    return sum(
        of[3]
        for (file, _, name), of in stats.items()
        if any(file.endswith(end) and name == function for end, function in ARITHMETIC)
    )
