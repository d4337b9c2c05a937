"""The members of a sweep: cases with their variations, each under a name of its own."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from wovenfab.case import Case, CaseError, Cycles, Rectangle, Segment, Table, read_case, refusal
from wovenfab.study.variations import OVER, Variation


@dataclass(frozen=True)
class Member:
    """One run of a sweep.

    Attributes:
        label: What it is called.
        path: The case file.
        overrides: What replaces values of the file, as for :func:`wovenfab.case.read_case`.
        case: The case that follows.
        variation: What is varied, with this member's values.
    """

    label: str
    path: Path
    overrides: tuple[str, ...]
    case: Case
    variation: Variation

    @property
    def name(self) -> str:
        """The label as the name of a folder, unique in a sweep."""
        words = self.label.replace(": ", "-").replace(" ", "")
        return re.sub(r"[^\w.,=+-]+", "_", words).strip("_")

    @property
    def steps(self) -> int:
        """Number of load steps that are planned."""
        return sum(_steps(segment, self.case) for segment in self.case.program)

    @property
    def weight(self) -> float:
        """How much work it is compared with other members, roughly."""
        sheet, elements = self.case.sheet, self.case.discretisation
        if isinstance(sheet, Rectangle) and elements.mesh_size:
            cells = sheet.length * sheet.width / elements.mesh_size**2
            return self.steps * cells * elements.degree**3
        return self.steps * 1e3 * elements.degree**3


def members_of(
    paths: Sequence[Path],
    variations: Sequence[Variation] = (Variation(),),
    overrides: Sequence[str] = (),
) -> list[Member]:
    """Return a member for each case file with each of the variations.

    Args:
        paths: Case files.
        variations: What is varied.
        overrides: Values that replace those of all files.

    Raises:
        CaseError: A case is not valid with some of the values, or two members are alike.
    """
    found = [_member(path, variation, overrides) for path in paths for variation in variations]
    if len({member.path for member in found}) > 1:
        found = [replace(m, label=": ".join(filter(None, (m.case.name, m.label)))) for m in found]
    found = [replace(m, label=m.label or m.case.name) for m in found]
    for name, times in Counter(member.name for member in found).items():
        if times > 1:
            remedy = "Give each case and each value once."
            raise refusal(OVER, f"{times} runs would be called '{name}'", remedy)
    return found


def _member(path: Path, variation: Variation, overrides: Sequence[str]) -> Member:
    every = (*overrides, *variation.overrides())
    try:
        case = read_case(path, every)
    except CaseError as error:
        raise CaseError(map(variation.at_home, error.problems)) from error
    return Member(variation.label(), path, every, case, variation)


def _steps(segment: Segment, case: Case) -> int:
    match segment:
        case Cycles(amplitudes=amplitudes):
            return len(amplitudes) * case.time.steps_per_cycle
        case Table(samples=samples):
            return len(samples.times) - (samples.times[0] == 0)
    return segment.steps
