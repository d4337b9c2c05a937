"""``python -m benchmarks.random_page``: the rows of ``make random`` as a page and a picture.

It prints the weights from which ``wovenfab check`` expects a time, fitted to the rows, and fails
where a figure is missed.
"""

from __future__ import annotations

import sys
from math import exp, log, sqrt
from pathlib import Path

import numpy as np
from matplotlib import figure as mpl

from benchmarks.figure import Figure
from benchmarks.random_scenes import (
    ACCURACY,
    COUNT,
    FINER_ACCURACY,
    IN_ALL,
    LIMIT,
    MORE,
    RANKS,
    RESULTS,
    ROOT,
    SEED,
    WANTED,
    Row,
    commits,
    honesty,
    list_of,
    name_of,
    scene,
    table,
)
from wovenfab.case import Case, Rectangle, read_case
from wovenfab.record.results import markdown
from wovenfab.report.style import APART, house_style, save
from wovenfab.study.errors.report import expected_seconds
from wovenfab.study.response import is_set_valued
from wovenfab.study.runner import Store

PAGE = ROOT / "docs" / "random-fabrics.md"
PICTURE = ROOT / "docs" / "pictures" / "random-fabrics.png"
#: Factor within which a time counts as expected; resolution of the picture (1/in).
FACTOR, DPI = 3.0, 90
#: Times with a label, s.
TICKS = (6, 8, 10, 15, 20, 30, 40, 60, 90)
#: Percentage of the scenes of a kind that the page says the longest time of.
MOST = 90
#: Percentages of scenes that must reach each accuracy in time, and whose time `check` expects;
#: largest share of the search in the time (%).
REACHED, REACHED_FINER, FORESEEN, SEARCH = 95.0, 90.0, 90.0, 50.0
#: Head of the table of what an accuracy costs.
COSTS = ["accuracy", "what the fabric has", "half within", "nine of ten within", "wanted within",
         "reached by then"]  # fmt: skip
QUARTERS = 4
#: Lengths that elements may have to resolve: stiffnesses whose ratio's root they are.
LENGTHS = (("bending", "stretch"), ("bending", "shear"), ("stretch", "coupling"))
KINDS = ("one placement, elastic", "one placement, friction", "two placements, elastic",
         "two placements, friction", "Coulomb's law")  # fmt: skip


def rows_and_cases(accuracy: float) -> tuple[list[Row], list[Case]]:
    """Return what is stored for an accuracy."""
    store, rows, cases = Store(RESULTS.resolve()), list[Row](), list[Case]()
    for number in range(1, COUNT + 1):
        name = name_of(number, SEED, accuracy)
        if known := store.load(name):
            folder = store.folder / name
            rows.append(Row(**known))
            cases.append(read_case(scene(number, SEED, folder, accuracy)))
    return rows, cases


def kind_of(case: Case) -> str:
    """Return what makes a case hard, in words."""
    if is_set_valued(case):
        return KINDS[-1]
    return KINDS[2 * (case.needs.placements - 1) + case.needs.history]


def fitted(cases: list[Case], seconds: list[float]) -> str:
    """Return the usual time for 1 %, its factor with a set-valued law, and the accuracy's power."""
    finer = [log(ACCURACY / case.accuracy) for case in cases if case.accuracy]
    known = np.column_stack([np.ones(len(cases)), [is_set_valued(c) for c in cases], finer])
    (usual, slower, power), *_ = np.linalg.lstsq(known, np.log(seconds), rcond=None)
    return f"{exp(usual):.2g} s, {exp(slower):.2g} times, power {power:.2g}"


def draw(rows: list[Row], kinds: list[str]) -> mpl.Figure:
    """Return time against stated error, a dot a scene."""
    figure = mpl.Figure((6.4, 3.6), layout="constrained")
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


