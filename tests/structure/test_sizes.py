"""Pictures stay small enough for a clone. ``make size`` shows lines, files and imports, too."""

from __future__ import annotations

from tests.structure.sizes import sizes_of_files


def test_pictures_are_no_larger_than_agreed() -> None:
    (pictures,) = (size for size in sizes_of_files() if "pictures" in size.name)
    assert pictures.value <= pictures.most
