"""An accuracy study: its runs and their errors, every run as CSV, and the answers in Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf, isfinite, log
from pathlib import Path
from typing import Any

from wovenfab.record.results import markdown, write_csv
from wovenfab.study.accuracy.errors import Best, Refinement
from wovenfab.study.accuracy.measure import DISSIPATED, PEAK_FORCE, RMS_BETA, Measured
from wovenfab.study.accuracy.settings import Setting

#: Accuracies for which the cheapest setting is sought.
TARGETS = (0.05, 0.01, 0.003, 0.001)
TABLE = "accuracy.csv"
#: Name, unit and factor from SI of each quantity, as people read them.
QUANTITIES = {
    PEAK_FORCE: ("peak force", "N", 1.0),
    DISSIPATED: ("energy dissipated per cycle", "J", 1.0),
    RMS_BETA: ("rms beta", "mm", 1e3),
}
_STAGES = {"space": "Space", "time": "Time", "both": "Both together"}


@dataclass(frozen=True)
class Run:
    """A setting, its results, and the size that goes to zero with ever finer settings."""

    setting: Setting
    measured: Measured
    size: float


@dataclass
class Study:
    """All runs of a study and what follows.

    Attributes:
        space, time, both: Runs of each stage that did not fail.
        failed: The others.
        best: Best answers by stage and quantity; those of ``both`` are the study's answers.
        chosen: For each accuracy the run of the cheapest setting that reaches it, or None.
        spent: Time of all runs, without compilation, s.
    """

    space: list[Run] = field(default_factory=list)
    time: list[Run] = field(default_factory=list)
    both: list[Run] = field(default_factory=list)
    failed: list[Run] = field(default_factory=list)
    best: dict[str, dict[str, Best]] = field(default_factory=dict)
    chosen: dict[float, Run | None] = field(default_factory=dict)
    spent: float = 0.0

    @property
    def runs(self) -> list[Run]:
        """All runs that did not fail."""
        return [*self.space, *self.time, *self.both]

    def errors(self, run: Run) -> dict[str, float]:
        """Return the relative error of each quantity, towards the best of the run's stage."""
        values = run.measured.values
        return {
            name: abs(values[name] - best.value) / abs(best.value) if best.value else inf
            for name, best in self.best.get(run.setting.stage, {}).items()
        }

    def bounds(self, run: Run) -> dict[str, float]:
        """Return each error plus that of the best answer."""
        best = self.best[run.setting.stage]
        return {name: error + best[name].relative for name, error in self.errors(run).items()}

    def within(self, target: float) -> list[Run]:
        """Return the runs of the last stage whose quantities all have at most this error."""
        runs = self.both if self.final == "both" else self.space
        return [r for r in runs if max(self.bounds(r).values(), default=inf) <= target]

    @property
    def final(self) -> str:
        """The stage whose best answers are those of the study."""
        return "both" if "both" in self.best else "space"

    def orders(self, run: Run) -> dict[str, str]:
        """Return the observed order of each quantity from the method's run before.

        In 1/sqrt(unknowns), 1/steps or sqrt(tolerance), towards the best answer; none where that
        is no better known than the run, and of combinations.
        """
        stage = run.setting.stage
        runs = {"space": self.space, "time": self.time}.get(stage, [])
        same = [r for r in runs if r.setting.method == run.setting.method]
        orders: dict[str, str] = {}
        if run not in same[1:]:
            return orders
        before = same[same.index(run) - 1]
        larger, errors = self.errors(before), self.errors(run)
        for name, best in self.best[stage].items():
            if errors[name] > 2 * best.relative and larger[name] > 0:
                order = log(larger[name] / errors[name]) / log(before.size / run.size)
                orders[name] = f"{order:.1f}"
        return orders

    def errors_in_words(self, run: Run) -> dict[str, str]:
        """Return each error; an upper bound where the best answer is no better known."""
        best, bounds = self.best[run.setting.stage], self.bounds(run)
        return {
            name: percent(error) if error > best[name].relative else f"≤ {percent(bounds[name])}"
            for name, error in self.errors(run).items()
        }


