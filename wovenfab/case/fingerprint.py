"""What results depend on: the resolved case, the contents of all files behind it, the code.

There is this one fingerprint. Sweeps, fits and studies compute a result again where it has
changed, and a run goes on only where its part that concerns the physics is the same.
"""

from __future__ import annotations

import ast
import hashlib
import json
import re
from functools import cache
from itertools import chain
from pathlib import Path

import wovenfab
from wovenfab import forms
from wovenfab.case import Case, Rectangle, TableSection
from wovenfab.record.field_file import newest_checkpoint
from wovenfab.record.results import NothingToResumeError
from wovenfab.versions import dolfinx

#: The parts of wovenfab that compute; those above them only start runs and read results.
COMPUTING = (
    *("lacking", "mpi", "versions", "parallel", "plain_text", "compat"),
    *("sheet", "model", "solver", "stepping", "record", "simulation", "case", "measured"),
)
#: What chooses elements and steps for an accuracy.
CHOOSING = "study/errors"
#: Kinds of contents, each with the name that they belong to.
EFFECT, GEOMETRY, TABLE, STATE = "effect", "sheet", "table", "from_state"
#: Statements by which a geometry reads another file, with the quotation mark of a plain name.
_READING = re.compile(r"\b(?:Include|Merge\w*|ShapeFromFile)\b\s*\(?\s*(?P<plain>[\"']?)")
_STRINGS = re.compile(r"\"([^\"\n]*)\"|'([^'\n]*)'")
#: What gmsh reads, besides tables of numbers.
_READABLE = (
    *(".geo", ".msh", ".opt", ".pos", ".pro", ".inc", ".txt", ".csv", ".dat"),
    *(".step", ".stp", ".brep", ".iges", ".igs", ".stl"),
)


def fingerprint(case: Case, *sources: Path) -> str:
    """Return a text that differs if a case, a file behind it, or the code that computes does.

    Python files and folders in ``sources`` count, too.
    """
    if case.accuracy is not None:
        sources = (*sources, Path(wovenfab.__file__).parent / CHOOSING)
    return digest(case.to_yaml(), json.dumps(contents_of(case)), code(*sources))


def contents_of(case: Case) -> dict[str, str]:
    """Return a digest of the contents of all files behind a case, by what they are for.

    Files that a geometry reads count with it, and of the run that a case starts from the state.
    """
    contents = {f"{EFFECT} {e.name}": _content(e.file) for e in case.scene if e.file is not None}
    if not isinstance(case.sheet, Rectangle):
        contents[GEOMETRY] = digest(*map(_content, geometry_files(case.sheet.file)))
    tables = (s for s in chain(*case.programs.values()) if isinstance(s, TableSection))
    contents |= {f"{TABLE} {i}": _content(t.samples.file) for i, t in enumerate(tables)}
    if case.from_state is not None:
        contents[STATE] = _state(case.from_state)
    return contents


def case_files(case: Case) -> list[Path]:
    """Return the files that a case names itself."""
    named = [e.file for e in case.scene if e.file is not None]
    segments = chain(*case.programs.values())
    named += [segment.samples.file for segment in segments if isinstance(segment, TableSection)]
    return named if isinstance(case.sheet, Rectangle) else [*named, case.sheet.file]


def geometry_files(path: Path) -> list[Path]:
    """Return a geometry and the files that it may read, in an order that does not change.

    These are the files that any of its texts names, and theirs. Where it computes the name of a
    file, which only running it can tell, they are all files of its folder that gmsh can read.
    """
    found: dict[Path, None] = {}
    waiting = [path]
    while waiting:
        if (one := waiting.pop().resolve()) in found or not one.is_file():
            continue
        found[one] = None
        if one.suffix.lower() in (".msh", ".step", ".stp"):
            continue
        text = one.read_bytes().decode("latin-1")
        names = {name for pair in _STRINGS.findall(text) for name in pair if name}
        waiting += [one.parent / name for name in names if "\0" not in name and len(name) < 256]
        if any(not reading["plain"] for reading in _READING.finditer(text)):
            waiting += [p for p in one.parent.iterdir() if p.suffix.lower() in _READABLE]
    return [path.resolve(), *sorted(found.keys() - {path.resolve()})]


@cache
def code(*sources: Path) -> str:
    """Return a text that differs if the code that computes does, whatever its comments say.

    Python files and folders in ``sources`` count, too.
    """
    top = Path(wovenfab.__file__).parent
    computing = [top / name for name in COMPUTING]
    paths = [Path(forms.__file__).parent, *computing, *(p.with_suffix(".py") for p in computing)]
    files = [p for path in (*paths, *sources) for p in (path, *path.rglob("*.py")) if p.is_file()]
    return digest(*map(_code_of, sorted(files)), dolfinx())


def digest(*texts: str) -> str:
    """Return a short text that differs if any of the texts does."""
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:16]


def _state(directory: Path) -> str:
    """Return a digest of the newest checkpoint: of its state, sheet and elements."""
    try:
        checkpoint = newest_checkpoint(directory)
    except NothingToResumeError:
        return ""
    known = hashlib.sha256()
    for part in ("case", "stepper"):
        known.update(json.dumps(checkpoint.values[part], sort_keys=True).encode())
    for name in sorted(checkpoint.arrays):
        known.update(name.encode() + checkpoint.arrays[name].tobytes())
    return known.hexdigest()[:16]


def _content(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def _code_of(path: Path) -> str:
    """Return the code of a file without layout, comments and docstrings."""
    tree = ast.parse(path.read_bytes())
    for node in ast.walk(tree):
        if isinstance(body := getattr(node, "body", None), list):
            body[:] = [statement for statement in body if not _is_text(statement)]
    return ast.dump(tree)


def _is_text(statement: ast.AST) -> bool:
    value = statement.value if isinstance(statement, ast.Expr) else None
    return isinstance(value, ast.Constant) and isinstance(value.value, str)
