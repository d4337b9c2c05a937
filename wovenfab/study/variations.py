"""What a sweep varies: values by their keys in a case, from the command line or a sweep file."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import product
from operator import or_
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, ValidationError, ValidationInfo

from wovenfab.case import lists
from wovenfab.case.document import (
    Document,
    SourceLine,
    existing_file,
    folder_of,
    parse_document,
    read_document,
)
from wovenfab.case.errors import OVERRIDE, CaseError, CaseProblem, case_error, problems_in
from wovenfab.case.quantities import OneOr, Section, Several

#: ``Problem.file`` of what the command line varies.
OVER = "--over"


@dataclass(frozen=True)
class Variation:
    """Values that one member of a sweep has in place of those of its case.

    Attributes:
        values: As they are written in a case, by dotted key.
        places: Where each was written.
        name: Its name, if it has one.
        axes: The keys whose values are part of the label.
    """

    values: Mapping[str, Any] = field(default_factory=dict)
    places: Mapping[str, SourceLine] = field(default_factory=dict)
    name: str = ""
    axes: tuple[str, ...] = ()

    def __or__(self, other: Variation) -> Variation:
        """Return both together; values of the other one replace those of this one."""
        return Variation(
            {**self.values, **other.values},
            {**self.places, **other.places},
            "-".join(filter(None, (self.name, other.name))),
            tuple(dict.fromkeys(self.axes + other.axes)),
        )

    def label(self) -> str:
        """Return name and values in a few words."""
        values = (f"{_short(key, self.axes)}={_word(self.values[key])}" for key in self.axes)
        return ", ".join(filter(None, [self.name, *values]))

    def overrides(self) -> tuple[str, ...]:
        """Return the values as :func:`wovenfab.case.read_case` takes them."""
        return tuple(f"{key}={json.dumps(value)}" for key, value in self.values.items())

    def at_source(self, problem: CaseProblem) -> CaseProblem:
        """Return a problem of an overridden value as one of the place where it was written."""
        for key, place in self.places.items():
            if problem.file == OVERRIDE and f"{problem.key}.".startswith(f"{key}."):
                return replace(problem, file=place.file, line=place.line)
        return problem


def grid(axes: Sequence[Sequence[Variation]]) -> list[Variation]:
    """Return every combination of one variation of each axis; a single empty one of none."""
    return [reduce(or_, chosen, Variation()) for chosen in product(*axes)]


def axis(key: str, values: Sequence[Any], place: SourceLine) -> list[Variation]:
    """Return a variation for each value of a key.

    Raises:
        CaseError: There is no value, or only some have units.
    """
    if not values:
        raise case_error(place.file, "no value is given", line=place.line, key=key)
    if problem := lists.mixed(values):
        raise case_error(place.file, *problem, place.line, key)
    return [Variation({key: value}, {key: place}, axes=(key,)) for value in values]


def read_over(text: str) -> list[Variation]:
    """Return the axis of ``key=value,value``, as the command line has it.

    As in a text such as ``20, 40 mm``, a unit that only the last value has serves for all.

    Raises:
        CaseError: The text is something else.
    """
    key, equals, values = (part.strip() for part in text.partition("="))
    if not key or not equals:
        remedy = 'For example --over "effects.bending.stiffness=24 N*m,254 N*m".'
        raise case_error(OVER, f"expected 'key=value,value', got {text!r}", remedy)
    try:
        given = parse_document(f"[{values}]", OVER).data
    except CaseError as error:
        raise CaseError(replace(p, line=None, key=key) for p in error.problems) from error
    return axis(key, lists.with_last_unit(given), SourceLine(OVER, None))


def _short(key: str, keys: Sequence[str]) -> str:
    """Return the last parts of a dotted key, as many as distinguish it from the others."""
    parts = key.split(".")
    for n in range(1, len(parts)):
        end = ".".join(parts[-n:])
        if not any(f".{other}".endswith(f".{end}") for other in keys if other != key):
            return end
    return key


def _word(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


#: Files that a sweep writes beside the folders of its runs, and the end of those of each run.
BESIDE = ("sweep.csv", "overlay.png", "overlay.svg", "comparison.html")
LOG = ".log"
#: Characters of the longest name of a folder, with a margin to what file systems take.
LONGEST = 200
RENAME = "Give it another name, in sweep files under runs."


def folder_of_run(label: str) -> str:
    """Return the label of a run as the name of its folder.

    Raises:
        ValueError: It would be no folder of its own in that of the sweep.
    """
    words = label.replace(": ", "-").replace(" ", "")
    name = re.sub(r"[^\w.,=+-]+", "_", words).strip("_")
    if not name.strip("."):
        raise ValueError(f"{label!r} is no name for a folder")
    if name.startswith("."):
        raise ValueError(f"{label!r} would be a hidden folder")
    if name.casefold() in BESIDE or name.casefold().endswith(LOG):
        raise ValueError(f"{label!r} is the name of a file that the sweep writes")
    if len(name.encode()) > LONGEST:
        raise ValueError(f"{label[:40]!r}... is too long for the name of a folder")
    return name


#: The key that makes a file a sweep file.
CASE = "case"


@dataclass(frozen=True)
class SweepFile:
    """The contents of a sweep file.

    Attributes:
        cases: Case files.
        variations: What each case is run with.
    """

    cases: tuple[Path, ...]
    variations: list[Variation]


def _case_file(value: Any, info: ValidationInfo) -> Path:
    existing_file(value, folder_of(info), (".yaml", ".yml"))
    return folder_of(info) / str(value)


class _Sweep(Section):
    """Runs of a case with other values."""

    case: Annotated[
        tuple[Annotated[Path, BeforeValidator(_case_file)], ...], OneOr(), Field(min_length=1)
    ] = Field(examples=["bias-1x3.yaml"])
    """Case file, relative to this one, or a list of them."""

    over: Mapping[str, Annotated[list[Any], Several()]] = Field(
        default={}, examples=[{"effects.slip_friction.slope": ["70 s/m", "700 s/m"]}]
    )
    """Values of each key; all combinations are run."""

    runs: Mapping[str, Mapping[str, Any]] = Field(
        default={}, examples=[{"soft": {"effects.bending.stiffness": "24 N*m"}}]
    )
    """Values by their keys, for each run that is named."""


def is_sweep_file(path: Path) -> bool:
    """Return whether a file is a sweep file rather than a case.

    Raises:
        CaseError: The file cannot be read.
    """
    data = read_document(path).data
    return isinstance(data, dict) and CASE in data


def read_sweep_file(path: Path) -> SweepFile:
    """Return the contents of a sweep file.

    Raises:
        CaseError: With all mistakes in the file.
    """
    document = read_document(path)
    try:
        sweep = _Sweep.model_validate(document.data, context={"folder": path.parent})
    except ValidationError as error:
        problems = problems_in(error, document, _Sweep.model_json_schema())
        raise CaseError(document.in_order(problems)) from error
    axes = [axis(key, v, document.places["over", key]) for key, v in sweep.over.items()]
    named = [_named(name, values, document) for name, values in sweep.runs.items()]
    return SweepFile(sweep.case, grid([named, *axes] if named else axes))


def _named(name: str, values: Mapping[str, Any], document: Document) -> Variation:
    if not values:
        path = ("runs", name)
        raise CaseError([document.problem(path, "no value is given", "Name what is varied.")])
    try:
        folder_of_run(name)
    except ValueError as error:
        raise CaseError([document.problem(("runs", name), str(error), RENAME)]) from error
    return Variation(values, {key: document.places["runs", name, key] for key in values}, name)
