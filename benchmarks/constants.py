"""``python -m benchmarks.constants [FILE[:NAME]...]``: which test fails when a constant is changed.

First the tests run once, and each tells which functions of the package it enters. Then each named
number of a module (``NAME = 0.1``, ``A, B = 3, 1e-6``) is changed in a copy of the project, and the
tests run that enter a function in which it is used, the quickest first, until one fails. The values
are ten times as large and a tenth, of a tolerance half and twice the power of ten; then values with
which it is as good as absent. A constant that may be all of these has no reason that a test knows:
it is to be taken away, or to be tested. Two copies work at once.
"""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Generator, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from types import CodeType
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
#: Layers whose constants decide on results; those of the others are widths, colours, and words.
LAYERS = ("forms", *(f"wovenfab/{n}" for n in ("sheet", "model", "solver", "stepping", "study")))
FACTOR, COPIES = 10, 2
#: A tolerance, or what stands for infinity, is a number beyond these.
SMALL, LARGE = 1e-3, 1e4
#: Values that hold what a file format or a program lays down.
TABLES = ast.Dict, ast.Set
#: Seconds of tests for one value, by the times of the first run; after forty times that it hangs.
ENOUGH = 15.0
#: Variable of the environment with the folder into which each process writes what tests enter.
FOLDER = "WOVENFAB_TESTS_ENTER"
CHOSEN = ("-q", "-m", "not mpi and not slow", "-p", "no:cacheprovider")

#: A function: its file, from the root of the project, and its qualified name.
Function = tuple[str, str]
#: Tests by the function that they enter, and the seconds that each test takes.
Entered = tuple[Mapping[Function, set[str]], Mapping[str, float]]


class Monitor:
    """A plugin of pytest that notes which functions of the package each test enters."""

    def __init__(self) -> None:
        """Begin to listen."""
        self._functions: set[Function] = set()
        self._tests: dict[str, tuple[float, list[Function]]] = {}
        sys.monitoring.use_tool_id(sys.monitoring.PROFILER_ID, "tests")
        start = sys.monitoring.events.PY_START
        sys.monitoring.register_callback(sys.monitoring.PROFILER_ID, start, self._entered)
        sys.monitoring.set_events(sys.monitoring.PROFILER_ID, start)

    def _entered(self, code: CodeType, _: int) -> Any:
        path = Path(code.co_filename).resolve()
        if path.is_relative_to(ROOT):
            self._functions.add((str(path.relative_to(ROOT)), code.co_qualname))
        return sys.monitoring.DISABLE  # until the next test

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        """Note what one test enters, with what it is the first to set up."""
        self._functions.clear()
        sys.monitoring.restart_events()
        start = time.perf_counter()
        done = yield
        took = time.perf_counter() - start
        self._tests[item.nodeid] = took, sorted(self._functions)
        return done

    def pytest_sessionfinish(self) -> None:
        """End to listen, and write it into a file of this process."""
        sys.monitoring.set_events(sys.monitoring.PROFILER_ID, sys.monitoring.events.NO_EVENTS)
        file = Path(os.environ[FOLDER], f"{os.getpid()}.json")
        file.write_text(json.dumps(self._tests), encoding="utf-8")


def pytest_configure(config: pytest.Config) -> None:
    """Monitor the tests of this process, where this module is a plugin."""
    config.pluginmanager.register(Monitor())


def tests_entering() -> Entered:
    """Run all tests; return those that enter each function, and their times."""
    with tempfile.TemporaryDirectory() as folder:
        plugins = ("-p", __spec__.name, "-n", str(COPIES), "--dist", "loadfile")
        command = [sys.executable, "-m", "pytest", *CHOSEN, *plugins]
        subprocess.run(command, cwd=ROOT, env=os.environ | {FOLDER: folder}, check=True)
        entering, times = defaultdict(set), {}
        for file in Path(folder).iterdir():
            for test, (took, functions) in json.loads(file.read_text(encoding="utf-8")).items():
                times[test] = took
                for path, name in functions:
                    entering[path, name].add(test)
    return entering, times


