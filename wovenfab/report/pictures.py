"""All pictures and pages of a results directory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from wovenfab.record.field_file import DATA, ERROR, MODE
from wovenfab.record.fields import StoredFields, read_fields
from wovenfab.report.animation import ANIMATION, animate
from wovenfab.report.deformed import deformed
from wovenfab.report.error import error
from wovenfab.report.loop import loop
from wovenfab.report.mode import mode
from wovenfab.report.run_data import open_run_data, origin_of
from wovenfab.report.style import house_style, save
from wovenfab.report.viewer import write_viewer
from wovenfab.report.yarns import write_yarns


class ReportError(Exception):
    """Some pictures could not be drawn.

    Attributes:
        drawn: The pictures that could.
    """

    def __init__(self, message: str, drawn: list[Path]) -> None:
        """Keep what was drawn beside the message."""
        super().__init__(message)
        self.drawn = drawn


def _loop(folder: Path) -> list[Path]:
    figure, origin = loop(open_run_data(folder)), origin_of(folder)
    return [save(figure, folder / f"loop.{kind}", origin) for kind in ("png", "svg")]


def _deformed(folder: Path) -> list[Path]:
    stored = _stored(folder)
    if stored is None:
        return []
    figure = deformed(open_run_data(folder), stored)
    return [save(figure, folder / "deformed.png", origin_of(folder))]


def _mode(folder: Path) -> list[Path]:
    if not (folder / f"{MODE}.h5").exists():
        return []
    stored = read_fields(folder, MODE)
    if not len(stored.times):
        return []
    figure = mode(open_run_data(folder), stored)
    return [save(figure, folder / f"{MODE}.png", origin_of(folder))]


def _page(folder: Path) -> list[Path]:
    from wovenfab.report.pages.run_page import write_run_page

    return [write_run_page(folder)]


def _yarns(folder: Path) -> list[Path]:
    source, stored = open_run_data(folder), _stored(folder)
    if stored is None or source.fibres is None:
        return []
    return [*write_yarns(source, stored), write_viewer(folder)]


def _animation(folder: Path) -> list[Path]:
    stored = _stored(folder)
    if stored is None:
        raise ValueError("the run wrote no fields")
    return [animate(open_run_data(folder), stored, folder / ANIMATION, origin_of(folder))]


def _stored(folder: Path) -> StoredFields | None:
    """Return the fields of a run; None if it wrote none."""
    stored = read_fields(folder) if (folder / DATA).exists() else None
    return stored if stored is not None and len(stored.times) else None


def _error(folder: Path) -> list[Path]:
    if not (folder / f"{ERROR}.h5").exists():
        return []
    stored = read_fields(folder, ERROR)
    if not len(stored.times):
        return []
    figure = error(open_run_data(folder), stored)
    return [save(figure, folder / f"{ERROR}.png", origin_of(folder))]


#: What can be drawn of a run, each from its directory.
MAKERS: dict[str, Callable[[Path], list[Path]]] = {
    "picture of loop": _loop,
    "picture of deformed": _deformed,
    "picture of mode": _mode,
    "picture of error": _error,
    "page": _page,
    "yarns for ParaView": _yarns,
    "animation": _animation,
}
#: What a run draws at its end.
PICTURES = ("picture of loop", "picture of deformed", "picture of mode", "picture of error")
#: What a report draws.
REPORT = (*PICTURES, "page", "yarns for ParaView")


def draw(directory: str | Path, wanted: Sequence[str] = PICTURES) -> list[Path]:
    """Draw what is wanted, as far as the results allow, into their directory.

    Args:
        directory: A results directory, of a finished run or not.
        wanted: Names of ``MAKERS``.

    Returns:
        The files written. What needs fields is left out where the run has none.

    Raises:
        ReportError: Something failed; the rest is drawn all the same.
    """
    folder = Path(directory)
    drawn: list[Path] = []
    problems: list[str] = []
    for name in wanted:
        try:
            with house_style():
                drawn += MAKERS[name](folder)
        except Exception as error:  # one picture must not cost the others
            reason = " ".join(str(error).split()) or type(error).__name__
            problems.append(f"no {name}: {reason}")
    if problems:
        raise ReportError("; ".join(problems), drawn)
    return drawn
