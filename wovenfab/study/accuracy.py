"""What accuracy costs in time, and whether stated errors are true: ``wovenfab accuracy``.

A case is run by doubling, with each degree of elements on ever finer cells with ever more steps,
and for some target accuracies, whose runs state an error. Then it is run once more, with finer
cells of another degree and several times as many steps as the last by doubling. The distance of a
run to this finer answer is its error. Of several cycles the largest is run.

Everything is a member of a sweep: runs are kept, and go on where they were interrupted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

from mpi4py import MPI

from wovenfab.case import Case, CaseError, read_case
from wovenfab.case.objects import sheet_of
from wovenfab.case.program import prescribe_forces
from wovenfab.record.results import markdown, write_csv
from wovenfab.record.summary import read_summary
from wovenfab.sheet.sheet import Sheet
from wovenfab.study.cluster import CASE
from wovenfab.study.errors.choice import COARSEST, SCHEME
from wovenfab.study.errors.meshes import has_free_size, shorter_side, with_cells
from wovenfab.study.response import (
    NOTHING,
    depends_on_steps,
    has_fixed_steps,
    trial_of,
    with_elements,
    with_steps,
)
from wovenfab.study.sweep import Member, SweepRun
from wovenfab.study.variations import Variation

#: Accuracies that are asked for, as many as there are levels.
ACCURACIES = (0.05, 0.01, 0.003, 0.001, 0.0003)
#: Degrees of the runs by doubling, and the share of the case's steps that their first level has.
DEGREES, FIRST_SHARE = (2, 3, 4), 1 / 4
#: Size of the cells of the finer answer over that of the run that it refines, with a degree more
#: and with a degree less, which it has where the run has the largest.
FINER, FINER_BY_FAR, LARGEST_DEGREE = 0.6, 0.4, 5
#: Steps of the finer answer over those of that run: where these do not resolve how friction lets
#: go, twice as many halve the error at best.
SHORTER = 4
#: Largest share of its distance from that run that the finer answer can be wrong by: its error is
#: at most a third of that of the run, and on the same side. First order gives a fourth, but steps
#: that do not resolve how friction lets go show a little less than that.
DOUBT = 1 / 2
FIGURES = {"peak_force_N": "peak force", "dissipated_J": "dissipated"}
#: Phases of a run that its time is made of: without imports, compiling, and the search for elements
#: and steps, which is a phase of its own.
PHASES, SEARCH = ("mesh", "first step", "steps"), "pilot"
#: What the runs do not write.
QUIET = ("output.pictures=false", "output.fields=[]")
TABLE, ANSWERS, CASES = "accuracy.csv", "accuracy.md", "cases"


def doubled(case: Case, folder: Path, levels: int) -> list[Member]:
    """Return a member for each degree and level: each has half the cells and twice the steps.

    Args:
        case: The case; its own elements and number of steps do not matter, but its kind of mesh
            and its scheme do.
        folder: Where the members' case files are written.
        levels: How many there are; one where neither cells nor steps can be chosen.
    """
    base = _base(case)
    sheet = sheet_of(base, MPI.COMM_SELF)
    choosable = has_free_size(base) or (base.needs.history and not has_fixed_steps(base))
    members = []
    for degree in DEGREES:
        for level in range(levels if choosable else 1):
            one = _at_level(base, sheet, degree, level)
            members.append(_member(one, f"P{degree}, level {level + 1}", folder))
    return members


def for_accuracies(case: Case, folder: Path, levels: int) -> list[Member]:
    """Return a member for each of so many accuracies.

    Raises:
        CaseError: None can be asked for, or the force is prescribed: the study compares forces.
    """
    if any(prescribe_forces(case.program)):
        message = "the study of accuracy is not available where a force is prescribed"
        raise CaseError([case.problem("program", message, "Prescribe displacements.")])
    chosen = ["discretisation.degree", "discretisation.mesh_size", "discretisation.corner_size"]
    chosen += ["discretisation.graded", "time.steps_per_cycle", "time.tolerance"]
    if "scheme" not in case.time.model_fields_set:
        chosen.append("time.scheme")
    left_out, base = [f"{key}=null" for key in chosen], _base(case)
    return [
        _member(base, f"accuracy {100 * a:g} %", folder, (*left_out, f"accuracy={a!r}"))
        for a in ACCURACIES[:levels]
    ]


def finer(runs: Sequence[SweepRun], folder: Path) -> tuple[SweepRun, Member] | None:
    """Return the last run that came to its end, and a finer one; None where there is none."""
    ended = [run for run in runs if run.has_results]
    if not ended:
        return None
    resolved = read_case(ended[-1].directory / CASE)
    return ended[-1], _member(finer_case(resolved), "the finer answer", folder)


def finer_case(case: Case) -> Case:
    """Return the case of a run with finer cells of another degree, and with shorter steps.

    Those on which nothing depends, such as of an elastic sheet, stay as they are.
    """
    d, tolerance = case.discretisation, case.time.tolerance
    degree, share = d.degree + 1, FINER
    if d.degree == LARGEST_DEGREE:
        degree, share = d.degree - 1, FINER_BY_FAR
    size = None if d.mesh_size is None else share * d.mesh_size
    better = with_elements(case, degree=degree, mesh_size=size)
    if not depends_on_steps(case):
        return better
    return with_steps(better, SHORTER, None if tolerance is None else tolerance / SHORTER**2)


def _base(case: Case) -> Case:
    """Return the case without an accuracy, of several cycles with the largest."""
    return trial_of(case, 0.0).model_copy(update={"accuracy": None})


def _at_level(base: Case, sheet: Sheet, degree: int, level: int) -> Case:
    finer_by: int = 2**level
    size = shorter_side(sheet) / (COARSEST * finer_by)
    one = with_cells(base, size, degree=degree, corner_size=None)
    if not base.needs.history:
        return one
    one = with_steps(one, FIRST_SHARE * finer_by)
    if base.needs.rate and "scheme" not in base.time.model_fields_set:
        time = one.time.model_copy(update={"scheme": SCHEME})
        one = one.model_copy(update={"time": time})
    return one


def _member(case: Case, label: str, folder: Path, overrides: Sequence[str] = ()) -> Member:
    """Return a member whose case is written into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{label.replace(' ', '')}.yaml"
    path.write_text(case.to_yaml(), encoding="utf-8")
    return Member(label, read_case(path, (*QUIET, *overrides)), Variation())


