"""A folder with a case in it, and random values that are the same in every run."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import settings

from tests.case.reading import EXAMPLE, WriteCase

settings.register_profile("fixed", derandomize=True, deadline=None, database=None)
settings.load_profile("fixed")


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
