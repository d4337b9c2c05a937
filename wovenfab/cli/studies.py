"""``wovenfab accuracy``, ``effects``, ``sensitivities``, ``sweep`` and ``fit``."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wovenfab.case import CaseError, case_error, read_case
from wovenfab.case.program import program_of_case
from wovenfab.cli.console import (
    BAD_INPUT,
    FAILED_STEP,
    INTERRUPTED,
    Console,
    configure_log,
    counted,
    duration,
    is_first_rank,
    is_launched,
)
from wovenfab.measured.curve import read_measured
from wovenfab.measured.layout import EMPTY, Layout
from wovenfab.record.results import write_csv
from wovenfab.simulation.progress import Progress
from wovenfab.study.cluster import Cluster
from wovenfab.study.sweep import Member, Sweep, SweepRun, members_of, printed, sweep, write_table
from wovenfab.study.variations import Variation, grid, is_sweep_file, read_over, read_sweep_file

#: Folders of the results of single runs, and of that by which their errors are known.
RUNS, FINEST = "runs", "finer"


def study_accuracy(
    path: Path,
    output: Path | None,
    overrides: Sequence[str],
    levels: int,
    fabric: Path | None = None,
) -> int:
    """Make the study of a case, write its table and draw it; return the exit code."""
    console = Console()
    if is_launched():
        console.problem("accuracy measures one process at a time: start it without mpirun")
        return BAD_INPUT
    case = read_case(path, overrides, fabric)
    from wovenfab.report.study_pictures import draw_accuracy
    from wovenfab.study.accuracy import CASES, Study, doubled, finer, for_accuracies

    directory = output or Path("results") / f"{case.name}-accuracy"
    one_by_one, folder = Cluster(jobs=1), directory / CASES
    configure_log(0, None, console.log, first_rank=True)
    try:
        members = [*for_accuracies(case, folder, levels), *doubled(case, folder, levels)]
        runs = run_members(members, directory / RUNS, one_by_one, console)
        if (found := finer(runs, folder)) is None:
            console.problem(f"every run failed; the reasons are in {directory}")
            return FAILED_STEP
        last, member = found
        (finest,) = run_members([member], directory / FINEST, one_by_one, console)
    except KeyboardInterrupt:
        console.problem(f"interrupted; to go on, repeat the command ({directory} has what is done)")
        return INTERRUPTED
    if not finest.has_results:
        console.problem("errors are not known without the finer answer")
        return FAILED_STEP
    study = Study.of(runs, last, finest)
    study.write(directory)
    draw_accuracy(study, directory / "accuracy.png")
    console.say(f"\n{study.table()}\n\n{study.proof()}\n\ntable and picture: {directory}")
    return exit_code(runs)


def study_effects(
    path: Path, output: Path | None, overrides: Sequence[str], fabric: Path | None = None
) -> int:
    """Measure the scene with all effects, without each and with each alone; collective."""
    case = read_case(path, overrides, fabric)
    from mpi4py import MPI

    from wovenfab.report.study_pictures import draw_costs
    from wovenfab.study.effects import line, printed, study, write_table

    console = Console()
    rows = study(case, MPI.COMM_WORLD, lambda row: console.say(line(row)), console.say)
    if is_first_rank():
        directory = output or Path("results") / f"{case.name}-effects"
        directory.mkdir(parents=True, exist_ok=True)
        write_table(rows, directory / "effects.csv")
        (directory / "effects.md").write_text(printed(rows), encoding="utf-8")
        draw_costs(rows, directory / "effects.png")
        console.say(f"\n{printed(rows)}\ntable and chart: {directory}")
    return 0


def differentiate(
    path: Path,
    output: Path | None,
    overrides: Sequence[str],
    by: Sequence[str],
    fabric: Path | None = None,
    fit: Path | None = None,
    lab: Path | None = None,
    layout: Layout = EMPTY,
) -> int:
    """Write and draw the derivatives of a run by its parameters; collective.

    With the result of a ``fit`` its parameters are taken, and the band that they leave is added,
    beside the curve of a ``lab``.
    """
    case = read_case(path, overrides, fabric)
    from mpi4py import MPI
    from pydantic_core import PydanticCustomError

    from wovenfab.case.errors import reason
    from wovenfab.report.study_pictures import draw_bands, draw_sensitivities
    from wovenfab.stepping.sensitivity import TargetError
    from wovenfab.stepping.stability import StabilityLostError
    from wovenfab.stepping.step import Step, StepFailedError
    from wovenfab.study.effects import by_factor, parameters_of, sensitivities, value_of
    from wovenfab.study.fit.fit_file import target_of
    from wovenfab.study.fit.prediction import (
        describe_prediction,
        fitted_case,
        measured_beside,
        read_fitted,
        with_band,
    )

    console = Console()
    if fit and by:
        console.problem("--by and --fit both say by which parameters: give one of them")
        return BAD_INPUT
    if not fit and lab:
        console.problem("--lab is drawn beside the band of a fit: give --fit, too")
        return BAD_INPUT
    if not lab and layout != EMPTY:
        options = "--columns, --units, --rows, --decimal and --sheet"
        console.problem(f"{options} are of the file of --lab")
        return BAD_INPUT
    measured = read_measured(lab, layout) if lab else None
    predicted = fitted_case(case, read_fitted(fit)) if fit else None
    if predicted:
        case, targets = predicted.case, [*predicted.targets.values()]
        for line in predicted.replaced:
            console.say(line)
    else:
        try:
            named = [target_of(name, case) for name in by] or parameters_of(case)
            targets = [by_factor(target, case) for target in named]
        except PydanticCustomError as error:
            raise CaseError([case.problem("effects", *reason(error))]) from error
    end = program_of_case(case).milestones[-1].time

    def report(step: Step) -> None:
        console.progress(Progress("steps with derivatives", step.time / end))

    try:
        with console:
            columns = sensitivities(case, targets, MPI.COMM_WORLD, report, console.say)
    except TargetError as error:
        console.problem(str(error))
        return BAD_INPUT
    except (StepFailedError, StabilityLostError) as failure:
        console.problem(str(failure))
        return FAILED_STEP
    if is_first_rank():
        directory = output or Path("results") / f"{case.name}-sensitivities"
        directory.mkdir(parents=True, exist_ok=True)
        if predicted:
            columns = with_band(columns, predicted)
            draw_bands(columns, directory / "band.png", measured)
            beside = [measured_beside(columns, measured)] if measured else []
            console.say("\n".join([*describe_prediction(columns, predicted), *beside]))
        rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
        write_csv(directory / "sensitivities.csv", rows)
        values = {str(t): value_of(t, case) for t in targets}
        draw_sensitivities(columns, values, directory / "sensitivities.png")
        console.say(f"table and picture: {directory}")
    return 0


def run_sweep(
    paths: Sequence[Path],
    over: Sequence[str],
    overrides: Sequence[str],
    output: Path | None,
    cluster: Cluster,
    fabrics: Sequence[Path] = (),
) -> int:
    """Run every member of a sweep, draw them together and return the exit code."""
    cases, variations = _varied(paths, over)
    members = members_of(cases, variations, overrides, fabrics or (None,))
    name = "-".join(file.stem for file in (paths[0], *fabrics))
    directory = output or Path("results") / f"{name}-sweep"
    console = Console()
    configure_log(0, None, console.log, first_rank=True)
    try:
        runs = run_members(members, directory, cluster, console)
    except KeyboardInterrupt:
        console.problem(f"interrupted; to go on, repeat the command ({directory} has what is done)")
        return INTERRUPTED
    console.say(f"\n{printed(runs)}\n\ntable and picture: {directory}")
    _draw([run for run in runs if run.has_results], directory)
    return exit_code(runs)


def run_members(
    members: Sequence[Member], directory: Path, cluster: Cluster, console: Console
) -> list[SweepRun]:
    """Run members side by side; show the progress and update their table after each."""
    where = f"{cluster.side_by_side} side by side" if cluster.is_local else f"on {cluster.name}"
    phase = f"{len(members)} runs, {where}"

    def report(state: Sweep, run: SweepRun | None) -> None:
        ended, count = sum(r.ended for r in state.runs), len(state.runs)
        console.progress(Progress(phase, state.share))
        console.rows({r.member.name: r.done for r in state.runs if not r.ended and r.done})
        if run is None:
            return
        write_table(state.runs, directory)
        if run.state == "failed":
            console.problem(f"{run.member.name} failed: {run.problem} (its output: {run.log})")
        if run.state != "unchanged" and state.left is not None:
            left = f", about {duration(state.left)} left" if ended < count else ""
            console.say(f"{ended} of {count}: {run.member.name} took {duration(run.seconds)}{left}")

    with console:
        runs = sweep(members, directory, cluster, report)
    if unchanged := sum(run.state == "unchanged" for run in runs):
        console.say(f"{unchanged} of {len(runs)} runs were there already")
    return runs


def exit_code(runs: Sequence[SweepRun]) -> int:
    """Return what a command ends with after some runs."""
    return FAILED_STEP if any(run.state == "failed" for run in runs) else 0


def _draw(runs: Sequence[SweepRun], directory: Path) -> None:
    """Draw the loops of all runs over each other, as ``overlay.png`` and ``overlay.svg``."""
    from wovenfab.report.curves import loops
    from wovenfab.report.run_data import open_run_data
    from wovenfab.report.style import house_style, save

    if runs:
        with house_style():
            figure = loops([(run.member.label, open_run_data(run.directory)) for run in runs])
            for kind in ("png", "svg"):
                save(figure, directory / f"overlay.{kind}")


def _varied(
    paths: Sequence[Path], over: Sequence[str]
) -> tuple[Sequence[Path], Sequence[Variation]]:
    """Return case files, and what each is run with."""
    axes = [read_over(text) for text in over]
    if not any(is_sweep_file(path) for path in paths):
        return paths, grid(axes)
    if len(paths) > 1:
        raise case_error(str(paths[0]), "a sweep file stands alone, without other files")
    sweep_file = read_sweep_file(paths[0])
    return sweep_file.cases, grid([sweep_file.variations, *axes])


if TYPE_CHECKING:
    from wovenfab.study.fit.fit_file import Fit
    from wovenfab.study.fit.leave_out import FittedModel, Prediction
    from wovenfab.study.fit.objective import FitTrial
    from wovenfab.study.fit.search import Found

#: Last part of the name of the folder in which several fits are compared.
MODELS = "models"


def fit_all(
    paths: Sequence[Path], output: Path | None, cluster: Cluster, leave_out: bool = False
) -> int:
    """Find the parameters that fit files ask for, compare several; return the exit code.

    With ``leave_out`` each test is predicted by a fit to all others, too.
    """
    console = Console()
    if is_launched():
        console.problem("fit starts its own processes: start it without mpirun, with --jobs")
        return BAD_INPUT
    from wovenfab.report.models import PAGE, write_models_page
    from wovenfab.study.fit.fit_file import read_fit
    from wovenfab.study.fit.leave_out import models_compared
    from wovenfab.study.fit.response import BranchError, TrialError
    from wovenfab.study.fit.result import write_models

    configure_log(0, None, console.log, first_rank=True)
    fits = [read_fit(path, leave_out) for path in paths]
    models = {}
    for fit in fits:
        directory = output or Path("results") / fit.name
        if output and len(fits) > 1:
            directory = output / fit.name
        try:
            models[fit.name] = _fit(console, fit, directory, cluster, leave_out)
        except (TrialError, BranchError) as failure:
            console.problem(str(failure))
            return FAILED_STEP if isinstance(failure, TrialError) else BAD_INPUT
        except KeyboardInterrupt:
            there = f"{directory} has what is done"
            console.problem(f"interrupted; to go on, repeat the command ({there})")
            return INTERRUPTED
    if len(models) > 1:
        directory = output or Path("results") / f"{fits[0].name}-{MODELS}"
        notes = models_compared(models)
        write_models(models, notes, directory)
        write_models_page(models, notes, directory / PAGE)
        console.say("\n".join(["", *notes, "", f"comparison: {directory}"]))
    return 0


def _fit(
    console: Console, fit: Fit, directory: Path, cluster: Cluster, leave_out: bool
) -> FittedModel:
    """Find the parameters of one fit, write and print what is known of them."""
    from wovenfab.report.fit import PAGE, PICTURE, draw_fit, write_fit_page
    from wovenfab.study.fit.clouds import describe_field
    from wovenfab.study.fit.figures import describe_figures
    from wovenfab.study.fit.fit_file import FieldTest, FigureTest, MeasuredTest
    from wovenfab.study.fit.identifiability import describe_identifiability, knowledge
    from wovenfab.study.fit.leave_out import FittedModel, describe_predictions
    from wovenfab.study.fit.objective import Objective
    from wovenfab.study.fit.result import write_result
    from wovenfab.study.fit.search import profile, search_with_slack
    from wovenfab.study.fit.specimens import describe_specimens, specimen_values

    curves = [curve for test in fit.tests for curve in test.specimens]
    figures = sum(len(t.figures) for t in fit.tests if isinstance(t, FigureTest))
    fields = sum(isinstance(t, FieldTest) for t in fit.tests)
    what = [(len(curves), "measured curve"), (figures, "figure"), (fields, "measured field")]
    what.append((len(fit.unknowns), "parameter"))
    console.say(f"{fit.name}: {', '.join(counted(n, name) for n, name in what if n)}")
    for curve in curves:
        if curve.reading is not None:
            console.say(f"  {curve.file.name}: {curve.reading}")
            for note in curve.reading.notes:
                console.say(f"    {note}")
    for test in fit.tests:
        if isinstance(test, MeasuredTest) and test.thinning:
            size = float(abs(test.measured.force).max())
            console.say(f"  {test.thinning.describe(test.name, size)}")
    place = directory / RUNS
    with console, Objective(fit, place, cluster, _reporter(console, fit)) as objective:
        found = search_with_slack(objective, fit)
        e = found.evaluation
        known = knowledge(fit, found.values, e.residuals, e.jacobian, e.comparisons, found.shift)
        halves = {i.name: i.half for i in known.intervals if isfinite(i.half)}
        profiles = [
            profile(objective, fit, found, name, halves[name])
            for name in fit.profiles
            if name in halves
        ]
        specimens = specimen_values(objective, fit, found)
    predictions = _left_out(console, fit, place, cluster) if leave_out else ()
    beyond = [
        f"{test.name}: {comparison.left_out}."
        for test, comparison in zip(fit.tests, e.comparisons, strict=True)
        if comparison.left_out
    ]
    pairs = list(zip(fit.tests, e.comparisons, strict=True))
    fields_met = [describe_field(t, c) for t, c in pairs if isinstance(t, FieldTest)]
    figures_met = [
        line for t, c in pairs if isinstance(t, FigureTest) for line in describe_figures(t, c)
    ]
    notes = [
        *_headlines(fit, found),
        *beyond,
        *figures_met,
        *fields_met,
        *describe_identifiability(known, fit),
        *map(str, profiles),
    ]
    notes += describe_specimens(specimens, fit)
    if predictions:
        notes += describe_predictions(predictions)
    write_result(fit, found, known, profiles, specimens, notes, directory, predictions)
    draw_fit(fit, found, known, directory / PICTURE)
    write_fit_page(fit, found, known, profiles, notes, directory / PAGE, predictions)
    for i in known.intervals:
        interval = f"95 %: {i.low:.4g} to {i.high:.4g}" if i.determined else "not determined"
        console.say(f"  {i.name:28s} {i.value:.5g} {i.unit}  ({interval})")
    console.say("\n".join(["", *notes, "", f"page, picture and fitted case: {directory}"]))
    return FittedModel(fit, known, predictions)


def _left_out(console: Console, fit: Fit, place: Path, cluster: Cluster) -> tuple[Prediction, ...]:
    """Return each experiment of a fit as a fit to all others predicts it."""
    from wovenfab.study.fit.fit_file import experiments
    from wovenfab.study.fit.leave_out import predicted

    predictions = []
    for tests in experiments(fit.tests):
        left = ", ".join(fit.tests[number].name for number in tests)
        with console:
            console.say(f"without {left}:")
            predictions.append(predicted(fit, tests, place, cluster, _reporter(console, fit)))
    return tuple(predictions)


def _headlines(fit: Fit, found: Found) -> list[str]:
    from wovenfab.study.fit.fit_file import FieldTest, FigureTest

    misfit, spent = found.evaluation.misfit, sum(t.seconds for t in found.trials)
    followed = f"The curves are followed within {100 * misfit:.2f} % of their largest force"
    if all(isinstance(test, FieldTest) for test in fit.tests):
        followed = f"Displacements are followed within {100 * misfit:.2f} % of their largest"
    elif all(isinstance(test, FigureTest | FieldTest) for test in fit.tests):
        followed = f"The figures are met within {100 * misfit:.2f} %"
    fine = [t for t in found.trials if not t.coarse]
    if isfinite(found.error):
        size = "as the cases say" if found.scale == 1 else f"of {found.scale:.2f} of their sizes"
        cells = (
            f"Cells and steps ({size}) change the curves by about {100 * found.error:.2g} %, "
            f"{'less' if found.error <= 0.1 * misfit else 'more'} than a tenth of that."
        )
    else:
        cells = "What cells and steps change is not known: files give both."
    lines = [
        f"{followed} (root mean square), after "
        f"{counted(len(found.trials) - len(fine), 'coarse trial')} and "
        f"{counted(len(fine), 'fine one')}, "
        f"in {duration(spent)}, the time of {spent / fine[-1].seconds:.1f} runs like the last one.",
        cells,
    ]
    if not found.converged:
        lines.append("The search has not converged: fine runs do not get better any more.")
    return lines


def _reporter(console: Console, fit: Fit) -> Any:
    from wovenfab.study.fit.search import share_done

    trials = []

    def report(trial: FitTrial) -> None:
        trials.append(trial)
        spent, share = sum(t.seconds for t in trials), share_done(trials, fit.refine)
        left = f"; about {duration(spent / share - spent)} left" if share else ""
        values = ", ".join(f"{u.name} {trial.values[u.name]:.4g}" for u in fit.unknowns)
        how = f"failed: {trial.failure}" if trial.failure else f"misfit {100 * trial.misfit:.3f} %"
        runs = "coarse" if trial.coarse else "fine"
        console.say(f"trial {trial.number} ({runs}, {trial.seconds:.1f} s): {how}; {values}{left}")
        console.progress(Progress("search", share))

    return report
