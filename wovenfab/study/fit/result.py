"""What a fit leaves in files: ``fit.json``, and the fitted cases."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from wovenfab.case import Case
from wovenfab.record.results import write_whole
from wovenfab.study.fit.fit_file import (
    FieldTest,
    FigureTest,
    Fit,
    FittedTest,
    MeasuredTest,
    with_values,
)
from wovenfab.study.fit.identifiability import Identifiability
from wovenfab.study.fit.leave_out import FittedModel, Prediction, misfit
from wovenfab.study.fit.response import Comparison
from wovenfab.study.fit.search import Found, Profile
from wovenfab.study.fit.specimens import SpecimenValues

#: File of all that a fit has found.
RESULT = "fit.json"


def write_result(
    fit: Fit,
    found: Found,
    known: Identifiability,
    profiles: Sequence[Profile],
    specimens: Sequence[SpecimenValues],
    notes: Sequence[str],
    directory: Path,
    predictions: Sequence[Prediction] = (),
) -> None:
    """Write ``fit.json`` and the fitted case of each test."""
    result = {
        "title": fit.title,
        "parameters": {i.name: _plain(asdict(i)) for i in known.intervals},
        "correlations": known.correlations.tolist(),
        "joint": {k: np.asarray(v).tolist() for k, v in asdict(known.joint).items()},
        "singular_values": known.singular_values.tolist(),
        "directions": known.directions.tolist(),
        "scatter": known.scatter,
        "bic": known.bic,
        "tests": [
            {
                "measured": test.name,
                "case": test.case.name,
                **_figures(test, c),
                **_thinning(test),
                **_plain(asdict(f)),
            }
            for test, c, f in zip(
                fit.tests, found.evaluation.comparisons, known.misfits, strict=True
            )
        ],
        "profiles": [_plain(asdict(one)) for one in profiles],
        "specimens": [asdict(one) for one in specimens],
        "leave_out": _left_out(predictions),
        "discretisation_error": found.error if isfinite(found.error) else None,
        "trials": [_plain(asdict(t)) for t in found.trials],
        "converged": found.converged,
        "notes": notes,
    }
    write_whole(directory / RESULT, json.dumps(result, indent=1) + "\n")
    cases: list[Case] = []
    for number, test in enumerate(fit.tests):
        if any(test.case is other for other in cases):  # a field of a test before it
            continue
        cases.append(test.case)
        which = "" if len(fit.tests) == 1 else f"{number + 1}-"
        case = with_values(test.case, fit.unknowns, found.values)
        write_whole(directory / f"{which}{test.case.name}.yaml", case.to_yaml())


def write_models(models: Mapping[str, FittedModel], notes: Sequence[str], directory: Path) -> None:
    """Write ``models.json``, in which several fits are compared."""
    result = {
        "models": {
            name: {
                "title": model.fit.title,
                "parameters": len(model.known.intervals),
                "determined": sum(i.determined for i in model.known.intervals),
                "misfits": {
                    test.name: f.misfit
                    for test, f in zip(model.fit.tests, model.known.misfits, strict=True)
                },
                "bic": model.known.bic,
                "leave_out": _left_out(model.predictions),
            }
            for name, model in models.items()
        },
        "notes": notes,
    }
    directory.mkdir(parents=True, exist_ok=True)
    write_whole(directory / "models.json", json.dumps(result, indent=1) + "\n")


def _left_out(predictions: Sequence[Prediction]) -> dict[str, Any] | None:
    """Return the misfits of left-out tests, and of what fits they are; None where there is none."""
    if not predictions:
        return None
    return {
        "misfit": misfit(predictions),
        "predictions": [
            {
                "tests": [
                    {"measured": name, "rows": rows, "misfit": share}
                    for (name, rows), share in zip(one.points, one.misfits, strict=True)
                ],
                "misfit_of_others": one.fitted,
                "parameters": {i.name: _plain(asdict(i)) for i in one.known.intervals},
                **_plain({"discretisation_error": one.error}),
                "converged": one.converged,
                "notes": one.notes,
            }
            for one in predictions
        ],
    }


def _figures(test: FittedTest, comparison: Comparison) -> dict[str, Any]:
    """Return the figures of a test, if it has any, or what its field is, in SI units."""
    if isinstance(test, FieldTest):
        on = comparison.resolved
        distances = (comparison.computed - comparison.measured)[on]
        field = {
            "displacement": test.at,
            "points": int(np.count_nonzero(on)) // 2,
            "beside": int(np.count_nonzero(~on)) // 2,
            "independent": test.share,
            "distance": float(np.sqrt(2 * np.mean(distances**2))),
            "error": test.error,
        }
        return {"field": field}
    if not isinstance(test, FigureTest):
        return {}
    pairs = zip(test.figures, comparison.computed, strict=True)
    return {
        "figures": {
            f.name: {"measured": f.value, "fitted": float(c), "error": f.error, "unit": f.unit}
            for f, c in pairs
        }
    }


def _thinning(test: FittedTest) -> dict[str, Any]:
    """Return what became of the rows of a record, in SI units; nothing where all are there."""
    found = test.thinning if isinstance(test, MeasuredTest) else None
    return {"thinning": asdict(found)} if found else {}


def _plain(data: dict[str, Any]) -> dict[str, Any]:
    """Return data without infinities, which JSON does not know."""
    return {k: None if isinstance(v, float) and not isfinite(v) else v for k, v in data.items()}