def refinements(runs: Sequence[Run], name: str) -> list[Refinement]:
    """Return the values of a quantity by each method, from coarse to fine."""
    result = []
    for method in dict.fromkeys(r.setting.method for r in runs):
        same = [r for r in runs if r.setting.method == method]
        sizes = tuple(r.size for r in same)
        values = tuple(r.measured.values[name] for r in same)
        first = same[0].setting
        result.append(Refinement(method, sizes, values, first.order, first.size is None))
    return result


def write_table(study: Study, directory: Path) -> Path:
    """Write one row a run in SI units, failed ones too; return the file."""
    write_csv(directory / TABLE, [_row(study, run) for run in (*study.runs, *study.failed)])
    return directory / TABLE


def _row(study: Study, run: Run) -> dict[str, Any]:
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
    }
    names, ended = list(study.best.get("space", {})), not m.failure
    errors = {name: f"{e:.3e}" for name, e in study.errors(run).items()} if ended else {}
    orders = study.orders(run) if ended else {}
    row |= {name: m.values.get(name, "") if ended else "" for name in names}
    row |= {f"error_{_without_unit(name)}": errors.get(name, "") for name in names}
    row |= {f"order_{_without_unit(name)}": orders.get(name, "") for name in names}
    return row | {"failure": m.failure}


def _without_unit(name: str) -> str:
    return name[: name.rindex("_")]


def answers(study: Study) -> str:
    """Return the best answers and the cheapest settings in Markdown."""
    quantities = []
    for name, best in study.best.get(study.final, {}).items():
        title, unit, factor = QUANTITIES[name]
        value, error = f"{_digits(best, factor)} {unit}", percent(best.relative)
        quantities.append([title, value, error, best.method, best.check or "nothing"])
    titles = ["quantity", "best answer", "its error, estimated", "by", "checked by"]
    cheapest = [_cheapest(study, target, run) for target, run in study.chosen.items()]
    heads = ["within", "cheapest setting", "error", "unknowns", "steps", "wall", "peak memory"]
    tables = markdown(titles, quantities, (0, 3, 4)), markdown(heads, cheapest, (1,))
    return "\n\n".join(tables)


def _cheapest(study: Study, target: float, run: Run | None) -> list[str]:
    if run is None:
        return [percent(target), "not proven in this time", *[""] * 5]
    m, errors = run.measured, ", ".join(study.errors_in_words(run).values())
    cost = [str(m.unknowns), str(m.steps), f"{m.wall:.1f} s", f"{m.memory / 1e6:.0f} MB"]
    return [percent(target), run.setting.label, errors, *cost]


def _digits(best: Best, factor: float) -> str:
    """Return the value with one digit more than its error allows."""
    digits = 7 if not best.relative else 1
    while digits < 8 and best.relative < 10.0 ** (-digits):
        digits += 1
    return f"{best.value * factor:.{min(digits + 1, 8)}g}"


def tables(study: Study) -> str:
    """Return all runs by stage as tables in Markdown, with errors and observed orders."""
    return "\n\n".join(
        f"**{title}**\n\n{_table(study, runs)}"
        for stage, title in _STAGES.items()
        if (runs := getattr(study, stage))
    )


def _table(study: Study, runs: Sequence[Run]) -> str:
    titles = ["setting", "unknowns", "steps", "iterations", "wall (s)", "memory (MB)"]
    titles += [f"{QUANTITIES[name][0]}: error (order)" for name in study.best["space"]]
    rows = []
    for run in sorted(runs, key=lambda r: (r.setting.method, -r.size)):
        m, orders = run.measured, study.orders(run)
        steps = f"{m.steps}" + (f" ({m.cutbacks} cut back)" if m.cutbacks else "")
        cost = [str(m.unknowns), steps, str(m.iterations), f"{m.wall:.1f}", f"{m.memory / 1e6:.0f}"]
        errors = [
            error + (f" ({orders[name]})" if orders.get(name) else "")
            for name, error in study.errors_in_words(run).items()
        ]
        rows.append([run.setting.label, *cost, *errors])
    return markdown(titles, rows)


def percent(share: float) -> str:
    """Return a share in percent, with two digits."""
    return f"{100 * share:.2g} %" if isfinite(share) else "unknown"
