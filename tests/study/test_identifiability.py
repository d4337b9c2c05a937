"""What is said of parameters: which are known only together, and how noise is told from error."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.study.test_fit_machine import TRUTH, UNKNOWNS, Closed, fit_to, measured
from wovenfab.study.fit.identifiability import (
    Identifiability,
    Misfit,
    describe_identifiability,
    describe_unknown,
    knowledge,
    sign_runs,
)

Array = NDArray[np.float64]
TWO = UNKNOWNS[:2]
NAMES = [u.name for u in TWO]
FIT = replace(fit_to(measured()), unknowns=TWO)


def known_with(correlation: float, folder: Path, shift: Array | None = None) -> Identifiability:
    """Return what a curve tells of two parameters with a correlation of a given size."""
    with Closed(fit_to(measured()), folder) as objective:
        e = objective.evaluate(TRUTH)
    weights = e.weights(FIT)
    generator = np.random.default_rng(2)
    one, other = np.linalg.qr(generator.standard_normal((weights.size, 2)))[0].T
    second = correlation * one + np.sqrt(1 - correlation**2) * other
    jacobian = 50 * np.stack([one, second], axis=1) / weights[:, None]
    noise = generator.standard_normal(weights.size) / weights
    return knowledge(FIT, TRUTH, noise, jacobian, e.comparisons, shift)


@pytest.mark.parametrize(("correlation", "together"), [(0.8, False), (-0.8, False), (0.99, True)])
def test_parameters_are_named_together_where_their_correlation_is_large(
    correlation: float, together: bool, tmp_path: Path
) -> None:
    lines = describe_unknown(known_with(correlation, tmp_path))
    assert any(all(name in line for name in NAMES) for line in lines) == together


@pytest.mark.parametrize(("share", "said"), [(0.03, False), (0.3, True)])
def test_what_cells_and_steps_add_to_an_interval_is_said_where_it_counts(
    share: float, said: bool, tmp_path: Path
) -> None:
    half = known_with(0.0, tmp_path).intervals[0].half
    known = known_with(0.0, tmp_path, np.array([share * half, 0.0]))
    plain = known_with(0.0, tmp_path)
    assert (
        len(describe_identifiability(known, FIT)) - len(describe_identifiability(plain, FIT))
        == said
    )


def test_one_of_a_hundred_curves_with_noise_is_taken_for_an_error_of_the_model() -> None:
    generator = np.random.default_rng(5)
    curves = generator.standard_normal((1000, 60))
    taken = [Misfit(0.0, 0.0, *sign_runs(curve)).is_model_error for curve in curves]
    assert 0.003 < np.mean(taken) < 0.03
