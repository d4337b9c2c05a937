"""What an accuracy costs: the slip cycle within 0.1 % and 0.01 %, the default case within 1 %.

Steps by BDF of third order, cells and steps as the accuracy allows; for 0.01 % they are searched.
"""

from __future__ import annotations

from tempfile import TemporaryDirectory

from benchmarks.figure import Figure
from benchmarks.probe import CASE, sample
from wovenfab.record.summary import read_summary
from wovenfab.study.runner import Command, execute

ONE = ("program.amplitudes=40 mm",)
SMALL, SMALL_RANKS = 1e-4, 2
SEARCHED = (f"accuracy={SMALL}", "discretisation=null", "time=null", "output.pictures=false")


def _with(degree: int, size: int, steps: int) -> tuple[str, ...]:
    return (
        f"discretisation.degree={degree}",
        f"discretisation.mesh_size={size} mm",
        "time.scheme=bdf3",
        f"time.steps_per_cycle={steps}",
    )


FINE = _with(4, 50, 160)


def accuracy_cost() -> list[Figure]:
    """Return time and error of both against cells and steps that are much finer."""
    figures = []
    for name, program, settings, ranks, accuracy, seconds in (
        ("slip cycle within 0.1 %", ONE, _with(4, 75, 48), 1, 0.1, 6.0),
        ("default case within 1 %", (), _with(3, 100, 24), 2, 1.0, 4.0),
    ):
        run, finer = sample((*program, *settings), ranks=ranks), sample((*program, *FINE))
        pairs = (run.force, finer.force), (run.dissipated, finer.dissipated)
        errors = [100 * abs(a / b - 1) for a, b in pairs]
        of = f"{run.unknowns} unknowns and {run.steps} steps, {ranks} rank{'s' * (ranks > 1)}"
        against = f"against {finer.unknowns} unknowns and {finer.steps} steps"
        figures += [
            Figure(f"{name}, time", run.seconds, seconds, "s", f"once compiled, {of}"),
            Figure(
                f"{name}, error", max(errors), accuracy, "%",
                f"peak force and losses: {', '.join(f'{e:.2g} %' for e in errors)}, {against}",
            ),
        ]  # fmt: skip
    return [*figures, *_searched()]


def _searched() -> list[Figure]:
    """Return time and stated error of the slip cycle with an accuracy, from nothing compiled."""
    with TemporaryDirectory() as folder:
        chosen = [word for text in (*ONE, *SEARCHED) for word in ("--set", text)]
        command = ["-m", "wovenfab", "run", str(CASE), "-o", f"{folder}/run", *chosen]
        ended = execute(Command(command, SMALL_RANKS, environment={"XDG_CACHE_HOME": folder}))
        if ended.failure:
            raise RuntimeError(ended.failure)
        summary = read_summary(f"{folder}/run")
    said = summary["accuracy"]["figures"]
    stated = {name: figure["relative_error"] for name, figure in said.items()}
    errors = {name: 100 * error for name, error in stated.items() if error is not None}
    of = f"{summary['unknowns']} unknowns and {summary['steps']} steps, {SMALL_RANKS} ranks"
    rest = "".join(f", {name} not known" for name in stated.keys() - errors)
    name = f"slip cycle within {100 * SMALL:g} %"
    return [
        Figure(f"{name}, time", ended.seconds, 180.0, "s", f"with search and compiling, {of}"),
        Figure(
            f"{name}, error", max(errors.values()), 100 * SMALL, "%",
            f"as stated, {', '.join(f'{figure} {e:.2g} %' for figure, e in errors.items())}{rest}",
        ),
    ]  # fmt: skip
