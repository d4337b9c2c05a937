"""What the tests of cases share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from wovenfab.case import Case, CaseError, read_case

WriteCase = Callable[[str], Path]
EXAMPLE = Path(__file__).with_name("example.yaml")


def told(path: Path, overrides: Sequence[str] = ()) -> str:
    """Return all that is said of a case that cannot be used."""
    with pytest.raises(CaseError) as caught:
        read_case(path, overrides)
    return str(caught.value)


def again(case: Case, folder: Path) -> Case:
    """Return a case that was written into a folder, and read."""
    folder.mkdir(exist_ok=True)
    path = folder / f"{case.name}.yaml"
    path.write_text(case.to_yaml(), encoding="utf-8")
    return read_case(path)
