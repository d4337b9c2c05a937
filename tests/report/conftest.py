"""Results directories made from formulas."""

from pathlib import Path

import pytest

from tests.report.sample import make


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three cycles of a sheet with two placements; read only."""
    return make(tmp_path_factory.mktemp("results") / "two")


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """One cycle of a sheet with one placement, for tests that spoil it."""
    return make(tmp_path / "small", amplitudes=[0.03], placements=1, every=40)