def true_errors(figures: Mapping[str, Any], exact: Mapping[str, Any]) -> dict[str, float]:
    """Return the relative errors of the figures of a summary, of those that are not nothing.

    Args:
        figures: The summary of a run.
        exact: That of the finer answer.
    """
    nothing = NOTHING * abs(exact["peak_force_N"] * exact["peak_force_at_m"])
    return {f: abs(figures[f] / exact[f] - 1) for f in FIGURES if abs(exact[f]) > nothing}


@dataclass(frozen=True)
class Priced:
    """A run with what it costs and how wrong it is.

    Attributes:
        label: Its name.
        accuracy: That was asked for, or None.
        degree, mesh_size: Its elements, and size of cells, m; None where a file gives them.
        unknowns, steps: Their numbers.
        seconds: Wall time for mesh and steps, on one processor.
        search: That of the search for elements and steps, with compiling; 0 if there was none.
        stated: Largest relative error that it states; None if it states none.
        errors: True relative errors by figure.
        shortfall: Why it says that an accuracy is not reached; empty if it is.
    """

    label: str
    accuracy: float | None
    degree: int
    mesh_size: float | None
    unknowns: int
    steps: int
    seconds: float
    search: float
    stated: float | None
    errors: Mapping[str, float]
    shortfall: str = ""

    @property
    def error(self) -> float:
        """The largest true error."""
        return max(self.errors.values(), default=0.0)

    @staticmethod
    def of(run: SweepRun, exact: Mapping[str, Any]) -> Priced:
        """Return what a run costs, and its errors against the summary of the finer answer."""
        summary, case = read_summary(run.directory), read_case(run.directory / CASE)
        times, said = summary["wall_time_s"], summary.get("accuracy", {})
        known = said.get("figures", {})
        stated = [known[name]["relative_error"] for name in FIGURES if name in known]
        return Priced(
            run.member.label,
            run.member.case.accuracy,
            case.discretisation.degree,
            case.discretisation.mesh_size,
            summary["unknowns"],
            summary["steps"],
            sum(times.get(phase, 0.0) for phase in PHASES),
            times.get(SEARCH, 0.0),
            None if None in stated else max(stated, default=None),
            true_errors(summary, exact),
            said.get("shortfall", ""),
        )


