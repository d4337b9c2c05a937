"""``python -m benchmarks.random_page``: the rows of ``make random`` as a page and a picture.

It prints the weights from which ``wovenfab check`` expects a time, fitted to the rows.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.random_scenes import (
    ACCURACY,
    COUNT,
    FINER_ACCURACY,
    RANKS,
    RESULTS,
    ROOT,
    SEED,
    WANTED,
    Row,
    name_of,
    scene,
    table,
)
from wovenfab.case import Case, read_case
from wovenfab.report.style import APART, house_style, save
from wovenfab.study.runner import Store
from wovenfab.study.target_accuracy.choice import expected_seconds, traits

PAGE = ROOT / "docs" / "random-fabrics.md"
PICTURE = ROOT / "docs" / "pictures" / "random-fabrics.png"
#: Factor within which a time counts as expected; resolution of the picture (1/in).
FACTOR, DPI = 3.0, 90
#: Times with a label, s.
TICKS = (15, 20, 30, 40, 60, 90)
#: Share of scenes of a kind that the page says the time of.
MOST = 90
KINDS = ("one placement, elastic", "one placement, friction", "two placements, elastic",
         "two placements, friction", "Coulomb's law")  # fmt: skip


def rows_and_cases(accuracy: float) -> tuple[list[Row], list[Case]]:
    """Return what is stored for an accuracy."""
    store, rows, cases = Store(RESULTS.resolve()), list[Row](), list[Case]()
    for number in range(1, COUNT + 1):
        name = name_of(number, SEED, accuracy)
        if known := store.load(name):
            rows.append(Row(**known))
            cases.append(read_case(scene(number, SEED, store.folder / name, accuracy)))
    return rows, cases


def kind_of(case: Case) -> str:
    """Return what makes a case hard, in words."""
    _, two, history, at_points, *_ = traits(case)
    if at_points:
        return KINDS[-1]
    return KINDS[2 * int(two) + int(history)]


def fitted(cases: list[Case], seconds: list[float]) -> list[float]:
    """Return the weights of the traits that tell the logarithm of times best; zero of no trait."""
    known = np.array([traits(case) for case in cases])
    weights, *_ = np.linalg.lstsq(known, np.log(seconds), rcond=None)
    return [round(float(w), 2) for w in weights]


def draw(rows: list[Row], kinds: list[str]) -> Figure:
    """Return time against stated error, a dot a scene."""
    figure = Figure((6.4, 3.6), layout="constrained")
    axes = figure.subplots()
    for kind, colour in zip(KINDS, APART, strict=False):
        dots = [(r.seconds, 100 * r.stated) for r, k in zip(rows, kinds, strict=True)
                if k == kind and r.stated]  # fmt: skip
        axes.plot(*np.transpose(dots or [(np.nan, np.nan)]), "o", color=colour, ms=4, label=kind)
    axes.axhline(100 * ACCURACY, color="0.6", lw=0.8)
    axes.axvline(WANTED, color="0.6", lw=0.8)
    axes.set(xscale="log", yscale="log", xlabel="time (s)", ylabel="stated error (%)")
    axes.set_xticks(TICKS, [str(tick) for tick in TICKS])
    axes.minorticks_off()
    axes.legend(fontsize=7)
    return figure


def sentences(rows: list[Row], kinds: list[str]) -> str:
    """Return what the accuracy costs, by kind."""
    lines = []
    for kind in KINDS:
        times = [r.seconds for r, k in zip(rows, kinds, strict=True) if k == kind]
        if times:
            good = sum(r.is_good for r, k in zip(rows, kinds, strict=True) if k == kind)
            half, most = np.percentile(times, [50, MOST])
            lines.append(
                f"- {kind}: {half:.0f} s in the middle, {most:.0f} s for nine of ten; {good} of "
                f"{len(times)} within {100 * ACCURACY:g} % and {WANTED:g} s."
            )
    return "\n".join(lines)


def main() -> None:
    """Write page and picture, and print the fit."""
    rows, cases = rows_and_cases(ACCURACY)
    finer, finer_cases = rows_and_cases(FINER_ACCURACY)
    kinds = [kind_of(case) for case in cases]
    expected = [expected_seconds(c) / r.seconds for c, r in zip(cases, rows, strict=True)]
    near = sum(1 / FACTOR <= ratio <= FACTOR for ratio in expected)
    words = (
        f"`wovenfab check` expects the time within a factor of {FACTOR:g} in {near} of {len(rows)}."
    )
    with house_style():
        save(draw(rows, kinds), PICTURE, dpi=DPI)
    head = (
        f"# {100 * ACCURACY:g} % on fabrics drawn at random\n\nWritten by `make random`: "
        f"{len(rows)} scenes of seed {SEED}, each run for `accuracy: {100 * ACCURACY:g} %` on "
        f"{RANKS} ranks, with nothing compiled before. Times are those of one machine with two "
        "processors, where other work may have been going on. "
        "`python3 -m benchmarks.random_page` draws the picture and fits the times.\n\n"
        f"![Time against stated error](pictures/{PICTURE.name})\n\n"
    )
    more = sum(not r.reason and (r.stated or 1.0) <= FINER_ACCURACY for r in finer)
    also = f"{100 * FINER_ACCURACY:g} % was reached in {more} of the first {len(finer)} scenes" + (
        f", in {np.median([r.seconds for r in finer]):.0f} s in the middle." if finer else "."
    )
    text = f"{head}{sentences(rows, kinds)}\n\n{words} {also}\n\n{table(rows)}\n"
    PAGE.write_text(text, encoding="utf-8")
    every, known = [*rows, *finer], [*cases, *finer_cases]
    print("TRIALS", fitted(known, [r.pilot for r in every]))
    print("RUN", fitted(known, [max(r.seconds - r.pilot, 0.1) for r in every]))
    print(f"{words}\npage: {PAGE.relative_to(Path.cwd())}")


if __name__ == "__main__":
    main()
