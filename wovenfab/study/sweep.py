"""Runs side by side, each in a process of its own; what need not change is kept."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from wovenfab.parallel import child_environment
from wovenfab.record.history import HISTORY
from wovenfab.record.results import FINGERPRINT
from wovenfab.record.summary import SUMMARY
from wovenfab.study.members import Member
from wovenfab.study.runner import fingerprint

State = Literal["waiting", "running", "kept", "finished", "failed"]
#: Seconds between two looks at the running processes.
_PAUSE = 0.2
#: Seconds that a process has to end when it is asked to.
_PATIENCE = 5.0


@dataclass
class Run:
    """A member and what became of it.

    Attributes:
        member: What is run.
        directory: Its results directory.
        state: ``kept`` if the results were there already.
        problem: Why it failed, or nothing.
        seconds: How long it took in this sweep.
    """

    member: Member
    directory: Path
    state: State = "waiting"
    problem: str = ""
    seconds: float = 0.0

    @property
    def log(self) -> Path:
        """What the run says."""
        return self.directory.with_name(f"{self.directory.name}.log")

    @property
    def has_results(self) -> bool:
        """Whether there are results that belong to the member."""
        return self.state in ("kept", "finished")

    @property
    def done(self) -> float:
        """Share of its steps that are done."""
        if self.state != "running":
            return float(self.state != "waiting")
        try:
            rows = (self.directory / HISTORY).read_bytes().count(b"\n") - 2
        except OSError:
            return 0.0
        return min(max(rows, 0) / max(self.member.steps, 1), 1.0)


@dataclass
class Sweep:
    """All runs of a sweep.

    Attributes:
        runs: In the order of the members.
        started: When it started, s of the monotonic clock.
    """

    runs: list[Run]
    started: float = field(default_factory=time.monotonic)

    @property
    def share(self) -> float:
        """Share of the work that is done, without what was kept."""
        new = [run for run in self.runs if run.state != "kept"]
        whole = sum(run.member.weight for run in new)
        return sum(run.member.weight * run.done for run in new) / whole if whole else 1.0

    @property
    def left(self) -> float | None:
        """Seconds that are left, or None as long as that cannot be told."""
        share = self.share
        return (time.monotonic() - self.started) * (1 - share) / share if share > 0.01 else None


def sweep(
    members: Sequence[Member],
    directory: Path,
    jobs: int,
    tell: Callable[[Sweep, Run | None], None],
) -> list[Run]:
    """Run all members whose results are not there yet, ``jobs`` at a time.

    Each runs on one processor: side by side they need less time than one after the other on
    several. Whatever ends this function ends the processes, too; what has finished by then
    is kept by the next sweep.

    Args:
        members: What to run.
        directory: Where each gets a results directory and a log of its name.
        jobs: Number of processes.
        tell: Called with each run that ended, and with None while all go on.

    Raises:
        KeyboardInterrupt: This process was told to end.
    """
    directory.mkdir(parents=True, exist_ok=True)
    runs = [Run(member, directory / member.name) for member in members]
    now = Sweep(runs)
    marks = {member.name: fingerprint(member.case) for member in members}
    for run in runs:
        if _mark_of(run) == marks[run.member.name] and (run.directory / SUMMARY).is_file():
            run.state = "kept"
            tell(now, run)
    # the longest first, so that no processor is idle in the end
    waiting = sorted((r for r in runs if r.state == "waiting"), key=lambda r: -r.member.weight)
    with _signals() as received, _processes() as running:
        while waiting or running:
            if received:
                raise KeyboardInterrupt
            while waiting and len(running) < jobs:
                run = waiting.pop(0)
                running.append((run, _start(run)))
            time.sleep(_PAUSE)
            tell(now, None)
            for run, process in [(r, p) for r, p in running if p.poll() is not None]:
                running.remove((run, process))
                _finish(run, process.returncode, marks[run.member.name])
                tell(now, run)
    return runs


def _mark_of(run: Run) -> str:
    try:
        return (run.directory / FINGERPRINT).read_text(encoding="utf-8").strip()
    except OSError:
        return ""


def _start(run: Run) -> subprocess.Popen[bytes]:
    member = run.member
    command = [sys.executable, "-m", "wovenfab", "run", str(member.path)]
    command += ["-o", str(run.directory), "--overwrite"]
    command += [word for text in member.overrides for word in ("--set", text)]
    run.state, run.seconds = "running", -time.monotonic()
    with run.log.open("wb") as log:
        return subprocess.Popen(
            command,
            env={"OMP_NUM_THREADS": "1"} | child_environment(),
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # so that its compilers can be ended with it
        )


def _finish(run: Run, code: int, mark: str) -> None:
    run.seconds += time.monotonic()
    if code == 0:
        run.state = "finished"
        (run.directory / FINGERPRINT).write_text(mark + "\n", encoding="utf-8")
        return
    run.state = "failed"
    said = [line for line in run.log.read_text(errors="replace").splitlines() if line.strip()]
    run.problem = f"killed by signal {-code}" if code < 0 else (said or [f"exit code {code}"])[-1]


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


@contextmanager
def _processes() -> Iterator[list[tuple[Run, subprocess.Popen[bytes]]]]:
    """Yield a list of processes; those still in it at the end are ended, with their children."""
    running: list[tuple[Run, subprocess.Popen[bytes]]] = []
    try:
        yield running
    finally:
        for number in (signal.SIGTERM, signal.SIGKILL):
            for _, process in running:
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, number)
            until = time.monotonic() + _PATIENCE
            while time.monotonic() < until and any(p.poll() is None for _, p in running):
                time.sleep(0.05)
