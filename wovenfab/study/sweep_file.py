"""Sweep files: the cases and what is varied in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, ValidationError, ValidationInfo

from wovenfab.case import (
    CaseError,
    Document,
    OneOr,
    Section,
    existing_file,
    folder_of,
    problems_in,
    read_document,
)
from wovenfab.study.variation import Variation, axis, grid

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

    over: Mapping[str, list[Any]] = Field(
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
        CaseError: With everything that was found wrong.
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
    return Variation(values, {key: document.places["runs", name, key] for key in values}, name)
