"""Progress, wall time and memory of a run."""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from wovenfab.stepping.step import Step


@dataclass(frozen=True)
class Progress:
    """The progress of a run.

    Attributes:
        phase: What is being done, in words.
        done: Share of the program that is done, 0 to 1.
        step: The step just accepted, or None.
        unknowns: Number of unknowns, or None before the model is made.
    """

    phase: str
    done: float = 0.0
    step: Step | None = None
    unknowns: int | None = None


class Stopwatch:
    """Wall time by phase (s)."""

    def __init__(self) -> None:
        """Start with no phase."""
        self.seconds: dict[str, float] = {}

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Add the time spent inside to the named phase."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


def memory(unknowns: int) -> float:
    """Return a rough estimate of the memory of a run on one rank (bytes).

    Fitted to the peak memory of a step with 8 000 to 500 000 unknowns, P3 with two
    placements; fewer couplings between unknowns need less.
    """
    return float(1.0e8 + 7.0e3 * unknowns * (max(unknowns, 1) / 8e3) ** 0.09)


def memory_of_machine() -> float:
    """Return the memory of this machine (bytes)."""
    return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))


def peak_memory() -> int:
    """Return the largest memory of this process so far (bytes).

    Linux counts the parent's in ``ru_maxrss`` if that was larger when it started us.
    """
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
    except (OSError, StopIteration):
        return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
