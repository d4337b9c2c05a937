"""How large the code is, by layer: ``make size``. It reports and judges nothing.

Lines of code are those of the syntax tree without docstrings: neither comments nor blank lines.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable
from dataclasses import astuple, dataclass, fields
from pathlib import Path

ROOT = Path(__file__).parents[1]
#: What an expert reads: the library below the case.
CORE = ("forms", "sheet", "model", "solver", "stepping", "record", "simulation")


@dataclass(frozen=True)
class Size:
    """What some files have.

    Attributes:
        files: Number of files.
        lines: Lines of code.
        functions: Functions and methods.
        constants: Numbers other than 0, 1, -1 and 2 that are written in the code.
        names: Public names: functions and classes of modules without an underscore.
    """

    files: int = 0
    lines: int = 0
    functions: int = 0
    constants: int = 0
    names: int = 0

    def __add__(self, other: Size) -> Size:
        """Return the size of both."""
        return Size(*map(sum, zip(astuple(self), astuple(other), strict=True)))

    def __str__(self) -> str:
        """Return the columns of the table."""
        return "".join(f"{value:11,}" for value in astuple(self))


def size_of(path: Path) -> Size:
    """Return the size of a file."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    nodes = list(ast.walk(tree))
    owners = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    texts = {n.body[0] for n in nodes if isinstance(n, owners) and ast.get_docstring(n) is not None}
    without = {id(inner) for text in texts for inner in ast.walk(text)}
    kept = [n for n in nodes if id(n) not in without]
    lines = {n.lineno for n in kept if hasattr(n, "lineno")}
    lines |= {n.end_lineno for n in kept if isinstance(n, ast.expr | ast.stmt) and n.end_lineno}
    functions = [n for n in nodes if isinstance(n, ast.FunctionDef)]
    numbers = [n for n in nodes if isinstance(n, ast.Constant) and type(n.value) in (int, float)]
    public = [n for n in tree.body if isinstance(n, ast.FunctionDef | ast.ClassDef)]
    return Size(
        1,
        len(lines),
        len(functions),
        sum(n.value not in (0, 1, 2) for n in numbers),
        sum(not n.name.startswith("_") for n in public),
    )


def total(paths: Iterable[Path]) -> Size:
    """Return the size of files together."""
    return sum(map(size_of, paths), Size())


def main() -> None:
    """Print the table."""
    package = {"": sorted((ROOT / "wovenfab").glob("*.py"))}
    package |= {"forms": sorted((ROOT / "forms").glob("*.py"))}
    for path in sorted((ROOT / "wovenfab").glob("*/")):
        if path.is_dir() and not path.is_symlink() and path.name != "__pycache__":
            package[path.name] = sorted(path.rglob("*.py"))
    sizes = {name: total(paths) for name, paths in package.items()}
    print(f"{'':20}" + "".join(f"{field.name:>11}" for field in fields(Size)))
    for name in (*CORE, *(n for n in sizes if n not in CORE)):
        print(f"{name or 'wovenfab/*.py':20}{sizes[name]}")
    print(f"{'the library':20}{sum((sizes[n] for n in CORE), Size())}")
    print(f"{'all installed':20}{sum(sizes.values(), Size())}")
    print(f"{'tests':20}{total((ROOT / 'tests').rglob('*.py'))}")


if __name__ == "__main__":
    main()