def costs(rows: list[Row], kinds: list[str], accuracy: float, wanted: float) -> list[list[str]]:
    """Return what an accuracy costs as cells of a table: a line a kind, and one of all."""
    lines = []
    for kind in (*KINDS, ""):
        own = [r for r, k in zip(rows, kinds, strict=True) if kind in ("", k)]
        if own:
            good = sum(r.reaches(accuracy, wanted) for r in own)
            half, most = np.percentile([r.seconds for r in own], [50, MOST])
            times = [f"{seconds:.0f} s" for seconds in (half, most, wanted)]
            count = f"{good} of {len(own)}"
            lines.append([f"{100 * accuracy:g} %", kind or "all", *times, count])
    return lines


def said_so(rows: list[Row]) -> str:
    """Return in a sentence after how long searches say that an accuracy is not reached."""
    times = [row.pilot for row in rows if row.fell_short and row.unknowns]
    if not times:
        return f"All searches found what reaches {100 * ACCURACY:g} %."
    early = sum(time <= WANTED for time in times)
    return (
        f"Of those that fell short the search, which says so at its end, took {min(times):.0f} to "
        f"{max(times):.0f} s: {early} of {len(times)} at most {WANTED:g} s."
    )


def length_of(case: Case, strong: str, weak: str) -> float | None:
    """Return the root of the ratio of two stiffnesses over a rectangle's width, if it has them."""
    stiffness = {e.effect.name: e.values.get("stiffness") for e in case.scene}
    if not isinstance(case.sheet, Rectangle) or not {strong, weak} <= set(stiffness):
        return None
    one, other = (float(np.mean(stiffness[name])) for name in (strong, weak))  # of both families
    return sqrt(one / other) / case.sheet.width


def what_is_hard(rows: list[Row], cases: list[Case]) -> str:
    """Return unknowns by quarters of the scenes in the order of each length, as a table.

    Below it is said on which length they depend most.
    """
    lines, most = [], []
    for placements in (1, 2):
        factors: dict[str, float] = {}
        for pair in LENGTHS[: 1 + placements]:
            known = [
                (length, row.unknowns)
                for row, case in zip(rows, cases, strict=True)
                if case.needs.placements == placements
                and row.is_good
                and (length := length_of(case, *pair)) is not None
            ]
            if len(known) < QUARTERS:
                continue
            quarters = np.array_split(np.array(sorted(known)), QUARTERS)
            name = f"({pair[0]} / {pair[1]})^1/2"
            middle = [float(np.median(q[:, 1])) for q in quarters]
            ranges = [f"({q[0, 0]:.2g} to {q[-1, 0]:.2g})" for q in quarters]
            cells = [f"{m:.0f} {r}" for m, r in zip(middle, ranges, strict=True)]
            lines.append([str(placements), name, *cells])
            factors[name] = middle[0] / middle[-1]
        if factors:
            name, factor = max(factors.items(), key=lambda item: item[1])
            most.append(f"with {placements}, {factor:.2g} times as many where {name} is shortest")
    head = ["placements", "length", "shortest", "short", "long", "longest"]
    words = f"Number of placements and the length that matters most: {'; '.join(most)}."
    return f"{markdown(head, lines)}\n\n{words}"


def figures(rows: list[Row], finer: list[Row], foreseen: int) -> list[Figure]:
    """Return what must not be missed.

    Args:
        rows: Of the usual accuracy.
        finer: Of the smaller one; there may be none.
        foreseen: Number of rows whose time was expected.
    """

    def of_all(count: int, rows: list[Row]) -> float:
        return 100 * count / len(rows)

    kept = []
    wanted = ((ACCURACY, rows, WANTED, REACHED), (FINER_ACCURACY, finer, LIMIT, REACHED_FINER))
    for accuracy, made, seconds, share in wanted:
        if made:
            name = f"{100 * accuracy:g} % within {seconds:g} s"
            reached = of_all(sum(r.reaches(accuracy, seconds) for r in made), made)
            honest = of_all(sum(r.is_honest for r in made), made)
            more = f"true error at most {MORE:g} % above the stated one, where it is known"
            kept += [
                Figure(name, reached, share, "%", f"of {len(made)} scenes", at_least=True),
                Figure(f"{100 * accuracy:g} %, honest", honest, 100.0, "%", more, at_least=True),
            ]
    late = max((r.pilot for r in rows if r.fell_short and r.unknowns), default=0.0)
    search = float(np.median([100 * r.pilot / r.seconds for r in rows]))
    return [
        *kept,
        Figure(
            "longest search that fell short", late, WANTED, "s",
            f"for {100 * ACCURACY:g} %, with compiling",
        ),
        Figure(
            "share of the search in the time", search, SEARCH, "%",
            "in the middle, with compiling",
        ),
        Figure(
            f"time that check expects within a factor of {FACTOR:g}",
            of_all(foreseen, rows), FORESEEN, "%", "of the scenes", at_least=True,
        ),
    ]  # fmt: skip


