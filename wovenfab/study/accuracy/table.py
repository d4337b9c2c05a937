"""An accuracy study in tables: every run as CSV, and the answers in Markdown."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from io import StringIO
from math import isfinite
from pathlib import Path
from typing import Any

from wovenfab.record.results import write_whole
from wovenfab.study.accuracy.ladder import Best, orders_towards
from wovenfab.study.accuracy.measure import DISSIPATED, PEAK_FORCE, RMS_BETA
from wovenfab.study.accuracy.study import Run, Study, ladders_of

TABLE = "accuracy.csv"
#: Name, unit and factor from SI of each quantity, as people read them.
QUANTITIES = {
    PEAK_FORCE: ("peak force", "N", 1.0),
    DISSIPATED: ("energy dissipated per cycle", "J", 1.0),
    RMS_BETA: ("rms beta", "mm", 1e3),
}
_STAGES = {
    "space": "Space",
    "time": "Time",
    "both": "Both together",
}


def write_csv(found: Study, directory: Path) -> Path:
    """Write one row a run in SI units, failed ones too; return the file."""
    names = list(found.best.get("space", {}))
    rows = [_row(found, run) for run in (*found.runs, *found.failed)]
    header = ["stage", "method", "setting", "unknowns", "steps", "newton_iterations", "tangents"]
    header += ["cutbacks", "wall_s", "setup_s", "stepping_s", "compile_s", "peak_memory_B", *names]
    header += [
        f"{kind}_{name[: name.rindex('_')]}" for kind in ("error", "order") for name in names
    ]
    stream = StringIO()
    writer = csv.DictWriter(stream, [*header, "failure"], lineterminator="\n", restval="")
    writer.writeheader()
    writer.writerows(rows)
    write_whole(directory / TABLE, stream.getvalue())
    return directory / TABLE


def _row(found: Study, run: Run) -> dict[str, Any]:
    m, setting = run.measured, run.setting
    row: dict[str, Any] = {
        "stage": setting.stage,
        "method": setting.method,
        "setting": setting.what,
        "unknowns": m.unknowns,
        "steps": m.steps,
        "newton_iterations": m.iterations,
        "tangents": m.tangents,
        "cutbacks": m.cutbacks,
        "wall_s": round(m.wall, 3),
        "setup_s": round(m.setup, 3),
        "stepping_s": round(m.stepping, 3),
        "compile_s": round(m.compile, 2),
        "peak_memory_B": m.memory,
        "failure": m.failure,
    }
    if not m.failure:
        row |= m.values
        row |= {f"error_{_short(n)}": f"{e:.3e}" for n, e in found.errors(run).items()}
        row |= {f"order_{_short(n)}": o for n, o in orders(found, run).items()}
    return row


def orders(found: Study, run: Run) -> dict[str, str]:
    """Return the observed order of each quantity from the run before on the same ladder.

    In 1/sqrt(unknowns), 1/steps or sqrt(tolerance), towards the best answer; none where that
    is no better known than the run, and of combinations.
    """
    stage = run.setting.stage
    runs = {"space": found.space, "time": found.time}.get(stage, [])
    mine = [r for r in runs if r.setting.method == run.setting.method]
    result: dict[str, str] = {}
    if run not in mine[1:]:
        return result
    place = mine.index(run)
    for name, best in found.best[stage].items():
        if found.errors(run)[name] > 2 * best.relative:
            order = orders_towards(best.value, ladders_of(mine, name)[0])[place - 1]
            result[name] = "" if order is None else f"{order:.1f}"
    return result


def answers(found: Study) -> str:
    """Return the best answers and the cheapest settings in Markdown."""
    parts = [_best(found), _cheapest(found)]
    return "\n\n".join(parts)


def _best(found: Study) -> str:
    lines = ["| quantity | best answer | its error, estimated | by | checked by |"]
    lines += ["|---|---:|---:|---|---|"]
    for name, best in found.best.get(found.final, {}).items():
        title, unit, factor = QUANTITIES[name]
        lines.append(
            f"| {title} | {_digits(best, factor)} {unit} | {percent(best.relative)} | "
            f"{best.method} | {best.check or 'nothing'} |"
        )
    return "\n".join(lines)


def _digits(best: Best, factor: float) -> str:
    """Return the value with a digit more than its error leaves."""
    digits = 7 if not best.relative else 1
    while digits < 8 and best.relative < 10.0 ** (-digits):
        digits += 1
    return f"{best.value * factor:.{min(digits + 1, 8)}g}"


def _cheapest(found: Study) -> str:
    lines = ["| within | cheapest setting | error | unknowns | steps | wall | peak memory |"]
    lines += ["|---:|---|---:|---:|---:|---:|---:|"]
    for target, run in found.chosen.items():
        if run is None:
            lines.append(f"| {percent(target)} | not proven in this time | | | | | |")
            continue
        m = run.measured
        errors = ", ".join(said(found, run).values())
        lines.append(
            f"| {percent(target)} | {run.setting.label} | {errors} | {m.unknowns} | {m.steps} | "
            f"{m.wall:.1f} s | {m.memory / 1e6:.0f} MB |"
        )
    return "\n".join(lines)


def ladders(found: Study) -> str:
    """Return all runs by stage as tables in Markdown, with errors and observed orders."""
    return "\n\n".join(
        f"**{_STAGES[stage]}**\n\n{_runs(found, runs)}"
        for stage, runs in (("space", found.space), ("time", found.time), ("both", found.both))
        if runs
    )


def _runs(found: Study, runs: Sequence[Run]) -> str:
    names = list(found.best["space"])
    titles = [f"{QUANTITIES[name][0]}: error (order)" for name in names]
    lines = ["| setting | unknowns | steps | iterations | wall (s) | memory (MB) | "]
    lines[0] += " | ".join(titles) + " |"
    lines.append("|---|" + "---:|" * (5 + len(names)))
    for run in sorted(runs, key=lambda r: (r.setting.method, -r.size)):
        m, observed = run.measured, orders(found, run)
        errors = [
            error + (f" ({observed[name]})" if observed.get(name) else "")
            for name, error in said(found, run).items()
        ]
        lines.append(
            f"| {run.setting.label} | {m.unknowns} | {_steps(run)} | {m.iterations} | "
            f"{m.wall:.1f} | {m.memory / 1e6:.0f} | " + " | ".join(errors) + " |"
        )
    return "\n".join(lines)


def _steps(run: Run) -> str:
    """Return the number of steps, and of those that were cut back if there are any."""
    cut = run.measured.cutbacks
    return f"{run.measured.steps}" + (f" ({cut} cut back)" if cut else "")


def percent(share: float) -> str:
    """Return a share in percent, with two digits."""
    return f"{100 * share:.2g} %" if isfinite(share) else "unknown"


def said(found: Study, run: Run) -> dict[str, str]:
    """Return each error in words; an upper bound where the best answer is no better known."""
    best, bounds = found.best[run.setting.stage], found.bounds(run)
    return {
        name: percent(error) if error > best[name].relative else f"≤ {percent(bounds[name])}"
        for name, error in found.errors(run).items()
    }


def _short(name: str) -> str:
    return name[: name.rindex("_")]
