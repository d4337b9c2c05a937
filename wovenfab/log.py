"""Log messages of all modules: where they go, and from which level on.

Every module logs to ``logging.getLogger(__name__)``. Decisions that last (a cut step, a change to
stress at points) are INFO, Newton iterations DEBUG. Nothing is shown unless asked for. All ranks
have the same level, because norms are collective; only the first one has handlers.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

#: Levels of ``-v`` and ``-vv``.
LEVELS = (logging.WARNING, logging.INFO, logging.DEBUG)
_FILE_FORMAT = "%(asctime)s %(levelname)-7s %(name)s: %(message)s"


class _Printer(logging.Handler):
    """Hands each message to a function."""

    def __init__(self, show: Callable[[str], None]) -> None:
        super().__init__()
        self._show = show

    def emit(self, record: logging.LogRecord) -> None:
        self._show(self.format(record))


def configure(
    verbosity: int, file: Path | None, show: Callable[[str], None], first_rank: bool
) -> None:
    """Choose what is logged and where.

    Args:
        verbosity: 0 for nothing, 1 for decisions, 2 for each Newton iteration, on the screen.
        file: Gets all of it with its time, whatever the screen shows; None for no file.
        show: Shows a message on the screen.
        first_rank: Whether this process is the first rank, which alone writes.

    Raises:
        OSError: If the file cannot be written.
    """
    package = logging.getLogger("wovenfab")
    for handler in package.handlers[:]:
        package.removeHandler(handler)
        handler.close()
    screen = LEVELS[min(verbosity, len(LEVELS) - 1)]
    package.setLevel(screen if file is None else logging.DEBUG)
    package.propagate = False
    if not first_rank:
        package.addHandler(logging.NullHandler())
        return
    printer = _Printer(show)
    printer.setLevel(screen)
    package.addHandler(printer)
    if file is not None:
        writer = logging.FileHandler(file, mode="w", encoding="utf-8")
        writer.setFormatter(logging.Formatter(_FILE_FORMAT))
        package.addHandler(writer)
