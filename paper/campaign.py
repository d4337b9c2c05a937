"""What is run for the paper's figures and claims, and where its results are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from paper.measures import Field, Loop, field_at_largest, loops_of
from wovenfab.case import Case
from wovenfab.record.history import read_history
from wovenfab.record.summary import read_summary
from wovenfab.study.sweep import Member, members_of
from wovenfab.study.variations import read_sweep_file

#: Case files of the curves and fields of Figures 2 to 13.
CASES = (
    "velocity-1x2",
    "velocity-1x3",
    "velocity-1x4",
    "frequency-1x3",
    "soft-1x3",
    "stiff-1x3",
    "spin-velocity-1x3",
    "spin-frequency-1x3",
)
#: Both programs with steeper friction laws, for the text after Figure 5.
STEEP = "steep"
#: An elastic pull with yarns as given, and with yarns that hardly resist bending.
LIMP = "limp"
#: The loops of Figure 3 on other elements, and an elastic pull on finer and finer meshes.
ELEMENTS, CONVERGENCE = "elements", "convergence"
#: What the elements of the campaign itself are called, and those that others are measured by.
JUMPING, REFERENCE = "jumping", "reference"


@dataclass(frozen=True)
class Steeper:
    """Both programs with one slope of the friction law.

    Attributes:
        slope: As it is written in the sweep file.
        velocity: Run at constant maximum velocity.
        frequency: Run at constant frequency.
    """

    slope: str
    velocity: str
    frequency: str


@dataclass(frozen=True)
class Elements:
    """Runs that differ in their elements alone.

    Attributes:
        loops: Runs by the kind of elements and by the run of the campaign that they repeat.
        pulls: Runs of the elastic pull by the kind of elements, the finest last.
    """

    loops: Mapping[str, Mapping[str, str]]
    pulls: Mapping[str, Sequence[str]]


@dataclass(frozen=True)
class Campaign:
    """All runs.

    Attributes:
        members: What is run.
        steep: The runs with steeper friction laws, the steepest last.
        limp: Runs of the elastic pull by how the yarns bend: ``given`` or ``limp``.
        elements: The runs on other elements.
    """

    members: tuple[Member, ...]
    steep: tuple[Steeper, ...]
    limp: Mapping[str, str]
    elements: Elements

    def case(self, run: str) -> Case:
        """Return the case of a run."""
        return next(member.case for member in self.members if member.name == run)


def campaign_of(folder: Path, overrides: Sequence[str] = ()) -> Campaign:
    """Return the campaign of the cases in a folder.

    Args:
        folder: configs/paper, or one with the same files.
        overrides: Values that replace those of all cases.

    Raises:
        CaseError: A case is missing or not valid.
    """
    cases = members_of([folder / f"{name}.yaml" for name in CASES], overrides=overrides)
    steep, limp, loops, pulls = (
        _swept(folder / f"{name}.yaml", overrides) for name in (STEEP, LIMP, ELEMENTS, CONVERGENCE)
    )
    return Campaign(
        (*cases, *steep, *limp, *loops, *pulls),
        _steeper(steep),
        {member.variation.name: member.name for member in limp},
        _elements(loops, pulls),
    )


def _swept(path: Path, overrides: Sequence[str]) -> list[Member]:
    """Return the members of a sweep file, the name of their case in that of each."""
    file = read_sweep_file(path)
    members = members_of(file.cases, file.variations, overrides)
    if len(file.cases) > 1:
        return members
    return [replace(member, label=f"{member.case.name}: {member.label}") for member in members]


def _steeper(members: Sequence[Member]) -> tuple[Steeper, ...]:
    pairs: dict[str, list[str]] = {}
    for member in members:
        (slope,) = member.variation.values.values()
        pairs.setdefault(str(slope), []).append(member.name)
    return tuple(Steeper(slope, *names) for slope, names in pairs.items())


def _elements(loops: Sequence[Member], pulls: Sequence[Member]) -> Elements:
    repeated: dict[str, dict[str, str]] = {JUMPING: {m.case.name: m.case.name for m in loops}}
    for member in loops:
        repeated.setdefault(member.variation.name, {})[member.case.name] = member.name
    pulled: dict[str, list[str]] = {}
    for member in pulls:
        pulled.setdefault(member.variation.name, []).append(member.name)
    return Elements(repeated, pulled)


@dataclass(frozen=True)
class Results:
    """The results of a campaign.

    Attributes:
        directory: Where the sweep put them.
    """

    directory: Path

    def history(self, run: str) -> Mapping[str, Any]:
        """Return the columns of a run's history."""
        return read_history(self.directory / run)

    def summary(self, run: str) -> Mapping[str, Any]:
        """Return the summary of a run."""
        return read_summary(self.directory / run)

    def loops(self, run: str) -> list[Loop]:
        """Return the loop of each cycle."""
        spans = [(cycle["start_s"], cycle["end_s"]) for cycle in self.summary(run)["cycles"]]
        return loops_of(self.history(run), spans)

    def field(self, run: str, name: str) -> Field:
        """Return a field at the largest displacement."""
        return field_at_largest(self.directory / run, name)
