"""How time and memory grow with the unknowns, and what a second rank brings and could bring."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from benchmarks.figure import Figure
from benchmarks.probe import Sample, sample
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
    samples = []
    for size in SIZES:
        samples.append(_run(size))
        s = samples[-1]
        print(
            f"{s.unknowns:8d} unknowns {s.seconds / s.steps:8.2f} s a step "
            f"({s.iterations / s.steps:.1f} iterations) {s.memory / 1e6:8.0f} MB",
            flush=True,
        )
    unknowns = [s.unknowns for s in samples]
    seconds = Law.fitted(unknowns, [s.seconds / s.iterations for s in samples])
    memory = Law.fitted(unknowns, [s.memory for s in samples])
    _draw(samples, seconds, memory)
    print(f"picture: {PICTURE}")
    one, two = _compared()
    with ThreadPoolExecutor(2) as pool:
        slower = max(s.seconds for s in pool.map(_run, (COMPARED, COMPARED))) / one.seconds
    print(
        f"two runs at once, of 1 rank each, take {slower:.2f} times as long as one by itself: "
        f"on this machine 2 ranks can be {2 / slower:.2f} times as fast as 1"
    )
    renewed = _run(COMPARED, settings=("solver.factor=renewed",))
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
        for ranks, found in runs.items():
            found.append(_run(COMPARED, ranks))
    for ranks, found in runs.items():
        print(f"ranks {ranks}: " + ", ".join(f"{s.seconds:.1f}" for s in found) + " s", flush=True)
    one, two = (min(found, key=lambda s: s.seconds) for found in runs.values())
    return one, two


def _run(size: float, ranks: int = 1, settings: tuple[str, ...] = ()) -> Sample:
    return sample((f"discretisation.mesh_size={size}mm", *STEPS, *settings), ranks)


def _draw(samples: list[Sample], seconds: Law, memory: Law) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(8, 3.2), layout="constrained")
    x = [s.unknowns for s in samples]
    for axis, values, law, name in (
        (axes[0], [s.seconds / s.iterations for s in samples], seconds, "time of an iteration (s)"),
        (axes[1], [s.memory / 1e6 for s in samples], memory, "memory (MB)"),
    ):
        scale = 1e-6 if axis is axes[1] else 1.0
        axis.loglog(x, values, "o", color="C0")
        axis.loglog(x, [scale * law(n) for n in x], color="C1", label=f"N^{law.power:.2f}")
        axis.set(xlabel="unknowns", ylabel=name)
        axis.legend(frameon=False)
    PICTURE.parent.mkdir(exist_ok=True)
    figure.savefig(PICTURE, dpi=150)
    plt.close(figure)
