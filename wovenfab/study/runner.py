"""Runs in processes of their own, and a cache of their results.

Sweeps, studies of accuracy, benchmarks, hard cases and the paper all start processes here. A
result is computed again only where its fingerprint has changed: the case, the files that it
names, or the code that computes.
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import forms
import wovenfab
from wovenfab.case import Case, Rectangle, Table
from wovenfab.parallel import PYTHON_PATHS, child_environment
from wovenfab.record.results import write_whole

#: The parts of wovenfab that compute; those above them only start runs and read results.
COMPUTING = (
    *("parallel", "log", "compat", "case", "sheet"),
    *("model", "solver", "stepping", "record", "simulation"),
)
#: Seconds between two polls of the running processes.
_PAUSE = 0.2
#: Seconds from the request to end to the kill.
_GRACE = 5.0


@dataclass(frozen=True)
class Command:
    """A Python command, run with one thread per rank.

    Attributes:
        arguments: What follows ``python3``.
        ranks: Number of MPI ranks.
        log: File for all output; temporary files if None.
        limit: Time after which it is ended, s.
        environment: More variables.
        folder: Working directory, if another.
    """

    arguments: Sequence[str]
    ranks: int = 1
    log: Path | None = None
    limit: float = inf
    environment: Mapping[str, str] = field(default_factory=dict)
    folder: Path | None = None


@dataclass(frozen=True)
class Ended:
    """How a process ended.

    Attributes:
        code: Exit code; negative for the signal that ended it.
        output: Standard output; with a log, errors too.
        errors: Standard error output.
        seconds: Wall time.
        failure: Why it failed: time limit, signal, or the last line of its output; empty if not.
    """

    code: int
    output: str
    errors: str
    seconds: float
    failure: str = ""

    @property
    def result(self) -> Any:
        """The JSON in the last line of the standard output."""
        return json.loads(self.output.splitlines()[-1])


def _ignore(*_: object) -> None:
    """Do nothing."""


def execute(command: Command, progress: Callable[[float], None] = _ignore) -> Ended:
    """Run a command; report the wall time (s) several times a second.

    Raises:
        KeyboardInterrupt: This process was told to end; the command has been ended, too.
    """
    results: list[Ended] = []
    started = time.monotonic()
    execute_all(
        [command],
        on_end=lambda _, ended: results.append(ended),
        on_wait=lambda: progress(time.monotonic() - started),
    )
    return results[0]


def execute_all(
    commands: Sequence[Command],
    jobs: int = 1,
    on_start: Callable[[int], None] = _ignore,
    on_end: Callable[[int, Ended], None] = _ignore,
    on_wait: Callable[[], None] = _ignore,
) -> None:
    """Run commands in their order, so many at a time.

    ``on_start`` and ``on_end`` get the index of a command; ``on_wait`` is called several times a
    second. Whatever ends this function ends the processes, too, with their children.

    Raises:
        KeyboardInterrupt: This process was told to end.
    """
    waiting = list(range(len(commands)))
    running: dict[int, _Process] = {}
    with _signals() as received:
        try:
            while waiting or running:
                if received:
                    raise KeyboardInterrupt
                while waiting and len(running) < jobs:
                    index = waiting.pop(0)
                    on_start(index)
                    running[index] = _Process(commands[index])
                next(iter(running.values())).wait(_PAUSE)
                on_wait()
                for index, process in list(running.items()):
                    if (ended := process.poll()) is not None:
                        del running[index]
                        on_end(index, ended)
        finally:
            _end(running.values())


class _Process:
    """A running command, the leader of a process group with its compilers or ranks."""

    def __init__(self, command: Command) -> None:
        """Start it."""
        launcher = ["mpirun", "-n", str(command.ranks)] if command.ranks > 1 else []
        environment = child_environment()
        if launcher:  # which needs its variables
            environment = {**os.environ, **{n: environment[n] for n in PYTHON_PATHS}}
        self._folder = TemporaryDirectory()
        self._output = command.log or Path(self._folder.name) / "output"
        self._errors = self._output.with_suffix(".errors")
        self._limit, self._started = command.limit, time.monotonic()
        with ExitStack() as stack:
            output = stack.enter_context(self._output.open("wb"))
            errors = None if command.log else stack.enter_context(self._errors.open("wb"))
            self.process = subprocess.Popen(
                [*launcher, sys.executable, *command.arguments],
                env={"OMP_NUM_THREADS": "1"} | environment | dict(command.environment),
                cwd=command.folder,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=errors or subprocess.STDOUT,
                start_new_session=True,
            )

    def wait(self, seconds: float) -> None:
        """Wait for its end, but no longer than so many seconds."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(seconds)

    def poll(self) -> Ended | None:
        """Return how it ended, or None; end it if its time is over."""
        seconds, limit = time.monotonic() - self._started, self._limit
        if self.process.poll() is None:
            if seconds < limit:
                return None
            _end([self])
            return self._ended(seconds, f"no end within {limit:g} s")
        code = self.process.returncode
        return self._ended(seconds, f"killed by signal {-code}" if code < 0 else "")

    def _ended(self, seconds: float, failure: str) -> Ended:
        code = self.process.wait()
        output, errors = _text(self._output), _text(self._errors)
        self._folder.cleanup()
        if code and not failure:
            lines = [line for line in (errors.strip() or output.strip()).splitlines() if line]
            failure = lines[-1] if lines else f"exit code {code}"
        return Ended(code, output, errors, seconds, failure)


