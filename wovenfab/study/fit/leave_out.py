"""Tests predicted by fits to all others: leave-one-out cross-validation of a model.

A misfit says how well a law follows what it was given, and falls with each parameter. How well it
predicts a test that it was not given does not: a law that took what belongs to another one fails
there (Stone, J. R. Statist. Soc. B 36 (1974) 111-147, doi:10.1111/j.2517-6161.1974.tb00994.x).

Each experiment of a fit is left out in turn: the tests of one case, which are one run with its
curve and its figures. The search for the others begins where any search does, not at the joint
solution: along a direction that they do not determine it would keep what the left-out test tells.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path

import numpy as np

from wovenfab.study.cluster import Cluster
from wovenfab.study.fit.fit_file import Fit
from wovenfab.study.fit.identifiability import Identifiability, describe_unknown, knowledge
from wovenfab.study.fit.objective import HERE, Evaluation, FitTrial, Objective
from wovenfab.study.fit.search import COARSE, discretisation_error, search_with_slack

#: Called with each trial of the fit that it was made for.
Report = Callable[[FitTrial], None]


@dataclass(frozen=True)
class Prediction:
    """The tests of an experiment, predicted by a fit to all others.

    Attributes:
        tests: Their numbers in the fit, from 0.
        names: Their names.
        values: Of the parameters that the others gave, in SI units.
        evaluation: The predicted tests with these values, with cells and steps as the fit's.
        fitted: Misfit of the others.
        known: What they tell of the parameters.
        error: Estimated error of the predicted curves by cells and steps, over the largest force;
            nan where files give them.
        converged: Whether the search ended by itself.
        notes: What the others leave unknown, in sentences.
    """

    tests: tuple[int, ...]
    names: tuple[str, ...]
    values: Mapping[str, float]
    evaluation: Evaluation
    fitted: float
    known: Identifiability
    error: float
    converged: bool
    notes: tuple[str, ...]

    @property
    def misfits(self) -> tuple[float, ...]:
        """Root mean square of the distances of each test, over its largest force or each figure."""
        return tuple(comparison.misfit for comparison in self.evaluation.comparisons)

    @property
    def points(self) -> tuple[tuple[str, int], ...]:
        """Name and number of compared rows of each test."""
        pairs = zip(self.names, self.evaluation.comparisons, strict=True)
        return tuple((name, c.rows.size) for name, c in pairs)


@dataclass(frozen=True)
class FittedModel:
    """A model that was fitted, to be compared with others.

    Attributes:
        fit: The fit.
        known: What the curves tell of its parameters.
        predictions: Of each experiment by the others; empty if none was left out.
    """

    fit: Fit
    known: Identifiability
    predictions: tuple[Prediction, ...] = ()


def chosen(fit: Fit, tests: Sequence[int]) -> Fit:
    """Return a fit to some of its tests, by their numbers."""
    return replace(fit, tests=tuple(fit.tests[number] for number in tests), profiles=())


def predicted(
    fit: Fit,
    tests: Sequence[int],
    folder: Path,
    cluster: Cluster = HERE,
    report: Report = lambda trial: None,
) -> Prediction:
    """Return some tests of a fit as a fit to all others predicts them.

    Args:
        fit: The fit.
        tests: Numbers of the tests to leave out, from 0.
        folder: With the curves that are computed, as of the fit to all tests.
        cluster: Where the runs are made.
        report: Called with each trial of the fit to the others.

    Raises:
        TrialError: A run did not come to its end.
        BranchError: A measured and a computed curve do not belong to each other.
    """
    own = chosen(fit, tests)
    others = chosen(fit, [number for number in range(len(fit.tests)) if number not in tests])
    names = tuple(test.name for test in own.tests)
    with Objective(others, folder, cluster, report) as objective:
        found = search_with_slack(objective, others)
    e = found.evaluation
    known = knowledge(others, found.values, e.residuals, e.jacobian, e.comparisons, found.shift)
    with Objective(own, folder, cluster) as objective:
        objective.choose_rows(found.values, found.scale)
        done = objective.evaluate(found.values, found.scale)
        as_said, coarse = (objective.attempt(found.values, scale) for scale in (1.0, COARSE))
    error = np.nan
    if as_said and coarse:
        finer = done if found.scale < 1 else None
        error, _ = discretisation_error(own, as_said, coarse, finer)
    notes = describe_unknown(known)
    if not found.converged:
        notes.append("The search has not converged.")
    return Prediction(
        tuple(tests),
        names,
        found.values,
        done,
        e.misfit,
        known,
        error,
        found.converged,
        tuple(notes),
    )


def misfit(predictions: Sequence[Prediction]) -> float:
    """Return the root mean square of the misfits of all predicted tests, each counted once."""
    return float(np.sqrt(np.mean([m**2 for p in predictions for m in p.misfits])))


def describe_predictions(predictions: Sequence[Prediction]) -> list[str]:
    """Return sentences: how well each test is predicted, and what the others leave unknown."""
    lines = []
    for one in predictions:
        left = ", ".join(one.names)
        for name, share in zip(one.names, one.misfits, strict=True):
            line = f"{name}, left out, is predicted within {100 * share:.2f} % ("
            line += f"the others are followed within {100 * one.fitted:.2f} %"
            if isfinite(one.error):
                line += f"; cells and steps change it by about {100 * one.error:.2g} %"
            lines.append(f"{line}).")
        pairs = zip(one.names, one.evaluation.comparisons, strict=True)
        lines += [f"{name}: {c.left_out}." for name, c in pairs if c.left_out]
        lines += [f"Without {left}: {note}" for note in one.notes]
    whole = f"Left-out tests are predicted within {100 * misfit(predictions):.2f} %"
    return [*lines, f"{whole} (root mean square of the tests)."]


def models_compared(models: Mapping[str, FittedModel]) -> list[str]:
    """Return lines that compare models of the same curves, by their names."""
    known = {name: model.known for name, model in models.items()}
    width = max(map(len, known))
    lines = [f"{'':{width}}  parameters  determined  misfit  BIC"]
    for name, k in known.items():
        share = float(np.sqrt(np.mean([m.misfit**2 for m in k.misfits])))
        sure = sum(i.determined for i in k.intervals)
        lines.append(
            f"{name:{width}}  {len(k.intervals):10d}  {sure:10d}  {100 * share:5.2f} %  {k.bic:.1f}"
        )
    if len({k.points for k in known.values()}) > 1:
        lines.append("They compare different numbers of points: their BIC say nothing.")
    else:
        best, second = sorted(known, key=lambda name: known[name].bic)[:2]
        lead = known[second].bic - known[best].bic
        strength = "strong" if lead > 6 else "weak"  # Kass and Raftery, doi:10.2307/2291091
        lines.append(
            f"{best} has the smallest BIC, by {lead:.1f}: a {strength} reason to prefer it."
        )
    if all(model.predictions for model in models.values()):
        lines += ["", *_predictions_compared({n: m.predictions for n, m in models.items()})]
    return lines


def of_same_tests(models: Mapping[str, Sequence[Prediction]]) -> bool:
    """Return whether models predict the same rows of the same tests, in the same order."""
    return len({tuple(one.points for one in predictions) for predictions in models.values()}) == 1


def _predictions_compared(models: Mapping[str, Sequence[Prediction]]) -> list[str]:
    """Return lines that compare how well models predict left-out tests, by their names."""
    if not of_same_tests(models):
        return ["They predict different tests or points: their predictions are not compared."]
    names = [name for one in next(iter(models.values())) for name in one.names]
    width, wide = max(map(len, models)), [max(len(name), 7) for name in names]
    head = "  ".join(f"{name:>{n}}" for name, n in zip(names, wide, strict=True))
    lines = ["Misfit of each test where it was left out:", f"{'':{width}}  {head}      all"]
    for name, predictions in models.items():
        shares = [share for one in predictions for share in one.misfits]
        cells = (f"{100 * share:{n - 2}.2f} %" for share, n in zip(shares, wide, strict=True))
        lines.append(f"{name:{width}}  {'  '.join(cells)}  {100 * misfit(predictions):5.2f} %")
    best, second = sorted(models, key=lambda name: misfit(models[name]))[:2]
    ours, theirs = (f"{100 * misfit(models[name]):.2f} %" for name in (best, second))
    return [*lines, f"{best} predicts best: {ours} against {theirs} of {second}."]
