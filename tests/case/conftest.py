"""A folder with a case in it, and random values that are the same in every run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings

EXAMPLE = Path(__file__).with_name("example.yaml")

settings.register_profile("fixed", derandomize=True, deadline=None, database=None)
settings.load_profile("fixed")

WriteCase = Callable[[str], Path]


@pytest.fixture
def example() -> str:
    """Return the text of a good case."""
    return EXAMPLE.read_text(encoding="utf-8")


@pytest.fixture
def write_case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> WriteCase:
    """Return a function that writes case.yaml in the current folder, a fresh one."""
    monkeypatch.chdir(tmp_path)

    def write(text: str) -> Path:
        path = Path("case.yaml")
        path.write_text(text, encoding="utf-8")
        return path

    return write