def _text(path: Path) -> str:
    return path.read_text(errors="replace") if path.is_file() else ""


def _end(processes: Iterable[_Process]) -> None:
    """End processes with their children: first by request, then by force."""
    remaining = list(processes)
    for number in (signal.SIGTERM, signal.SIGKILL):
        for one in remaining:
            with suppress(ProcessLookupError):
                os.killpg(one.process.pid, number)
        until = time.monotonic() + _GRACE
        while time.monotonic() < until and any(one.process.poll() is None for one in remaining):
            time.sleep(0.05)


@contextmanager
def _signals() -> Iterator[list[int]]:
    """Yield the signals to end that were received, which do not interrupt what is being done."""
    received: list[int] = []
    ends = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {n: signal.signal(n, lambda number, _: received.append(number)) for n in ends}
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@dataclass(frozen=True)
class Store:
    """Results in a folder, a JSON file each, with the fingerprint of what they depend on.

    Attributes:
        folder: Made with the first result.
    """

    folder: Path

    def load(self, name: str, fingerprint: str | None = None) -> Any | None:
        """Return a result; None where there is none with this fingerprint, or any if None."""
        try:
            content = json.loads((self.folder / f"{name}.json").read_text(encoding="utf-8"))
            matches = fingerprint in (None, content["fingerprint"])
            return content["result"] if matches else None
        except (OSError, ValueError, KeyError, TypeError):  # none, or of another version
            return None

    def save(self, name: str, fingerprint: str, result: Any) -> None:
        """Write a result in place of the one before."""
        self.folder.mkdir(parents=True, exist_ok=True)
        text = json.dumps({"fingerprint": fingerprint, "result": result}, default=dict)
        write_whole(self.folder / f"{name}.json", text + "\n")


def fingerprint(case: Case, *sources: Path) -> str:
    """Return a text that differs if the case, a file it names, or the code that computes does.

    Python files and folders in ``sources`` count, too.
    """
    parts = [case.to_yaml(), *map(_content, _files_of(case)), code(*sources)]
    return _digest("\0".join(parts))


@cache
def code(*sources: Path) -> str:
    """Return a text that differs if the code that computes does, whatever its comments say.

    Python files and folders in ``sources`` count, too.
    """
    top = Path(wovenfab.__file__).parent
    computing = [top / name for name in COMPUTING]
    paths = [Path(forms.__file__).parent, *computing, *(p.with_suffix(".py") for p in computing)]
    files = [p for path in (*paths, *sources) for p in (path, *path.rglob("*.py")) if p.is_file()]
    return _digest("\0".join([*map(_code_of, sorted(files)), _dolfinx()]))


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


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
