"""Runs in processes of their own, and a cache of their results.

Sweeps, studies of accuracy, benchmarks, hard cases and the paper all start processes here. A
result is computed again only where its fingerprint has changed (``record/fingerprint.py``).
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event
from typing import Any

from wovenfab.mpi import on_ranks
from wovenfab.parallel import PYTHON_PATHS, child_environment, ending_with_parent
from wovenfab.record.results import (
    INPUT,
    INTERRUPTED,
    fingerprint_of,
    has_checkpoint,
    is_in_use,
    outcome_of,
    write_whole,
)

#: Seconds between two looks at the running processes.
_PAUSE = 0.2
#: Seconds from the request to end to the kill.
_GRACE = 5.0
#: Frame of what the launcher of MPI says beside the output of its processes.
_RULE = re.compile(r"^-{20,}$", re.MULTILINE)
#: Seconds to wait for a run of which another process is being told to end.
_HANDOVER = 60.0


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
        results: Results directory of a ``wovenfab run``, which goes on with a run of the same
            fingerprint that was stopped there, and replaces any other.
        files: Contents of files by their names, to be laid into the working directory.
        elsewhere: The command for machines that do not see the files of this one: all paths are
            relative to its working directory, which is made for it.
    """

    arguments: Sequence[str]
    ranks: int = 1
    log: Path | None = None
    limit: float = inf
    environment: Mapping[str, str] = field(default_factory=dict)
    folder: Path | None = None
    results: Path | None = None
    files: Mapping[str, bytes] = field(default_factory=dict)
    elsewhere: Command | None = None


@dataclass(frozen=True)
class Ended:
    """How a process ended.

    Attributes:
        code: Exit code; negative for the signal that ended it.
        output: Standard output; with a log, errors too.
        errors: Standard error output.
        seconds: Wall time.
        failure: Why it failed: time limit, signal, or the last line of its output; empty if not.
        files: What a command has written that was run elsewhere, by relative names.
    """

    code: int
    output: str
    errors: str
    seconds: float
    failure: str = ""
    files: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def result(self) -> Any:
        """The JSON in the last line of the standard output."""
        return json.loads(self.output.splitlines()[-1])


def run_command(command: Command, stopped: Callable[[], bool] = lambda: False) -> Ended:
    """Run a command and wait for its end; this thread must outlive it.

    Args:
        command: The command.
        stopped: Asked several times a second whether it must end, with its children.
    """
    with TemporaryDirectory() as own:
        folder = command.folder or (Path(own) if command.files else Path())
        for name, content in command.files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        log = folder / command.log if command.log else None
        output, errors = log or Path(own, "output"), Path(own, "errors")
        more: list[str] = []
        if command.results is not None:
            _await(folder / command.results, stopped)
            more = ["--resume" if goes_on(command, folder) else "--overwrite"]
        started = time.monotonic()
        with output.open("wb") as out, errors.open("wb") as err:
            process = subprocess.Popen(
                ending_with_parent(
                    [*on_ranks(command.ranks), sys.executable, *command.arguments, *more]
                ),
                env=_environment(command),
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT if log else err,
                start_new_session=True,
            )
        late = False
        while process.poll() is None and not late:
            with suppress(subprocess.TimeoutExpired):
                process.wait(_PAUSE)
            late = time.monotonic() - started > command.limit
            if late or stopped():
                _end(process)
        code, texts = process.wait(), (_text(output), _text(errors))
        failure = f"no end within {command.limit:g} s" if late else _failure(code, *texts)
        return Ended(code, *texts, time.monotonic() - started, failure)


def _environment(command: Command) -> dict[str, str]:
    environment = child_environment()
    if command.ranks > 1:  # mpirun needs its variables, and stays on this machine
        kept = {n: v for n, v in os.environ.items() if not n.startswith("SLURM_")}
        environment = {**kept, **{n: environment[n] for n in PYTHON_PATHS}}
    return {"OMP_NUM_THREADS": "1"} | environment | dict(command.environment)


