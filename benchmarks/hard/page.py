"""The page of hard cases: one table, its families, their pictures."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence

from benchmarks.hard.results import Result
from benchmarks.hard.row import Family, Figures, Row, verdict
from wovenfab.record.results import markdown

HEAD = """# Hard cases

`make hard` runs them all, each in a process of its own, prints this table and writes this page;
`make hard rows="locking long"` runs those whose names begin so, `quick=--quick` their small
versions, which `make test-all` runs, too. Results are stored in `results/hard`, so that an
interrupted run goes on where it was. A row *passes* if all its thresholds hold; where
physics ends it must *stop with a diagnosis*. The thresholds are in
[benchmarks/hard/families](../benchmarks/hard/families), what the diagnoses mean in
[troubleshooting](troubleshooting.md).
"""
NOTES = """
Iterations: mean and worst of a step. Margin: the smallest sine of the angle between the families,
`(f_1 × f_2)/(|f_1||f_2|)`, over all iterates and all quadrature points of cells and facets; 1 at
rest, 0 where yarns align. Imbalance: the largest of the run over the largest work, where ten
steps or more sum the work.
"""
#: Shown where there is no such figure.
NONE = "\N{EN DASH}"
COLUMNS = (
    "case", "what makes it hard", "unknowns", "steps", "iterations", "cut-backs", "margin",
    "imbalance", "remedy", "verdict",
)  # fmt: skip


def page(families: Sequence[Family], results: Mapping[str, Result], alternatives: str) -> str:
    """Return the page in Markdown.

    Args:
        families: All families.
        results: Results by the name of the row; rows without one are left out.
        alternatives: The section on what else was tried.
    """
    commits = ", ".join(sorted({f"`{k.commit}`" for k in results.values() if k.commit}))
    parts = [HEAD, table(families, results), NOTES, f"Code of these figures: commit {commits}.\n"]
    for family in families:
        if any(row.name in results for row in family.rows):
            parts.append(
                f"## {family.title}\n\n{wrapped(family.text)}\n\n"
                f"![{family.title}](pictures/{picture_name(family)})\n"
            )
    return "\n".join([*parts, alternatives])


def picture_name(family: Family) -> str:
    """Return the file name of a family's picture."""
    return f"hard-{family.title.lower().replace(' ', '-')}.png"


def table(families: Iterable[Family], results: Mapping[str, Result]) -> str:
    """Return the table in Markdown."""
    rows = [row for family in families for row in family.rows if row.name in results]
    text = markdown(COLUMNS, [cells(row, results[row.name]) for row in rows], (0, 1, 8, 9))
    return f"{text}\n"


def cells(row: Row, result: Result) -> list[str]:
    """Return the cells of a row."""
    figures = result.figures
    text = verdict(row, figures, result.failure)
    shown = [""] * 6 if figures is None else _figures(figures)
    return [row.title, row.hard, *shown, row.remedy, text]


def _figures(figures: Figures) -> list[str]:
    return [
        f"{figures.unknowns}",
        f"{figures.steps}",
        f"{figures.mean:.1f}, {figures.worst}",
        f"{figures.cutbacks}",
        NONE if figures.margin is None else f"{figures.margin:.2g}",
        NONE if figures.imbalance is None else f"{figures.imbalance:.1g}",
    ]


def wrapped(text: str, width: int = 100) -> str:
    """Return a paragraph in lines of a width."""
    return "\n".join(textwrap.wrap(text, width))
