"""The project stays as small as it was made."""

from __future__ import annotations

from tests.structure.sizes import size_of_imports, sizes_of_files


def test_code_tests_and_pictures_are_no_larger_than_agreed() -> None:
    assert [str(size) for size in sizes_of_files() if size.value > size.most] == []


def test_a_plain_run_imports_no_more_modules_than_agreed() -> None:
    size = size_of_imports()
    assert size.value <= size.most, str(size)