def main() -> int:
    """Write page and picture, print the fit and the figures, and return the exit code."""
    rows, cases = rows_and_cases(ACCURACY)
    finer, finer_cases = rows_and_cases(FINER_ACCURACY)
    kinds = [kind_of(case) for case in cases]
    expected = [expected_seconds(case) / row.seconds for case, row in zip(cases, rows, strict=True)]
    near = sum(1 / FACTOR <= ratio <= FACTOR for ratio in expected)
    words = (
        f"`wovenfab check` expects the time within a factor of {FACTOR:g} in {near} of {len(rows)}."
    )
    with house_style():
        save(draw(rows, kinds), PICTURE, dpi=DPI)
    for_finer = f", {len(finer)} for {100 * FINER_ACCURACY:g} %," if finer else ""
    head = (
        f"# {100 * ACCURACY:g} % on fabrics drawn at random\n\nWritten by `make random`: "
        f"{len(rows)} scenes of seed {SEED}, each run for `accuracy: {100 * ACCURACY:g} %`"
        f"{for_finer} on {RANKS} ranks, with nothing compiled before. "
        "Times are those of one machine with two processors, where other work may have been going "
        "on; `wovenfab check` says what they are on that machine, about. "
        "`python3 -m benchmarks.random_page` draws the picture and fits the times.\n\n"
        f"![Time against stated error](pictures/{PICTURE.name})\n\n"
    )
    share = np.median([row.pilot / row.seconds for row in rows])
    also = f"The search and its compiling took {100 * share:.0f} % of the time in the middle."
    also += f" {said_so(rows)}"
    lines = costs(rows, kinds, ACCURACY, WANTED)
    lines += costs(finer, [kind_of(case) for case in finer_cases], FINER_ACCURACY, LIMIT)
    hard = (
        "## What makes it hard\n\nUnknowns that 1 % took, in the middle of each quarter of the "
        "rectangles in the order of a length over the width (in brackets):\n\n"
        f"{what_is_hard(rows, cases)}\n\n## All scenes\n\n"
        f"All have {IN_ALL.rstrip(', ')}.\n\n"
    )
    cost = markdown(COSTS, lines, (0, 1))
    text = f"{head}{cost}\n\n{words} {also}\n\n{hard}{table(rows)}\n"
    if short := [r for r in finer if not r.reaches(FINER_ACCURACY, LIMIT)]:
        text += f"\n## Where {100 * FINER_ACCURACY:g} % was not reached\n\n{list_of(short)}\n"
    if finer:
        text += f"\n{honesty(finer, FINER_ACCURACY)}\n{commits(finer)}\n"
    PAGE.write_text(text, encoding="utf-8")
    every, known = [*rows, *finer], [*cases, *finer_cases]
    print("trials:", fitted(known, [r.pilot for r in every]))
    print("run:", fitted(known, [max(r.seconds - r.pilot, 0.1) for r in every]))
    print(f"{words}\npage: {PAGE.relative_to(Path.cwd())}")
    measured = figures(rows, finer, near)
    print("== figures", *measured, sep="\n")
    return 0 if all(figure.kept for figure in measured) else 1


if __name__ == "__main__":
    sys.exit(main())
