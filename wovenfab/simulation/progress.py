"""What a run tells while it goes on: progress, and the wall time of its phases."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from wovenfab.stepping.step import Step


@dataclass(frozen=True)
class Progress:
    """What a listener is told.

    Attributes:
        phase: What is being done, in plain words.
        done: Share of the program that is done, 0 to 1.
        step: The step just accepted, or None.
        unknowns: Number of unknowns once known.
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
