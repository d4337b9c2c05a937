"""The default case: its time once compiled, its Newton iterations, and its error."""

from __future__ import annotations

from benchmarks.figure import Figure
from benchmarks.probe import sample

FINER = ("discretisation.degree=4", "discretisation.mesh_size=50mm", "time.steps_per_cycle=160")


def default() -> list[Figure]:
    """Return time and iterations of the three cycles on one rank and on two, and their error."""
    one, two, finer = sample(), sample(ranks=2), sample(FINER)
    each = sample(("solver.factor=renewed",))
    errors = [
        abs(a / b - 1) for a, b in ((one.force, finer.force), (one.dissipated, finer.dissipated))
    ]
    print(f"1 rank: {one.seconds:.1f} s, 2 ranks: {two.seconds:.1f} s")
    return [
        Figure(
            "default case once compiled",
            min(one.seconds, two.seconds),
            30.0,
            "s",
            f"three cycles on the quicker of 1 rank ({one.seconds:.1f} s) and 2 "
            f"({two.seconds:.1f} s), {one.unknowns} unknowns, {one.steps} steps",
        ),
        Figure(
            "iterations a step", one.iterations / one.steps, 3.0, "", "mean of the default case"
        ),
        Figure(
            "error of the default case",
            100 * max(errors),
            1.0,
            "%",
            f"peak force and losses: {', '.join(f'{100 * e:.2g} %' for e in errors)}, against "
            f"{finer.unknowns} unknowns and {finer.steps} steps",
        ),
        Figure(
            "a tangent and factor for each iteration over kept ones",
            each.seconds / one.seconds,
            1.0,
            "x",
            f"{each.seconds:.1f} s with {each.iterations} iterations over {one.seconds:.1f} s with "
            f"{one.iterations}, 1 rank",
            at_least=True,
        ),
    ]
