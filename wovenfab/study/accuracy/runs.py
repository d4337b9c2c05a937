"""Runs of an accuracy study in processes of their own, one at a time; what is done is kept."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from wovenfab.case import read_case
from wovenfab.parallel import child_environment
from wovenfab.record.results import write_whole
from wovenfab.study.accuracy import measure as run
from wovenfab.study.accuracy.measure import Measured, dump_measured, read_measured
from wovenfab.study.accuracy.settings import Setting
from wovenfab.study.runner import fingerprint

#: Another process may be compiling kernels of its own meanwhile; then the run starts again.
_MOST_STARTS = 4
#: Seconds between two signs of life.
_PAUSE = 1.0


class KeptRuns:
    """Runs settings of a case, unless a file has the result of the same case and code."""

    def __init__(
        self,
        path: Path,
        overrides: Sequence[str],
        directory: Path,
        alive: Callable[[float], None] = lambda seconds: None,
    ) -> None:
        """Run nothing yet.

        Args:
            path: The case file.
            overrides: Values that replace those of the file in every run.
            directory: Where results are kept, a file each.
            alive: Called about every second of a run with how long it has taken, s.
        """
        self._path, self._overrides = path, tuple(overrides)
        self._directory, self._alive = directory, alive
        self.asked = self.kept = 0

    def __call__(self, setting: Setting) -> Measured:
        """Return what a setting gives and costs.

        Raises:
            KeyboardInterrupt: This process was interrupted; the run was ended, too.
        """
        self.asked += 1
        every = (*self._overrides, *setting.overrides)
        file = self._directory / f"{_mark(fingerprint(read_case(self._path, every)))}.json"
        with suppress(OSError, ValueError, TypeError):
            found = read_measured(file.read_text(encoding="utf-8"))
            self.kept += 1
            return found
        found = self._start(every)
        self._directory.mkdir(parents=True, exist_ok=True)
        write_whole(file, dump_measured(found) + "\n")
        return found

    def _start(self, overrides: Sequence[str]) -> Measured:
        command = [sys.executable, "-m", run.__name__, str(self._path), *overrides]
        compiled = 0.0
        for _ in range(_MOST_STARTS):
            code, said, errors = self._run(command)
            if code:
                lines = [line for line in errors.splitlines() if line.strip()]
                why = f"killed by signal {-code}" if code < 0 else (lines or [f"code {code}"])[-1]
                return Measured(failure=why, compile=compiled)
            found = read_measured(said.splitlines()[-1])
            if not found.compile:
                return replace(found, compile=compiled)
            compiled += found.compile
        return Measured(failure="kernels were compiled again and again", compile=compiled)

    def _run(self, command: Sequence[str]) -> tuple[int, str, str]:
        start = time.monotonic()
        process = subprocess.Popen(
            command,
            env={"OMP_NUM_THREADS": "1"} | child_environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,  # so that its compilers can be ended with it
        )
        try:
            while True:
                try:
                    said, errors = process.communicate(timeout=_PAUSE)
                except subprocess.TimeoutExpired:
                    self._alive(time.monotonic() - start)
                else:
                    return process.returncode, said, errors
        except BaseException:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            raise


def _mark(case: str) -> str:
    """Return the name of a result: case and computing code, and how results are measured."""
    measuring = Path(run.__file__).read_bytes()
    return hashlib.sha256(case.encode() + measuring).hexdigest()[:16]
