"""``python3 -m paper FOLDER``: run the paper's figures, measure its claims, write the page."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from functools import reduce
from pathlib import Path
from typing import Annotated

import typer

from paper.campaign import Campaign, Results, campaign_of
from paper.claims import Claim, claims
from paper.elements import Compared, compare, finding
from wovenfab.cli.app import Jobs, Overrides, guarded
from wovenfab.cli.console import INTERRUPTED, Console
from wovenfab.cli.studies import exit_code, run_members
from wovenfab.record.results import Provenance, of_summary, this_process, write_whole
from wovenfab.study.cluster import Cluster


def make_paper(
    folder: Path, overrides: Sequence[str], output: Path, docs: Path | None, jobs: int | None
) -> int:
    """Run the campaign, measure its claims, draw its figures and write its page.

    Args:
        folder: The case files.
        overrides: Values that replace those of all cases.
        output: Directory of all results.
        docs: Where the page goes; ``output``, too, if None.
        jobs: Number of runs side by side.

    Returns:
        The exit code; 3 if a run failed, without claims and figures.
    """
    campaign, console = campaign_of(folder, overrides), Console()
    try:
        runs = run_members(campaign.members, output, Cluster(jobs=jobs), console)
    except KeyboardInterrupt:
        console.problem(f"interrupted; to go on, repeat the command ({output} has what is done)")
        return INTERRUPTED
    if code := exit_code(runs):
        console.problem("claims and figures need all runs")
        return code
    results = Results(output)
    measured, compared = claims(campaign, results), compare(campaign, results)
    for claim in (*measured, finding(compared)):
        console.say(text_of(claim))
    page = write_page(campaign, results, measured, compared, docs or output, console)
    console.say(f"the page: {page}")
    return 0


def text_of(claim: Claim) -> str:
    """Return a claim, its measures and the verdict as text."""
    lines = [f"\n{claim.number}. {claim.sentence} ({claim.figures})"]
    for measure in claim.measures:
        mark = "" if measure.holds else "  <- not so"
        lines.append(f"   {measure.what}: {measure.shown} (asked: {measure.asked}){mark}")
    return "\n".join([*lines, f"   {claim.verdict}"])


def write_page(
    campaign: Campaign,
    results: Results,
    measured: Sequence[Claim],
    compared: Compared,
    docs: Path,
    console: Console,
) -> Path:
    """Draw the figures and write the page with its account; return the page."""
    from paper.draw import draw_cycle, draw_elements, draw_figures
    from paper.page import account_of, account_of_elements, page

    origin, folder = _origin(campaign, results), docs / "paper"
    widths: dict[int, float] = {}
    for number, width in draw_figures(results, folder, origin):
        console.say(f"figure {number}")
        widths[number] = width
    draw_cycle(results, folder, origin)
    elements = account_of_elements(
        compared,
        finding(compared),
        dict(draw_elements(campaign, results, compared, folder, origin)),
    )
    account = account_of(campaign, results, measured, widths, origin) | {"elements": elements}
    write_whole(folder / "account.json", json.dumps(account, indent=1) + "\n")
    write_whole(docs / "paper.md", page(account))
    return docs / "paper.md"


def _origin(campaign: Campaign, results: Results) -> Provenance:
    """Return this command, and the commits that made the runs and the rest."""
    here = this_process()
    made = [of_summary(results.summary(member.name)) for member in campaign.members]
    commits = (Provenance("", run.commit) for run in made if run)
    return reduce(Provenance.then, [*commits, here])


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
