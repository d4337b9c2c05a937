"""How much memory a process took is its own, not that of the one which started it."""

from __future__ import annotations

import subprocess
import sys

import numpy as np

from wovenfab.simulation.progress import peak_memory


def test_peak_memory_counts_what_was_freed_again_but_not_the_parents() -> None:
    before = peak_memory()
    block = np.ones(before + 300_000_000, dtype=np.uint8)  # more than ever before
    here = peak_memory()
    del block
    assert min(peak_memory(), here) > before + 290_000_000  # the kernel counts in batches
    code = "from wovenfab.simulation.progress import peak_memory; print(peak_memory())"
    child = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    print(f"{here / 1e6:.0f} MB here, {float(child.stdout) / 1e6:.0f} MB in a new process")
    assert float(child.stdout) < here - 250_000_000
