"""``wovenfab effects``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from wovenfab.case import Case, read_case
from wovenfab.commands.voice import Voice, is_first_rank


def study_effects(path: Path, output: Path | None, overrides: Sequence[str]) -> int:
    """Measure the scene with all effects, without each and with each alone; collective."""
    case = read_case(path, overrides)
    from mpi4py import MPI

    from wovenfab.report.costs import draw_costs
    from wovenfab.study.effects import Row, markdown, study, write_csv

    voice = Voice()

    def tell(row: Row) -> None:
        if row.cost is None:
            voice.say(f"{row.scene}: not well posed: {row.refused}")
        else:
            c = row.cost
            voice.say(
                f"{row.scene}: {c.unknowns} unknowns, {c.compile:.1f} s to compile, "
                f"{1e3 * c.step:.0f} ms a step, peak force {c.peak_force:.5g} N, "
                f"dissipated {c.dissipated:.4g} J"
            )

    def read(kept: Sequence[str]) -> Case:
        left_out = [name for name in case.effects if name not in kept]
        return read_case(path, [*overrides, *(f"effects.{name}=null" for name in left_out)])

    rows = study(tuple(case.effects), read, MPI.COMM_WORLD, tell)
    if is_first_rank():
        directory = output or Path("results") / f"{case.name}-effects"
        directory.mkdir(parents=True, exist_ok=True)
        write_csv(rows, directory / "effects.csv")
        (directory / "effects.md").write_text(markdown(rows), encoding="utf-8")
        draw_costs(rows, directory / "effects.png")
        voice.say(f"\n{markdown(rows)}\ntable and chart: {directory}")
    return 0
