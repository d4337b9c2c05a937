"""When a method that has failed is not tried."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

from wovenfab.model.memory import attributes, take_attributes

logger = logging.getLogger(__name__)
#: Largest number of occasions that are passed over after failures: what failed in one part of a
#: cycle may succeed in the next, and one failure in so many costs little.
LONGEST_WAIT = 32


class BackOff:
    """Passes over occasions after a failure, twice as many after each further one."""

    def __init__(self, what: str) -> None:
        """Begin without a failure.

        Args:
            what: What has failed, for the log.
        """
        self._what = what
        self._length = self._remaining = 0

    @property
    def waits(self) -> bool:
        """Whether the next occasion is to be passed over."""
        return self._remaining > 0

    def skip(self) -> None:
        """Pass over an occasion."""
        self._remaining = max(0, self._remaining - 1)

    def snapshot(self) -> dict[str, Any]:
        """Return what is passed over."""
        return attributes(self, "_length", "_remaining")

    def resume(self, snapshot: Mapping[str, Any]) -> None:
        """Go on with a snapshot."""
        take_attributes(self, snapshot, "_length", "_remaining")

    def reset(self) -> None:
        """Note a success."""
        self._length = self._remaining = 0

    def fail(self) -> None:
        """Note a failure."""
        self._length = self._remaining = min(max(1, 2 * self._length), LONGEST_WAIT)
        logger.info("%s: not tried the next %d times", self._what, self._length)
