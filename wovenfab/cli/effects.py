"""``wovenfab effects``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from wovenfab.case import read_case
from wovenfab.cli.console import Console, is_first_rank


def study_effects(path: Path, output: Path | None, overrides: Sequence[str]) -> int:
    """Measure the scene with all effects, without each and with each alone; collective."""
    case = read_case(path, overrides)
    from mpi4py import MPI

    from wovenfab.report.study_pictures import draw_costs
    from wovenfab.study.effects import line, printed, study, write_table

    console = Console()
    rows = study(case, MPI.COMM_WORLD, lambda row: console.say(line(row)))
    if is_first_rank():
        directory = output or Path("results") / f"{case.name}-effects"
        directory.mkdir(parents=True, exist_ok=True)
        write_table(rows, directory / "effects.csv")
        (directory / "effects.md").write_text(printed(rows), encoding="utf-8")
        draw_costs(rows, directory / "effects.png")
        console.say(f"\n{printed(rows)}\ntable and chart: {directory}")
    return 0
