"""Parts of a page in Markdown."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

#: Pixels of the page for each inch of a picture, so that all sheets show at one scale.
_PIXELS = 110


def listed(claim: Mapping[str, Any]) -> Iterator[str]:
    """Yield a claim as an item of a numbered list, its measures below it, and the verdict."""
    yield f"{claim['number']}. {claim['sentence']} ({claim['figures']})"
    for measure in claim["measures"]:
        mark = "" if measure["holds"] else " ✗"
        shown = f"**{measure['shown']}**{mark} (asked: {measure['asked']})"
        yield f"   - {measure['what']}: {shown}"
    yield ""
    yield f"   *{claim['verdict']}*"


def image(file: str, width: float, name: str) -> str:
    """Return a picture of the folder ``paper`` that is ``width`` inches wide."""
    return f'<img src="paper/{file}" width="{round(_PIXELS * width)}" alt="{name}">'


def table(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Yield a table; its first row has the headings, its first column texts."""
    heads, *others = rows
    yield f"| {' | '.join(heads)} |"
    yield "|---|" + "---:|" * (len(heads) - 1)
    for row in others:
        yield f"| {' | '.join(row)} |"
