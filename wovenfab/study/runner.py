"""What a run's results depend on, as one short text: equal if and only if they need not change."""

from __future__ import annotations

import ast
import hashlib
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import forms
import wovenfab
from wovenfab.case import Case, Rectangle, Table

#: The parts of wovenfab that compute; those above them only start runs and read results.
COMPUTING = (
    "parallel",
    "compat",
    "case",
    "sheet",
    "model",
    "solver",
    "stepping",
    "record",
    "simulation",
)


def fingerprint(case: Case) -> str:
    """Return a text that differs if the case, a file it names, or the code that computes does."""
    parts = [case.to_yaml(), *map(_content, _files_of(case)), code()]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


@cache
def code() -> str:
    """Return a text that differs if the code that computes does, whatever its comments say."""
    top = Path(wovenfab.__file__).parent
    folders = [Path(forms.__file__).parent, *(top / name for name in COMPUTING)]
    sources = [top / f"{name}.py" for name in COMPUTING]
    sources = [p for p in sources if p.is_file()] + [p for f in folders for p in f.rglob("*.py")]
    text = "\0".join(_meaning(path) for path in sorted(sources))
    return hashlib.sha256(f"{text}\0{_dolfinx()}".encode()).hexdigest()[:16]


def _meaning(path: Path) -> str:
    """Return the code of a file without layout, comments and docstrings."""
    tree = ast.parse(path.read_bytes())
    for node in ast.walk(tree):
        if isinstance(body := getattr(node, "body", None), list):
            body[:] = [statement for statement in body if not _is_text(statement)]
    return ast.dump(tree)


def _is_text(statement: ast.AST) -> bool:
    value = statement.value if isinstance(statement, ast.Expr) else None
    return isinstance(value, ast.Constant) and isinstance(value.value, str)


def _files_of(case: Case) -> list[Path]:
    """Return the files that a case names."""
    named = [e.file for e in case.scene if e.file is not None]
    named += [segment.samples.file for segment in case.program if isinstance(segment, Table)]
    return named if isinstance(case.sheet, Rectangle) else [*named, case.sheet.file]


def _content(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _dolfinx() -> str:
    try:
        return version("fenics-dolfinx")
    except PackageNotFoundError:
        return "unknown"
