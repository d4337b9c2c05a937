"""Sweeps: a case run with other values side by side, and the table of all runs."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from wovenfab.case import Case, CaseError, Rectangle, case_error, read_case
from wovenfab.case.fingerprint import fingerprint
from wovenfab.case.program import steps_of_case
from wovenfab.record.history import HISTORY
from wovenfab.record.results import FINISHED, fingerprint_of, markdown, outcome_of, write_csv
from wovenfab.record.summary import read_summary
from wovenfab.study.cluster import Cluster, command_of, take
from wovenfab.study.runner import Command, Ended, execute_all
from wovenfab.study.variations import LOG, OVER, RENAME, Variation, folder_of_run


@dataclass(frozen=True)
class Member:
    """One run of a sweep.

    Attributes:
        label: Its name for people.
        case: Its case.
        variation: What is varied, with this member's values.
    """

    label: str
    case: Case
    variation: Variation

    @property
    def name(self) -> str:
        """The label as the name of a folder, unique in a sweep."""
        return folder_of_run(self.label)

    @property
    def steps(self) -> int:
        """Number of planned load steps."""
        return steps_of_case(self.case)

    @property
    def weight(self) -> float:
        """Its work compared with that of other members, roughly."""
        sheet, elements = self.case.sheet, self.case.discretisation
        if isinstance(sheet, Rectangle) and elements.mesh_size:
            cells = sheet.length * sheet.width / elements.mesh_size**2
            return self.steps * cells * elements.degree**3
        return self.steps * 1e3 * elements.degree**3


def members_of(
    paths: Sequence[Path],
    variations: Sequence[Variation] = (Variation(),),
    overrides: Sequence[str] = (),
    fabrics: Sequence[Path | None] = (None,),
) -> list[Member]:
    """Return a member for each case file, with each fabric, with each of the variations.

    Args:
        paths: Case files.
        variations: What is varied.
        overrides: Values that replace those of all files.
        fabrics: Files of fabrics; None for cases that have their own.

    Raises:
        CaseError: A case is not valid with some of the values, two members are alike, or the name
            of one is none for a folder.
    """
    cases = [read_case(path, overrides, fabric) for path in paths for fabric in fabrics]
    members = [_member(case, variation) for case in cases for variation in variations]
    if len({member.case.files for member in members}) > 1:
        members = [
            replace(m, label=": ".join(filter(None, (m.case.name, m.label)))) for m in members
        ]
    members = [replace(m, label=m.label or m.case.name) for m in members]
    for member in members:
        try:
            folder_of_run(member.label)
        except ValueError as error:
            raise case_error(OVER, str(error), RENAME) from error
    for name, times in Counter(member.name for member in members).items():
        if times > 1:
            remedy = "Give each case and each value once."
            raise case_error(OVER, f"{times} runs would be called '{name}'", remedy)
    return members


def _member(case: Case, variation: Variation) -> Member:
    try:
        varied = case.changed(*variation.overrides())
    except CaseError as error:
        raise CaseError(map(variation.at_source, error.problems)) from error
    return Member(variation.label(), varied, variation)


State = Literal["waiting", "running", "unchanged", "finished", "failed"]


@dataclass
class SweepRun:
    """A member and its state.

    Attributes:
        member: What is run.
        directory: Its results directory.
        fingerprint: What its results depend on.
        state: ``unchanged`` if the results were there already.
        problem: Why it failed, or nothing.
        seconds: Its wall time in this sweep.
    """

    member: Member
    directory: Path
    fingerprint: str
    state: State = "waiting"
    problem: str = ""
    seconds: float = 0.0

    @property
    def log(self) -> Path:
        """The file with its output."""
        return self.directory.with_name(f"{self.directory.name}{LOG}")

    @property
    def ended(self) -> bool:
        """Whether nothing more is to be done."""
        return self.state != "waiting"

    @property
    def has_begun(self) -> bool:
        """Whether a run of this very input has written into its directory."""
        return fingerprint_of(self.directory) == self.fingerprint

    @property
    def has_results(self) -> bool:
        """Whether there are results that belong to the member."""
        return self.state in ("unchanged", "finished")

    @property
    def done(self) -> float:
        """Share of its steps that are done."""
        if self.ended or not self.has_begun:
            return float(self.ended)
        try:
            rows = (self.directory / HISTORY).read_bytes().count(b"\n") - 2
        except OSError:
            return 0.0
        return min(max(rows, 0) / max(self.member.steps, 1), 1.0)

    def command(self, cluster: Cluster) -> Command:
        """Return the command that makes the results, or goes on with them."""
        sent = not cluster.is_local
        return command_of(
            self.member.case, self.directory, self.log, self.fingerprint, cluster.ranks, sent
        )

    def finish(self, ended: Ended) -> None:
        """Note how it ended, and take what it has written on another machine."""
        take(ended, self.member.case, self.directory, self.log)
        self.state, self.problem = ("failed" if ended.failure else "finished"), ended.failure
        self.seconds = ended.seconds


@dataclass
class Sweep:
    """All runs of a sweep.

    Attributes:
        runs: In the order of the members.
        started: When it started, s of the monotonic clock.
        before: Share of the work that was done then.
    """

    runs: list[SweepRun]
    started: float = field(default_factory=time.monotonic)
    before: float = 0.0

    @property
    def share(self) -> float:
        """Share of the work that is done, without results that were there already."""
        new = [run for run in self.runs if run.state != "unchanged"]
        total = sum(run.member.weight for run in new)
        return sum(run.member.weight * run.done for run in new) / total if total else 1.0

    @property
    def left(self) -> float | None:
        """Seconds that are left, or None as long as there is no estimate."""
        share = self.share
        speed = (share - self.before) / (time.monotonic() - self.started)
        return (1 - share) / speed if share - self.before > 0.01 else None


def sweep(
    members: Sequence[Member],
    directory: Path,
    cluster: Cluster,
    report: Callable[[Sweep, SweepRun | None], None],
) -> list[SweepRun]:
    """Run all members whose results are not there yet, side by side.

    On one machine each runs on one processor: side by side they need less time than one after the
    other on several. After an interruption the next sweep uses what has finished.

    Args:
        members: What to run.
        directory: Where each gets a results directory and a log of its name.
        cluster: Where they are run.
        report: Called with each run that ended, and with None while all go on.

    Raises:
        CaseError: There is no such cluster.
        KeyboardInterrupt: This process was told to end.
    """
    runs = [SweepRun(m, directory / m.name, fingerprint(m.case)) for m in members]
    state = Sweep(runs)
    for run in runs:
        if run.has_begun and outcome_of(run.directory) == FINISHED:
            run.state = "unchanged"
            report(state, run)
    state.before = state.share
    # the longest first, so that no processor is idle in the end
    waiting = sorted((r for r in runs if not r.ended), key=lambda r: -r.member.weight)

    def end(index: int, ended: Ended) -> None:
        waiting[index].finish(ended)
        report(state, waiting[index])

    commands = [run.command(cluster) for run in waiting]
    execute_all(commands, cluster.open(directory), end, lambda: report(state, None))
    return runs


TABLE = "sweep.csv"
#: Column and where it is in the summary of a run.
_FIGURES: Mapping[str, Callable[[Mapping[str, Any]], Any]] = {
    "unknowns": lambda s: s["unknowns"],
    "steps": lambda s: s["steps"],
    "peak_force_N": lambda s: s["peak_force_N"],
    "peak_force_at_m": lambda s: s["peak_force_at_m"],
    "dissipated_J": lambda s: s["dissipated_J"],
    "work_J": lambda s: s["work_J"],
    "worst_imbalance_J": lambda s: s["worst_imbalance_J"],
    "newton_iterations": lambda s: s["newton_iterations"]["total"],
    "cut_backs": lambda s: s["cut_backs"],
    "wall_time_s": lambda s: round(sum(s["wall_time_s"].values()), 1),
}
#: The columns that are printed, with their headings.
_PRINTED = {
    "outcome": "outcome",
    "unknowns": "unknowns",
    "peak_force_N": "peak force (N)",
    "dissipated_J": "dissipated (J)",
    "worst_imbalance_J": "imbalance (J)",
    "wall_time_s": "time (s)",
}


def table_of(runs: Sequence[SweepRun]) -> list[dict[str, Any]]:
    """Return a row for each run: name, what is varied, outcome and figures in SI units."""
    keys = dict.fromkeys(key for run in runs for key in run.member.variation.values)
    return [_row(run, list(keys)) for run in runs]


def write_table(runs: Sequence[SweepRun], directory: Path) -> Path:
    """Write the table as CSV into the directory of a sweep; return the file."""
    write_csv(directory / TABLE, table_of(runs))
    return directory / TABLE


def printed(runs: Sequence[SweepRun]) -> str:
    """Return the main columns as a table in Markdown."""
    rows = [[row["run"], *(_short(row[key]) for key in _PRINTED)] for row in table_of(runs)]
    return markdown(["run", *_PRINTED.values()], rows, texts=(0, 1))


def _row(run: SweepRun, keys: Sequence[str]) -> dict[str, Any]:
    summary = read_summary(run.directory) if run.has_results else {}
    values = run.member.variation.values
    outcome = "finished" if run.ended else "not run"
    return {
        "run": run.member.name,
        **{key: values.get(key, "") for key in keys},
        "outcome": f"failed: {run.problem}" if run.state == "failed" else outcome,
        **{name: figure(summary) if summary else "" for name, figure in _FIGURES.items()},
    }


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
