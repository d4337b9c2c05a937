"""The arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def _directory(what: str) -> Any:
    return typer.Option("-o", "--output", show_default=False, help=what)


CaseFile = Annotated[Path, typer.Argument(help="The case file (YAML).", show_default=False)]
Overrides = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        show_default=False,
        help='Change a value of the case, as in --set effects.shear.stiffness="500 N/m".',
    ),
]
Jobs = Annotated[
    int | None,
    typer.Option(
        "--jobs", "-j", min=1, show_default=False, help="Runs side by side; one a processor."
    ),
]
Output = Annotated[
    Path | None,
    _directory(
        "Directory of all that is written; a folder of results/ with the name of the case "
        "unless given."
    ),
]
AccuracyOutput = Annotated[
    Path | None,
    _directory(
        "Directory of runs, table and diagrams; results/<name of the case>-accuracy unless given."
    ),
]
SweepOutput = Annotated[
    Path | None,
    _directory("Directory of all results; results/<name of the first file>-sweep unless given."),
]
Page = Annotated[
    Path | None,
    _directory("Page of several runs; comparison.html in the folder that holds them all."),
]
