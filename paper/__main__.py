"""``python3 -m paper FOLDER``: run the paper's figures, measure its claims, write the page."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from paper.command import make_paper
from wovenfab.cli.app import Jobs, Overrides, guarded


def main(
    folder: Annotated[
        Path, typer.Argument(help="The case files of the figures.", show_default=True)
    ] = Path("configs/paper"),
    overrides: Overrides = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="Directory of all results.")] = (
        Path("results/paper")
    ),
    docs: Annotated[
        Path | None,
        typer.Option(
            show_default=False, help="Where the page goes; beside the results unless given."
        ),
    ] = None,
    jobs: Jobs = None,
) -> None:
    """Run the paper's figures, measure its claims and write the page of both.

    Repeat the command to go on after an interruption; only what changed is computed again.
    """
    sys.exit(make_paper(folder, overrides or [], output, docs, jobs))


if __name__ == "__main__":
    guarded(lambda: typer.run(main))
