"""Pages: pictures, tables and texts in sections, written as one HTML file without links."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib as mpl
from jinja2 import Environment, PackageLoader, StrictUndefined
from matplotlib.figure import Figure

from wovenfab.plain_text import one_line
from wovenfab.record.results import Provenance, write_whole
from wovenfab.report.style import DEGREE, MAKER, Unit, house_style, readable, seconds

NONE = "\N{EN DASH}"
MINUS = "\N{MINUS SIGN}"
#: Width on a page (rem) of an inch of a figure, so that all have letters of one size.
REM = 7.2
#: Resolution of pictures of fields (1/in).
DPI = 170
TYPES = {"svg": "image/svg+xml", "png": "image/png"}
#: Heading and SI unit of each column of cycles.csv that a page shows.
COLUMNS: dict[str, tuple[str, str]] = {
    "peak_displacement_m": ("reversal at", "m"),
    "peak_force_N": ("peak force", "N"),
    "residual_force_N": ("residual force", "N"),
    "secant_stiffness_N_per_m": ("secant stiffness", "N/m"),
    "loop_area_J": ("loop area", "J"),
    "stored_at_peak_J": ("stored at reversal", "J"),
    "loss_ratio": ("loss ratio", ""),
    "dissipated_J": ("dissipated", "J"),
    "imbalance_J": ("imbalance", "J"),
    "shear_angle_kinematic_rad": ("shear angle, kinematic", "rad"),
    "shear_angle_field_rad": ("shear angle, field", "rad"),
    "normalised_shear_force_N_per_m": ("normalised shear force", "N/m"),
}


@dataclass(frozen=True)
class Picture:
    """A picture.

    Attributes:
        uri: The file, as a data URI.
        width: Width on the page (rem).
        caption: What it shows.
        says: What it says, for screen readers.
    """

    uri: str
    width: float
    caption: str
    says: str
    kind: str = field(default="picture", init=False)


@dataclass(frozen=True)
class PageTable:
    """A table of texts: the first column is a heading, the others are numbers or not."""

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    numbers: bool = True
    kind: str = field(default="table", init=False)


@dataclass(frozen=True)
class PageText:
    """A paragraph, or the content of a file if it is ``verbatim``."""

    text: str
    verbatim: bool = False
    kind: str = field(default="text", init=False)


Block = Picture | PageTable | PageText


@dataclass(frozen=True)
class PageSection:
    """A titled part of a page."""

    title: str
    blocks: Sequence[Block]

    @property
    def anchor(self) -> str:
        """Target of links to it."""
        return re.sub(r"\W+", "-", self.title.lower())


def section(title: str, *makers: Callable[[], Sequence[Block]]) -> PageSection:
    """Return a section; a part that cannot be drawn becomes a text with the reason."""
    blocks: list[Block] = []
    for make in makers:
        try:
            with house_style():
                blocks += make()
        except Exception as error:  # a page of a broken run shows what there is
            reason = one_line(str(error)) or type(error).__name__
            blocks.append(PageText(f"This part could not be drawn: {reason}"))
    return PageSection(title, blocks)


def picture(figure: Figure, caption: str, says: str = "", kind: str = "svg") -> Picture:
    """Return a figure of curves as SVG, or one of fields, which have many cells, as ``"png"``.

    What it ``says`` follows the caption for those who do not see it.
    """
    data = io.BytesIO()
    figure.savefig(data, format=kind, dpi=DPI, metadata={"Date": None})
    wide = figure.get_tightbbox().width + 2 * mpl.rcParams["savefig.pad_inches"]
    uri = f"data:{TYPES[kind]};base64,{base64.b64encode(data.getvalue()).decode('ascii')}"
    return Picture(uri, wide * REM, caption, says)


def cycle_table(rows: Sequence[Mapping[str, str]]) -> PageTable:
    """Return the table of cycles from the rows of ``cycles.csv``, one at least."""
    known = [name for name in COLUMNS if name in rows[0]]
    columns = [_column(*COLUMNS[name], [row[name] for row in rows]) for name in known]
    numbers = [row["cycle"] + ("" if row["complete"] == "true" else "*") for row in rows]
    head = ["cycle", *(title for title, _ in columns)]
    body = [[n, *cells] for n, *cells in zip(numbers, *(c for _, c in columns), strict=True)]
    unfinished = any(number.endswith("*") for number in numbers)
    return PageTable(
        "Figures of each cycle" + (" (* not finished)" if unfinished else ""), head, body
    )


def computation_table(summary: Mapping[str, Any]) -> PageTable:
    """Return the table of the computation, from ``summary.json``."""
    iterations = summary["newton_iterations"]
    spent = summary["wall_time_s"]
    rows = [
        ("command", summary.get("command") or NONE),
        ("commit", summary.get("commit") or NONE),
        ("versions", ", ".join(f"{k} {v}" for k, v in summary["versions"].items())),
        ("MPI ranks", f"{summary['ranks']}"),
        ("unknowns", grouped(summary["unknowns"])),
        ("steps", f"{summary['steps']}, {summary['cut_backs']} cut back"),
        ("Newton iterations", f"{iterations['total']}, at most {iterations['worst'] or 0} a step"),
        ("wall time", ", ".join(f"{phase} {seconds(value)}" for phase, value in spent.items())),
    ]
    return PageTable("Computation", (), rows, numbers=False)


def grouped(number: int) -> str:
    """Return a whole number in groups of three digits."""
    return f"{number:,}".replace(",", "\N{THIN SPACE}")


def write_page(
    path: Path,
    title: str,
    notes: Sequence[str],
    figures: Sequence[tuple[str, str]],
    sections: Sequence[PageSection],
    origin: Provenance,
) -> Path:
    """Write a page; return ``path``.

    Below the title are sentences (``notes``), the main figures (name and value), sections.
    """
    environment = Environment(
        loader=PackageLoader("wovenfab.report", ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    text = environment.get_template("page.html.j2").render(
        title=title,
        notes=notes,
        figures=figures,
        sections=sections,
        origin=origin,
        maker=MAKER,
    )
    write_whole(path, text + "\n")
    return path


def _column(title: str, unit: str, cells: Sequence[str]) -> tuple[str, list[str]]:
    """Return heading and cells of a column in one readable unit."""
    values = [float(cell) if cell else None for cell in cells]
    largest = max((abs(v) for v in values if v is not None), default=0.0)
    shown = DEGREE if unit == "rad" else readable(unit, largest) if unit else Unit("", 1.0)
    texts = [NONE if v is None else f"{v * shown.factor:.4g}".replace("-", MINUS) for v in values]
    return f"{title} ({shown.name})" if shown.name else title, texts
