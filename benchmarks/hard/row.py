"""A hard case: how it is built, what is measured, and which figures pass."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite
from pathlib import Path
from typing import Any

from wovenfab.case import Case, read_case
from wovenfab.record.results import Provenance
from wovenfab.solver.equilibrium import EquilibriumSolver

CONFIGS = Path(__file__).parents[2] / "configs"


@dataclass(frozen=True)
class Setting:
    """A case, built as a user builds one.

    Attributes:
        base: Name of a case in configs/.
        overrides: What ``--set`` would change.
        solver: The solver; only tests and comparisons give another one.
    """

    base: str
    overrides: tuple[str, ...] = ()
    solver: type[EquilibriumSolver] = EquilibriumSolver

    def but(self, *overrides: str) -> Setting:
        """Return the setting with more changes."""
        return replace(self, overrides=(*self.overrides, *overrides))

    @property
    def path(self) -> Path:
        """The case file."""
        return CONFIGS / f"{self.base}.yaml"

    @property
    def case(self) -> Case:
        """The case, read and validated."""
        return read_case(self.path, self.overrides)


@dataclass(frozen=True)
class Figures:
    """What a hard case gave.

    Attributes:
        unknowns, steps, worst, cutbacks: Counts; ``worst`` is of Newton's iterations in a step.
        mean: Mean iterations of a step.
        margin: Smallest (f_1 × f_2)/(|f_1||f_2|) of all iterates, at all quadrature points
            of cells and facets; None where there are none.
        imbalance: Largest energy imbalance over the largest work; None where none is summed.
        end: ``"finished"``, or the diagnosis.
        checks: Further figures by what they are.
        series: Numbers for the pictures.
    """

    unknowns: int
    steps: int
    mean: float
    worst: int
    cutbacks: int
    margin: float | None
    imbalance: float | None
    end: str = "finished"
    checks: Mapping[str, float] = field(default_factory=dict)
    series: Mapping[str, Any] = field(default_factory=dict)

    def with_checks(self, **checks: float) -> Figures:
        """Return these figures with more checks; an underscore stands for a blank."""
        more = {name.replace("_", " "): value for name, value in checks.items()}
        return replace(self, checks={**self.checks, **more})

    def figure(self, name: str) -> float:
        """Return a figure by its name; not a number where there is none."""
        value = self.checks.get(name, getattr(self, name, None))
        return float("nan") if value is None else float(value)


def together(parts: Sequence[Figures], series: Mapping[str, Any]) -> Figures:
    """Return the figures of several runs as one: the worst of them, with other series."""
    margins = [f.margin for f in parts if f.margin is not None]
    balances = [f.imbalance for f in parts if f.imbalance is not None]
    steps = sum(f.steps for f in parts)
    return Figures(
        unknowns=max(f.unknowns for f in parts),
        steps=steps,
        mean=sum(f.mean * f.steps for f in parts) / max(steps, 1),
        worst=max(f.worst for f in parts),
        cutbacks=sum(f.cutbacks for f in parts),
        margin=min(margins, default=None),
        imbalance=max(balances, default=None),
        end=next((f.end for f in parts if f.end != "finished"), "finished"),
        series=series,
    )


@dataclass(frozen=True)
class Bound:
    """A threshold.

    Attributes:
        figure: ``worst``, ``cutbacks``, ``margin``, … or the name of a check.
        most, least: What it may be; None for no bound.
    """

    figure: str
    most: float | None = None
    least: float | None = None

    def problem(self, figures: Figures) -> str:
        """Return in words how the figure misses the bound; empty if it does not."""
        value = figures.figure(self.figure)
        if not isfinite(value):
            return f"{self.figure} is not a number"
        if self.most is not None and value > self.most:
            return f"{self.figure} {value:.3g} > {self.most:.3g}"
        if self.least is not None and value < self.least:
            return f"{self.figure} {value:.3g} < {self.least:.3g}"
        return ""


@dataclass(frozen=True)
class Picture:
    """A picture that is to be drawn.

    Attributes:
        path: Its file.
        origin: What made the figures; it is written into the file.
    """

    path: Path
    origin: Provenance


Measure = Callable[[Setting], Figures]


@dataclass(frozen=True)
class Row:
    """A hard case.

    Attributes:
        name: For the command line.
        title: What it is, in a few words.
        hard: What makes it hard.
        remedy: What the solver does about it.
        setting: The case.
        measure: Runs it; on all ranks.
        bounds: What its figures must keep.
        quick: Changes that make it small enough for the tests.
        quick_bounds: Bounds of the quick version in place of those of the same figure.
        stops: A part of the diagnosis with which it must stop; None if it must finish.
        ranks: MPI ranks.
    """

    name: str
    title: str
    hard: str
    remedy: str
    setting: Setting
    measure: Measure
    bounds: tuple[Bound, ...]
    quick: tuple[str, ...] = ()
    quick_bounds: tuple[Bound, ...] = ()
    stops: str | None = None
    ranks: int = 1

    def small(self) -> Row:
        """Return the quick version."""
        new = {bound.figure for bound in self.quick_bounds}
        others = tuple(bound for bound in self.bounds if bound.figure not in new)
        return replace(
            self, setting=self.setting.but(*self.quick), bounds=(*others, *self.quick_bounds)
        )

    def with_solver(self, solver: type[EquilibriumSolver]) -> Row:
        """Return the row with another solver."""
        return replace(self, setting=replace(self.setting, solver=solver))

    def run(self) -> Figures:
        """Measure; collective."""
        return self.measure(self.setting)


@dataclass(frozen=True)
class Family:
    """Hard cases of one kind, with their picture.

    Attributes:
        number: Its place on the page.
        title: Heading.
        text: The question and its answer, in Markdown.
        rows: The cases.
        draw: Draws the picture of the figures by row.
    """

    number: int
    title: str
    text: str
    rows: tuple[Row, ...]
    draw: Callable[[Mapping[str, Figures], Picture], None]


def problems(row: Row, figures: Figures) -> list[str]:
    """Return what keeps a row from passing; empty if nothing does."""
    missed = []
    if row.stops is None and figures.end != "finished":
        missed.append(f"stopped: {figures.end}")
    if row.stops is not None and row.stops not in figures.end:
        missed.append(
            "finished, but should have stopped"
            if figures.end == "finished"
            else f"stopped, but for another reason: {figures.end}"
        )
    return missed + [text for bound in row.bounds if (text := bound.problem(figures))]


def is_good(row: Row, figures: Figures | None) -> bool:
    """Return whether a row passes, or stops where and as it should."""
    return figures is not None and not problems(row, figures)


def verdict(row: Row, figures: Figures | None, failure: str = "") -> str:
    """Return the verdict in words.

    Args:
        row: The case.
        figures: What it gave, or None where it gave nothing.
        failure: Why it gave nothing.
    """
    if figures is None:
        return f"**failed**: {failure}"
    if missed := problems(row, figures):
        return "**failed**: " + "; ".join(missed)
    shown = [
        f"{bound.figure} {figures.figure(bound.figure):.2g}"
        for bound in row.bounds
        if bound.figure in figures.checks
    ]
    said = "passed" if row.stops is None else "stopped with a diagnosis"
    return f"{said}: {', '.join(shown)}" if shown else said
