"""From sections to one HTML file that needs nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from wovenfab.record.provenance import Provenance
from wovenfab.record.results import write_whole
from wovenfab.report.pages.blocks import Section
from wovenfab.report.stamp import MAKER


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
