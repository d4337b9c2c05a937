"""How time and memory grow with the unknowns, and what a second rank brings and could bring."""

from __future__ import annotations

from pathlib import Path

from benchmarks.figure import Figure
from benchmarks.probe import Sample, samples
from benchmarks.textbook import Law

#: Cell sizes (mm): about 5k, 20k, 80k, 200k and 500k unknowns at degree 3.
SIZES = (65.0, 32.0, 16.0, 10.0, 6.3)
#: The one of 200k unknowns, for which ranks are compared.
COMPARED = 10.0
#: Runs for each number of ranks, of which the fastest counts: they differ by 20 %, with the
#: order in which the direct solver happens to eliminate and with other work of the machine.
RUNS = 3
STEPS = ("program={type: ramp, to: 1.5 mm, steps: 6, duration: 12 ms}",)
PICTURE = Path("results") / "growth.png"


def growth() -> list[Figure]:
    """Print and draw time and memory of a step; return the exponents and the speed-up."""
    grown = []
    for size in SIZES:
        s = _run(size)
        grown.append(s)
        print(
            f"{s.unknowns:8d} unknowns {s.seconds / s.steps:8.2f} s a step "
            f"({s.iterations / s.steps:.1f} iterations) {s.memory / 1e6:8.0f} MB",
            flush=True,
        )
    unknowns = [s.unknowns for s in grown]
    seconds = Law.fitted(unknowns, [s.seconds / s.iterations for s in grown])
    memory = Law.fitted(unknowns, [s.memory for s in grown])
    _draw(grown, seconds, memory)
    print(f"picture: {PICTURE}")
    one, two = _compared()
    slower = max(s.seconds for s in samples([_overrides(COMPARED)] * 2)) / one.seconds
    print(
        f"two runs at once, of 1 rank each, take {slower:.2f} times as long as one by itself: "
        f"on this machine 2 ranks can be {2 / slower:.2f} times as fast as 1"
    )
    renewed = _run(COMPARED, 1, "solver.factor=renewed")
    meaning = f"fit over {unknowns[0]} to {unknowns[-1]} unknowns, degree 3, MUMPS, 1 rank"
    return [
        Figure("growth of the time of an iteration", seconds.power, 1.25, "", meaning),
        Figure("growth of the memory", memory.power, 1.2, "", meaning),
        Figure(
            "2 ranks over 1",
            one.seconds / two.seconds,
            1.6,
            "x",
            f"{one.seconds:.1f} over {two.seconds:.1f} s, {one.unknowns} unknowns",
            at_least=True,
        ),
        Figure(
            "a tangent and factor for each iteration over kept ones",
            renewed.seconds / one.seconds,
            1.0,
            "x",
            f"{renewed.seconds:.1f} over {one.seconds:.1f} s, {one.unknowns} unknowns",
            at_least=True,
        ),
    ]


def _compared() -> tuple[Sample, Sample]:
    """Print runs on 1 and on 2 ranks in turn, for machines change their speed; return the best."""
    runs: dict[int, list[Sample]] = {1: [], 2: []}
    for _ in range(RUNS):
        for ranks, of_ranks in runs.items():
            of_ranks.append(_run(COMPARED, ranks))
    for ranks, of_ranks in runs.items():
        print(
            f"ranks {ranks}: " + ", ".join(f"{s.seconds:.1f}" for s in of_ranks) + " s", flush=True
        )
    one, two = (min(of_ranks, key=lambda s: s.seconds) for of_ranks in runs.values())
    return one, two


def _run(size: float, ranks: int = 1, *settings: str) -> Sample:
    return samples([(*_overrides(size), *settings)], ranks)[0]


def _overrides(size: float) -> tuple[str, ...]:
    return (f"discretisation.mesh_size={size}mm", *STEPS)


def _draw(grown: list[Sample], seconds: Law, memory: Law) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(8, 3.2), layout="constrained")
    x = [s.unknowns for s in grown]
    for axis, values, law, name in (
        (axes[0], [s.seconds / s.iterations for s in grown], seconds, "time of an iteration (s)"),
        (axes[1], [s.memory / 1e6 for s in grown], memory, "memory (MB)"),
    ):
        scale = 1e-6 if axis is axes[1] else 1.0
        axis.loglog(x, values, "o", color="C0")
        axis.loglog(x, [scale * law(n) for n in x], color="C1", label=f"N^{law.power:.2f}")
        axis.set(xlabel="unknowns", ylabel=name)
        axis.legend(frameon=False)
    PICTURE.parent.mkdir(exist_ok=True)
    figure.savefig(PICTURE, dpi=150)
    plt.close(figure)
