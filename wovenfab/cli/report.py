"""``wovenfab report`` and ``wovenfab export``."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from wovenfab.cli.console import BAD_INPUT, Console
from wovenfab.measured.layout import EMPTY, Layout

if TYPE_CHECKING:
    from wovenfab.report.page_blocks import PageSection

#: Results are whole, but something of the report could not be drawn.
NOT_DRAWN = 1


def report_results(
    directories: Sequence[Path],
    output: Path | None,
    animation: bool = False,
    lab: Path | None = None,
    layout: Layout = EMPTY,
) -> int:
    """Report one run in its directory, or several on one page; return the exit code.

    ``lab`` is a measured curve, over which the runs are drawn, and ``layout`` what is said of it.
    """
    console = Console()
    if _lacks_results(console, directories):
        return BAD_INPUT
    if lab is None and layout != EMPTY:
        console.problem(
            "--columns, --units, --rows, --decimal and --sheet are of the file of --lab: name it"
        )
        return BAD_INPUT
    if animation and len(directories) > 1:
        console.problem("--animation shows one run: name one directory")
        return BAD_INPUT
    if len(directories) == 1 and output is not None:
        console.problem("-o names the page of several runs; that of one is in its own directory")
        return BAD_INPUT
    from wovenfab.record.summary import read_cycles
    from wovenfab.report.pages import default_place
    from wovenfab.report.run_data import open_run_data

    page = output or default_place(directories)
    folder = directories[0] if len(directories) == 1 else page.parent
    try:
        for directory in directories:  # one message, rather than one for each picture
            open_run_data(directory)
            read_cycles(directory)
        measured = [] if lab is None else [_measured(console, directories, lab, layout, folder)]
        if len(directories) == 1:
            return _report(console, directories[0], animation, measured)
        from wovenfab.report.pages import write_comparison

        console.say(str(write_comparison(directories, page, measured)))
    except (OSError, ValueError) as error:
        console.problem(str(error))
        return BAD_INPUT
    return 0


def _lacks_results(console: Console, directories: Sequence[Path]) -> bool:
    """Say which directory holds no results, if one does not."""
    for directory in directories:
        if not (directory / "history.csv").is_file():
            console.problem(f"{directory} holds no results of wovenfab (there is no history.csv)")
            return True
    return False


def _report(
    console: Console, directory: Path, animation: bool, more: Sequence[PageSection] = ()
) -> int:
    from wovenfab.report.pictures import MAKERS, REPORT, ReportError, draw, draw_page

    names, makers = (*REPORT, *(["animation"] if animation else [])), dict(MAKERS)
    makers["page"] = partial(draw_page, more=more)
    try:
        drawn, failed = draw(directory, names, makers), None
    except ReportError as error:
        drawn, failed = error.drawn, error
    for path in drawn:
        console.say(str(path))
    if failed is None:
        return 0
    console.problem(str(failed))
    return BAD_INPUT if failed.damaged else NOT_DRAWN


def _measured(
    console: Console, directories: Sequence[Path], lab: Path, layout: Layout, folder: Path
) -> PageSection:
    """Draw runs over a measured curve, say how far they are, and return a section with that."""
    from wovenfab.measured.curve import read_measured
    from wovenfab.report.fit import LAB, measured_figure
    from wovenfab.report.page_blocks import PageTable, picture, section
    from wovenfab.report.pages import labels
    from wovenfab.report.run_data import open_run_data
    from wovenfab.report.style import house_style, save

    measured = read_measured(lab, layout)
    if measured.reading is not None:
        for text in (str(measured.reading), *measured.reading.notes):
            console.say(f"{lab.name}: {text}")
    runs = list(zip(labels(directories), map(open_run_data, directories), strict=True))
    with house_style():
        figure, rows = measured_figure(runs, measured)
        path = save(figure, folder / LAB)
    for name, distance in rows:
        console.say(f"{name}: {distance}")
    console.say(str(path))
    said = "; ".join(f"{name}: {distance}" for name, distance in rows)
    caption = f"Computed forces (lines) over the measured ones of {lab.name} (points)."
    table = PageTable("Distance from the measured forces", ["run", "distance"], rows, numbers=False)
    return section("Measured curve", lambda: [picture(figure, caption, said), table])


def show_measured(path: Path, layout: Layout = EMPTY) -> int:
    """Say how a measured curve is read; return the exit code."""
    from wovenfab.measured.curve import describe_reading, read_curve

    Console().say("\n".join(describe_reading(read_curve(path, layout))))
    return 0


def export_results(
    directory: Path,
    output: Path | None,
    at: str | None = None,
    every: int | None = None,
    last: bool = False,
    cloud: Path | None = None,
    layout: Layout = EMPTY,
    align: bool = False,
    positions: str = "auto",
) -> int:
    """Write stored fields as VTU and CSV, or compare them with a cloud; return the exit code.

    Args:
        directory: The results directory.
        output: Where the files go; ``export`` in the results directory if None.
        at: Times or displacements of the program, separated by commas.
        every: Every so many stored times.
        last: The last stored time.
        cloud: Measured displacements at points, to be compared with those at one time.
        layout: What is said of the cloud's file.
        align: Find how the cloud's coordinates lie on the sheet.
        positions: What those of the cloud are, ``auto``, ``rest`` or ``moved``.
    """
    from wovenfab.measured.cloud import read_cloud
    from wovenfab.record.results import is_link
    from wovenfab.report.alignment import POSITIONS, placed
    from wovenfab.report.export import FOLDER, chosen_times, compare, export, write_distances
    from wovenfab.report.run_data import largest, open_run_data, stored_of
    from wovenfab.report.style import house_style, millimetres

    console = Console()
    if _lacks_results(console, [directory]):
        return BAD_INPUT
    if cloud is None and (layout != EMPTY or align or positions != POSITIONS[0]):
        console.problem(
            "--columns, --units, --rows, --decimal, --sheet, --align and --positions are of the "
            "file of --compare"
        )
        return BAD_INPUT
    if positions not in POSITIONS:
        console.problem(f"--positions is one of {', '.join(POSITIONS)}, got {positions!r}")
        return BAD_INPUT
    try:
        source, stored = open_run_data(directory), stored_of(directory)
        if stored is None:
            raise ValueError(f"{directory} has no fields: the run wrote none")
        texts = at.split(",") if at else []
        times = chosen_times(source, stored, texts, every, last)
        folder = output or directory / FOLDER
        if output is None and folder.is_symlink():
            raise ValueError(is_link(folder))
        if cloud is None:
            folder.mkdir(parents=True, exist_ok=True)
            for index in times:
                words = f"step {stored.steps[index]}, {stored.times[index]:.6g} s"
                for path in export(stored, index, folder):
                    console.say(f"{path} ({words})")
            return 0
        if not (texts or every or last):
            times = [largest(source, stored).index]
        if len(times) > 1:
            raise ValueError("a cloud is of one time: name it, as in --at '20 mm'")
        on_sheet = placed(stored, times[0], read_cloud(cloud, layout), align, positions)
        measured = on_sheet.cloud
        found = compare(stored, times[0], measured.points, measured.displacements)
        folder.mkdir(parents=True, exist_ok=True)
        reached = float(source.reached(stored)[times[0]])
        words = f"step {stored.steps[times[0]]}, {millimetres(reached)}"
        for note in on_sheet.notes:
            console.say(note)
        console.say(f"{words}: {found}")
        name = folder / f"step-{stored.steps[times[0]]:06d}-distance"
        with house_style():
            for path in write_distances(found, source, stored, f"{words}; {cloud.name}", name):
                console.say(str(path))
    except (OSError, ValueError) as error:
        console.problem(str(error))
        return BAD_INPUT
    return 0
