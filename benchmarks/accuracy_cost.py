"""What an accuracy costs at least: the slip cycle within 0.1 %, and the default case within 1 %.

Steps by BDF of third order, cells and steps as the accuracy allows.
"""

from __future__ import annotations

from benchmarks.figure import Figure
from benchmarks.probe import sample

ONE = ("program.amplitudes=40 mm",)


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
    return figures