@dataclass(frozen=True)
class Constant:
    """A named number.

    Attributes:
        module: Its file, from the root of the project.
        name: Its name.
        value: Its number.
        line, start, end: Where it is written: line, first and last column, from 0.
    """

    module: Path
    name: str
    value: float
    line: int
    start: int
    end: int

    def changed(self) -> tuple[float, ...]:
        """Return the values to try; a count is at least one."""
        larger, smaller = self.value * FACTOR, self.value / FACTOR
        if isinstance(self.value, int):
            return larger, max(1, self.value // FACTOR), FACTOR**2 * larger
        if self.value > LARGE:
            return self.value**0.5, self.value**2, 1.0
        if self.value < SMALL:
            return self.value**0.5, self.value**2, 0.1, 0.0
        return larger, smaller, FACTOR**4 * larger, 0.0

    def text_with(self, text: str, value: float) -> str:
        """Return the text of the module with another number in its place."""
        lines = text.splitlines(keepends=True)
        line = lines[self.line]
        lines[self.line] = f"{line[: self.start]}{value!r}{line[self.end :]}"
        return "".join(lines)


def constants(module: Path) -> Iterator[Constant]:
    """Yield the named numbers of a module, but for one, zero, tables and hints."""
    pairs: list[tuple[ast.expr, ast.expr]]
    for node in ast.parse((ROOT / module).read_text(encoding="utf-8")).body:
        match node:
            case ast.Assign(targets=[ast.Tuple(names)], value=ast.Tuple(values)):
                pairs = list(zip(names, values, strict=True))
            case ast.Assign(targets=[target], value=right):
                pairs = [(target, right)]
            case ast.AnnAssign(target=target, value=ast.expr() as right):
                pairs = [(target, right)]
            case _:
                continue
        for name, value in pairs:
            hints = [n for n in ast.walk(value) if isinstance(n, ast.keyword) and n.arg == "usual"]
            left_out = {id(n) for hint in hints for n in ast.walk(hint)}
            numbers = [
                n for n in ast.walk(value) if isinstance(n, ast.Constant) and id(n) not in left_out
            ]
            if isinstance(name, ast.Name) and name.id.isupper() and not isinstance(value, TABLES):
                for n in numbers:
                    if type(n.value) in (int, float) and n.value not in (0, 1):
                        assert n.end_col_offset is not None
                        where = n.lineno - 1, n.col_offset, n.end_col_offset
                        yield Constant(module, name.id, n.value, *where)


def functions_with(name: str, module: Path) -> set[Function]:
    """Return the functions that use a name of a module; all of a module that uses it outside."""
    dotted = ".".join(module.with_suffix("").parts)
    found = set()
    for layer in ("forms", "wovenfab"):
        for file in (ROOT / layer).rglob("*.py"):
            text = file.read_text(encoding="utf-8")
            if name not in text or file.is_symlink():
                continue
            path = file.relative_to(ROOT)
            tree = ast.parse(text)
            own = path == module or any(
                isinstance(n, ast.ImportFrom)
                and (n.module or "").removeprefix("wovenfab.") == dotted.removeprefix("wovenfab.")
                and any(alias.name == name for alias in n.names)
                for n in ast.walk(tree)
            )
            for where, node in _inside(tree, ""):
                if not isinstance(getattr(node, "ctx", None), ast.Load):
                    continue
                if (isinstance(node, ast.Name) and own and node.id == name) or (
                    isinstance(node, ast.Attribute)
                    and node.attr == name
                    and isinstance(node.value, ast.Name)
                    and node.value.id == module.stem
                ):
                    found.add((str(path), where))
    return found or {(str(module), "")}


def _inside(node: ast.AST, where: str) -> Iterator[tuple[str, ast.AST]]:
    """Yield each node below one, with the qualified name of its function or class."""
    for child in ast.iter_child_nodes(node):
        yield where, child
        inner = where
        if isinstance(child, ast.FunctionDef):
            inner = f"{where}{child.name}.<locals>."
        elif isinstance(child, ast.ClassDef):
            inner = f"{where}{child.name}."
        yield from _inside(child, inner)


def tests_of(constant: Constant, entered: Entered) -> list[str]:
    """Return the tests that use a constant, the quickest first, of some seconds together."""
    entering, times = entered
    tests: set[str] = set()
    for path, where in functions_with(constant.name, constant.module):
        name = where.removesuffix(".<locals>.")
        for (file, function), those in entering.items():
            inside = function == name or not where.endswith(".<locals>.")
            if file == path and inside:
                tests |= those
    chosen: list[str] = []
    together = 0.0
    for test in sorted(tests, key=lambda t: times[t]):
        together += times[test]
        if chosen and together > ENOUGH:
            break
        chosen.append(test)
    return chosen


def failure(copy: Path, tests: Iterable[str]) -> str:
    """Run tests in a copy; return the first that fails, or nothing."""
    away = {name: os.environ.get(name, "") for name in ("PATH", "PYTHONPATH")}
    moved = {name: value.replace(str(ROOT), str(copy)) for name, value in away.items()}
    command = [sys.executable, "-m", "pytest", *CHOSEN, "-x", "--no-header", *tests]
    try:
        done = subprocess.run(
            command,
            cwd=copy,
            env=os.environ | moved,
            capture_output=True,
            text=True,
            check=False,
            timeout=40 * ENOUGH,
        )
    except subprocess.TimeoutExpired:
        return f"no end within {40 * ENOUGH:.0f} s"
    if not done.returncode:
        return ""
    found = re.search(r"^(?:FAILED|ERROR) (.*?)(?: - .*)?$", done.stdout, re.MULTILINE)
    return found[1] if found else f"exit code {done.returncode}"


def try_out(constant: Constant, copy: Path, tests: list[str]) -> dict[float, str]:
    """Return the values tried and the test that fails, in a copy that is restored."""
    module = copy / constant.module
    text = module.read_text(encoding="utf-8")
    found: dict[float, str] = {}
    for value in constant.changed() if tests else ():
        if value != constant.value and not any(found.values()):
            module.write_text(constant.text_with(text, value), encoding="utf-8")
            found[value] = failure(copy, tests)
    module.write_text(text, encoding="utf-8")
    failed = [test for test in found.values() if "::" in test]
    if failed and failure(copy, failed):
        print(f"{failed[0]} fails in a copy of the code as it is, and does not count")
        return dict.fromkeys(found, "")
    return found


def main(chosen: list[Constant]) -> None:
    """Change each constant; print the tests that fail, and how many constants have none."""
    entered = tests_entering()
    copies: SimpleQueue[Path] = SimpleQueue()
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(COPIES) as pool:
        for number in range(COPIES):
            copy = Path(folder, str(number))
            left_out = shutil.ignore_patterns(".git", "build", "results", "__pycache__")
            shutil.copytree(ROOT, copy, symlinks=True, ignore=left_out)
            copies.put(copy)

        def run(constant: Constant) -> tuple[int, dict[float, str]]:
            copy, tests = copies.get(), tests_of(constant, entered)
            try:
                return len(tests), try_out(constant, copy, tests)
            finally:
                copies.put(copy)

        without = 0
        for constant, (number, found) in zip(chosen, pool.map(run, chosen), strict=True):
            without += not any(found.values())
            print(f"{constant.module}: {constant.name}, {constant.value!r}: {number} tests")
            for value, test in found.items():
                print(f"    {value!r}: {test or 'none fails'}", flush=True)
    print(f"{len(chosen)} constants, {without} without a test that fails")


def wanted(given: list[str]) -> list[Constant]:
    """Return the constants of the files, and of the names in files, that are given."""
    files = [f.relative_to(ROOT) for layer in LAYERS for f in sorted((ROOT / layer).rglob("*.py"))]
    pairs = [text.partition(":")[::2] for text in given or map(str, files)]
    return [c for file, name in pairs for c in constants(Path(file)) if name in ("", c.name)]


if __name__ == "__main__":
    main(wanted(sys.argv[1:]))
