"""What a case file names that is executed: known from its text, before anything of it is read."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from pathlib import Path

from wovenfab.case.document import FILE, override, resolved_document
from wovenfab.case.effects import custom_files

#: Suffixes of geometries in gmsh's language.
_GEOMETRIES = (".geo", ".geo_unrolled")


def effect_programs(
    path: Path, overrides: Sequence[str] = (), fabric: Path | None = None
) -> list[str]:
    """Return in words the Python files that run when a case file is read.

    Args:
        path: A case file.
        overrides: Values that replace those of the file, ``"key=value"`` each.
        fabric: A file that is laid over the first one.

    Raises:
        CaseError: A file is no YAML.
    """
    files = custom_files(_data(path, overrides, fabric))
    return [f"the Python file {file} of the effect {key}" for key, file in files.items()]


def geometry_programs(
    path: Path, overrides: Sequence[str] = (), fabric: Path | None = None
) -> list[str]:
    """Return in words the geometries that gmsh runs when the sheet of a case file is made.

    Arguments and errors are those of :func:`effect_programs`.
    """
    data = _data(path, overrides, fabric)
    sheet = data.get("sheet") if isinstance(data, dict) else None
    file = sheet.get(FILE) if isinstance(sheet, dict) else None
    is_program = isinstance(file, str) and Path(file).suffix.lower() in _GEOMETRIES
    return [f"the geometry program {file}"] if is_program else []


def _data(path: Path, overrides: Sequence[str], fabric: Path | None) -> object:
    return reduce(override, overrides, resolved_document(path, fabric)).data
