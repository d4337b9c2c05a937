"""How large a run is in memory, how large it was, and how large it may be."""

from __future__ import annotations

import os
import resource
from pathlib import Path


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