def _await(results: Path, stopped: Callable[[], bool]) -> None:
    """Wait until nobody writes into a results directory any more."""
    until = time.monotonic() + _HANDOVER
    while is_in_use(results) and time.monotonic() < until and not stopped():
        time.sleep(_PAUSE)


def goes_on(command: Command, folder: Path = Path()) -> bool:
    """Return whether a run of a command has been stopped and can go on.

    Args:
        command: The command, which has results.
        folder: Working directory.
    """
    results = folder / (command.results or "")
    outcome = outcome_of(results) or INTERRUPTED
    stopped = outcome.startswith(INTERRUPTED) and has_checkpoint(results)
    return stopped and fingerprint_of(results) == command.environment.get(INPUT)


def _text(path: Path) -> str:
    return path.read_text(errors="replace") if path.is_file() else ""


def _failure(code: int, output: str, errors: str) -> str:
    if code <= 0:
        return f"killed by signal {-code}" if code else ""
    parts = _RULE.split(errors.strip() or output.strip())
    lines = [line for part in parts[::2] for line in part.splitlines() if line.strip()]
    if lines:
        return lines[-1]
    first_paragraph = "".join(parts[1:2]).strip().split("\n\n")[0]
    return " ".join(first_paragraph.split()) or f"exit code {code}"


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a process with its children: first by request, then by force."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        with suppress(ProcessLookupError):
            os.killpg(process.pid, number)
        with suppress(subprocess.TimeoutExpired):
            process.wait(_GRACE)


#: Begins to run a command, and returns how it ends.
Submit = Callable[[Command], "Future[Ended]"]


@contextmanager
def here(jobs: int) -> Iterator[Submit]:
    """Yield what runs commands on this machine, so many at a time; at the end none is left."""
    leaving = Event()
    with ThreadPoolExecutor(jobs) as pool:
        try:
            yield lambda command: pool.submit(run_command, command, leaving.is_set)
        finally:
            leaving.set()
            pool.shutdown(cancel_futures=True)


def execute(command: Command, progress: Callable[[float], None] = lambda _: None) -> Ended:
    """Run a command; report the wall time (s) several times a second.

    Raises:
        KeyboardInterrupt: This process was told to end; the command has been ended, too.
    """
    results: list[Ended] = []
    started = time.monotonic()
    execute_all(
        [command],
        here(1),
        on_end=lambda _, ended: results.append(ended),
        on_wait=lambda: progress(time.monotonic() - started),
    )
    return results[0]


def execute_all(
    commands: Sequence[Command],
    place: AbstractContextManager[Submit],
    on_end: Callable[[int, Ended], None],
    on_wait: Callable[[], None] = lambda: None,
) -> None:
    """Run commands, begun in their order.

    ``on_end`` gets the index of a command and how it ended; ``on_wait`` is called several times
    a second. Whatever ends this function ends the processes, too, with their children.

    Raises:
        KeyboardInterrupt: This process was told to end.
    """
    with signals_to_end() as received, place as submit:
        numbers = {submit(command): i for i, command in enumerate(commands)}
        waiting = set(numbers)
        while waiting:
            ended, waiting = wait(waiting, _PAUSE, FIRST_COMPLETED)
            if received:
                raise KeyboardInterrupt
            on_wait()
            for future in ended:
                on_end(numbers[future], future.result())


@contextmanager
def signals_to_end(at_once: bool = False) -> Iterator[list[int]]:
    """Yield the signals to end that were received.

    Args:
        at_once: They interrupt what is being done. Python forgets an exception in a destructor
            or in a callback of a library, so that the caller still has to look whether any came.

    Raises:
        KeyboardInterrupt: One came, and nobody has looked.
    """
    received: list[int] = []

    def note(number: int, _: Any) -> None:
        received.append(number)
        if at_once:
            raise KeyboardInterrupt

    before = {n: signal.signal(n, note) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        yield received
        if received:
            raise KeyboardInterrupt
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
