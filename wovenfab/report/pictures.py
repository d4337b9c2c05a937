"""All pictures of a results directory."""

from __future__ import annotations

from pathlib import Path

from wovenfab.record.field_file import DATA, MODE
from wovenfab.record.stored_fields import read_fields
from wovenfab.report.deformed import deformed
from wovenfab.report.loop import loop
from wovenfab.report.mode import mode
from wovenfab.report.source import open_source, origin_of
from wovenfab.report.style import house_style, save


class ReportError(Exception):
    """Some pictures could not be drawn.

    Attributes:
        drawn: The pictures that could.
    """

    def __init__(self, message: str, drawn: list[Path]) -> None:
        """Keep what was drawn beside the message."""
        super().__init__(message)
        self.drawn = drawn


def draw(directory: str | Path) -> list[Path]:
    """Draw every picture that the results allow, into their directory.

    Args:
        directory: A results directory, of a finished run or not.

    Returns:
        The files written: ``loop.png`` and ``loop.svg``, ``deformed.png`` where the run
        has fields, and ``mode.png`` where stability was lost.

    Raises:
        ReportError: A picture failed; the others are drawn all the same.
    """
    folder = Path(directory)
    drawn: list[Path] = []
    problems: list[str] = []
    for name, picture in (("loop", _loop), ("deformed", _deformed), ("mode", _mode)):
        try:
            with house_style():
                drawn += picture(folder)
        except Exception as error:  # one picture must not cost the others
            reason = " ".join(str(error).split()) or type(error).__name__
            problems.append(f"no picture of {name}: {reason}")
    if problems:
        raise ReportError("; ".join(problems), drawn)
    return drawn


def _loop(folder: Path) -> list[Path]:
    figure, origin = loop(open_source(folder)), origin_of(folder)
    return [save(figure, folder / f"loop.{kind}", origin) for kind in ("png", "svg")]


def _deformed(folder: Path) -> list[Path]:
    if not (folder / DATA).exists():  # a run may write no fields
        return []
    stored = read_fields(folder)
    if not len(stored.times):
        return []
    figure = deformed(open_source(folder), stored)
    return [save(figure, folder / "deformed.png", origin_of(folder))]


def _mode(folder: Path) -> list[Path]:
    if not (folder / f"{MODE}.h5").exists():
        return []
    stored = read_fields(folder, MODE)
    if not len(stored.times):
        return []
    figure = mode(open_source(folder), stored)
    return [save(figure, folder / f"{MODE}.png", origin_of(folder))]