@dataclass(frozen=True)
class Study:
    """All runs that came to their end, and the finer answer.

    Attributes:
        runs: The runs.
        exact: Summary of the finer answer.
        doubt: Largest share by which that can be wrong itself.
    """

    runs: tuple[Priced, ...]
    exact: Mapping[str, Any]
    doubt: float

    @staticmethod
    def of(runs: Sequence[SweepRun], last: SweepRun, finest: SweepRun) -> Study:
        """Return the study of runs, of which ``finest`` refines the ``last``."""
        exact = read_summary(finest.directory)
        priced = tuple(Priced.of(run, exact) for run in runs if run.has_results)
        doubt = DOUBT * Priced.of(last, exact).error
        return Study(priced, exact, doubt)

    @property
    def stating(self) -> list[Priced]:
        """The runs that state an error."""
        return [run for run in self.runs if run.stated is not None]

    @property
    def proven(self) -> list[Priced]:
        """Those whose true error is not larger, whatever the finer answer is wrong by."""
        return [r for r in self.stating if r.error + self.doubt <= (r.stated or 0.0)]

    @property
    def understated(self) -> list[Priced]:
        """Those whose true error is larger, whatever the finer answer is wrong by."""
        return [r for r in self.stating if r.error - self.doubt > (r.stated or 0.0)]

    @property
    def efficient(self) -> list[Priced]:
        """The runs than which none is both faster and more accurate, from fast to accurate."""
        best, found = inf, []
        for run in sorted(self.runs, key=lambda r: (r.seconds, r.error)):
            if run.error < best:
                best = run.error
                found.append(run)
        return found

    def rows(self) -> list[dict[str, Any]]:
        """Return a row for each run in SI units."""
        return [
            {
                "run": r.label,
                "degree": r.degree,
                "mesh_size_m": "" if r.mesh_size is None else r.mesh_size,
                "unknowns": r.unknowns,
                "steps": r.steps,
                "seconds": round(r.seconds, 3),
                "search_s": round(r.search, 3),
                "stated_error": "" if r.stated is None else r.stated,
                "error": r.error,
                **{f"error_of_{f}": r.errors.get(f, "") for f in FIGURES},
                "shortfall": r.shortfall,
            }
            for r in self.runs
        ]

    def proof(self) -> str:
        """Return in words whether the stated errors are true."""
        wrong = ", ".join(r.label for r in self.understated) or "none"
        right = ", ".join(r.label for r in self.proven) or "none"
        answer = ", ".join(
            f"{words} {self.exact[name]:.6g} {name.rpartition('_')[2]}"
            for name, words in FIGURES.items()
            if any(name in r.errors for r in self.runs)
        )
        return (
            f"The finer answer: {answer}, with {self.exact['unknowns']} unknowns and "
            f"{self.exact['steps']} steps, to about {percent(self.doubt)}. "
            f"Of {len(self.stating)} stated errors these are proven to be large enough: {right}; "
            f"these are too small: {wrong}; to judge others it would have to be finer still."
        )

    def table(self) -> str:
        """Return all runs as a table in Markdown."""
        head = ["run", "cells", "unknowns", "steps", "time", "search", "stated error", "error"]
        rows = [
            [
                r.label,
                f"P{r.degree}" + ("" if r.mesh_size is None else f", {1e3 * r.mesh_size:.4g} mm"),
                str(r.unknowns),
                str(r.steps),
                f"{r.seconds:.2g} s",
                f"{r.search:.2g} s" if r.search else "",
                "" if r.stated is None else percent(r.stated),
                percent(r.error) if r.error > self.doubt else f"≤ {percent(r.error + self.doubt)}",
            ]
            for r in self.runs
        ]
        return markdown(head, rows, (0, 1))

    def write(self, directory: Path) -> None:
        """Write the table of all runs as CSV, and with the proof as Markdown."""
        write_csv(directory / TABLE, self.rows())
        text = f"{self.table()}\n\n{self.proof()}\n"
        (directory / ANSWERS).write_text(text, encoding="utf-8")


def percent(share: float) -> str:
    """Return a share in percent, with two digits."""
    return f"{100 * share:.2g} %"
