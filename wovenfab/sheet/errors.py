"""What is wrong with a geometry."""

from __future__ import annotations


class GeometryError(Exception):
    """A geometry that cannot be meshed; the text says why and what to do."""

    def __init__(self, message: str, key: str = "file") -> None:
        """Keep which key of ``sheet`` in a case is meant."""
        super().__init__(message)
        self.key = key
