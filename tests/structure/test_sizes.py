"""The project stays as small as it was made. ``make size`` shows the lines, too."""

from __future__ import annotations

from tests.structure.sizes import Size, size_of_imports, sizes_of_files

#: Numbers of lines that are a goal, not yet a bound.
GOALS = (
    "lines installed (forms, wovenfab)",
    "files installed",
    "lines of the longest file installed",
    "lines of tests",
)


def too_large(sizes: list[Size]) -> list[str]:
    return [str(size) for size in sizes if size.value > size.most]


def test_pictures_are_no_larger_than_agreed() -> None:
    counted = [size for size in sizes_of_files() if size.name not in GOALS]
    assert len(counted) == 1 and too_large(counted) == []


def test_a_plain_run_imports_no_more_files_than_agreed() -> None:
    assert too_large([size_of_imports()]) == []
