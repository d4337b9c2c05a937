"""What pages are made of: pictures, tables and texts in sections.

From sections to one HTML file that needs nothing else.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape
from matplotlib.figure import Figure
from PIL import Image

from wovenfab.record.results import Provenance, write_whole
from wovenfab.report.metadata import MAKER
from wovenfab.report.style import house_style


@dataclass(frozen=True)
class Picture:
    """A picture with its caption; the caption is also what is read out for it."""

    image: Markup
    caption: str
    kind: str = field(default="picture", init=False)


@dataclass(frozen=True)
class Table:
    """A table of texts: the first column is a heading, the others are numbers or not."""

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    numbers: bool = True
    kind: str = field(default="table", init=False)


@dataclass(frozen=True)
class Text:
    """A paragraph, or what a file says where it is ``verbatim``."""

    text: str
    verbatim: bool = False
    kind: str = field(default="text", init=False)


Block = Picture | Table | Text
#: Width on a page (rem) of an inch of a figure, so that all have letters of one size.
REM = 7.2
#: Resolution of pictures of fields.
DPI = 170


@dataclass(frozen=True)
class Section:
    """A titled part of a page."""

    title: str
    blocks: Sequence[Block]

    @property
    def anchor(self) -> str:
        """Name by which links find it."""
        return re.sub(r"\W+", "-", self.title.lower())


def section(title: str, *makers: Callable[[], Sequence[Block]]) -> Section:
    """Return a section; what cannot be drawn says why, and costs nothing else."""
    blocks: list[Block] = []
    for make in makers:
        try:
            with house_style():
                blocks += make()
        except Exception as error:  # a page of a broken run shows what there is
            reason = " ".join(str(error).split()) or type(error).__name__
            blocks.append(Text(f"This part could not be drawn: {reason}"))
    return Section(title, blocks)


def vector(figure: Figure, name: str, caption: str) -> Picture:
    """Return a figure of curves as SVG inside the page.

    Args:
        figure: The figure.
        name: Unique on the page: the SVG's own names begin with it.
        caption: What it shows.
    """
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.S)
    svg = re.sub(r'\bid="', f'id="{name}-', svg)
    svg = re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", svg)
    svg = re.sub(r'<svg (.*?)width="([\d.]+)pt" height="[\d.]+pt"', _opening(caption), svg, count=1)
    return Picture(Markup(svg), caption)


def raster(figure: Figure, caption: str) -> Picture:
    """Return a figure of fields as PNG inside the page."""
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=DPI, facecolor="white", pil_kwargs={"optimize": True})
    with Image.open(data) as picture:
        wide = picture.width / DPI * REM
    text = base64.b64encode(data.getvalue()).decode("ascii")
    image = f'<img alt="{escape(caption)}" src="data:image/png;base64,{text}"'
    return Picture(Markup(f'{image} style="width: {wide:.1f}rem">'), caption)


def _opening(caption: str) -> Callable[[re.Match[str]], str]:
    """Return what writes the SVG's own tag: how wide it is and what is read out for it."""

    def tag(found: re.Match[str]) -> str:
        wide = float(found[2]) / 72 * REM
        style = f'style="width: {wide:.1f}rem"'
        return f'<svg role="img" aria-label="{escape(caption)}" {style} {found[1]}'

    return tag


def write_page(
    path: Path,
    title: str,
    notes: Sequence[str],
    figures: Sequence[tuple[str, str]],
    sections: Sequence[Section],
    origin: Provenance,
) -> Path:
    """Write a page; return ``path``.

    Args:
        path: The HTML file.
        title: Its title.
        notes: Sentences below the title: how the run ended, say.
        figures: The numbers that people want first: name and value.
        sections: All the rest.
        origin: What made it.
    """
    environment = Environment(
        loader=PackageLoader("wovenfab.report.pages"),
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
