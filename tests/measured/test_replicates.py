"""The mean of replicates, and its error, from curves whose scatter is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.study.test_fit import FIT, place
from wovenfab.case import CaseError
from wovenfab.measured.curve import Measured
from wovenfab.measured.replicates import replicates_of
from wovenfab.study.fit.fit_file import Fit, read_fit
from wovenfab.study.fit.objective import Objective
from wovenfab.study.fit.response import ResponseCurve
from wovenfab.study.fit.search import search
from wovenfab.study.fit.specimens import describe_specimens, specimen_values

Array = NDArray[np.float64]
FACTORS = (0.9, 1.0, 1.15, 0.95)


def loop(rows: int, most: float, factor: float, name: str = "a") -> Measured:
    """Return a loading and an unloading with other forces, both straight."""
    u = np.concatenate([np.linspace(0, most, rows), np.linspace(most, 0, rows)[1:]])
    up = np.arange(len(u)) < rows
    return Measured(Path(f"{name}.csv"), u, factor * np.where(up, 100 * u + 1, 60 * u - 0.5))


def made() -> list[Measured]:
    sizes = ((31, 0.02), (57, 0.021), (40, 0.0195), (28, 0.0205))
    return [
        loop(rows, most, factor, f"s{i}")
        for i, ((rows, most), factor) in enumerate(zip(sizes, FACTORS, strict=True))
    ]


def test_the_mean_is_that_of_each_branch_within_the_common_range() -> None:
    found = replicates_of(made())
    u, force = found.mean.displacement, found.mean.force
    assert u.max() <= 0.0195 and len(found.mean.branches()) == 2
    up = np.arange(len(u)) <= u.argmax()
    mean = np.mean(FACTORS)
    np.testing.assert_allclose(force[up], mean * (100 * u[up] + 1), rtol=1e-12)
    # The row of the reversal, which both branches share, has the force of the loading.
    far = ~up & (u < 0.018)
    np.testing.assert_allclose(force[far], mean * (60 * u[far] - 0.5), rtol=1e-9, atol=1e-12)
    assert np.count_nonzero(far) > 10 and len(u) <= 2 * 28


def test_the_error_of_the_mean_is_that_of_the_specimens() -> None:
    found = replicates_of(made())
    u = found.mean.displacement
    up = np.arange(len(u)) <= u.argmax()
    share = np.std(FACTORS, ddof=1) / np.sqrt(len(FACTORS))
    np.testing.assert_allclose(found.error[up], share * (100 * u[up] + 1), rtol=1e-12)


def test_noise_of_specimens_averages_out_in_the_mean() -> None:
    generator = np.random.default_rng(5)
    u = np.linspace(0, 0.02, 400)
    curves = [
        Measured(Path(f"{i}.csv"), u, 100 * u + 0.1 * generator.standard_normal(400))
        for i in range(9)
    ]
    found = replicates_of(curves)
    assert np.std(found.mean.force - 100 * u) == pytest.approx(0.1 / 3, rel=0.15)
    assert np.sqrt(np.mean(found.error**2)) == pytest.approx(0.1 / 3, rel=0.1)


def test_one_curve_is_its_own_mean_without_scatter() -> None:
    (curve,) = made()[:1]
    found = replicates_of([curve])
    assert found.mean is curve and not found.error.any()


def test_replicates_of_other_tests_are_refused() -> None:
    u = np.linspace(0, 0.02, 30)
    with pytest.raises(CaseError, match=r"b.csv: the replicate has 1 branches.* a.csv has 2"):
        replicates_of([loop(30, 0.02, 1.0), Measured(Path("b.csv"), u, u)])
    with pytest.raises(CaseError, match="displacements in common"):
        replicates_of([Measured(Path("a.csv"), u, u), Measured(Path("b.csv"), u + 0.1, u)])


def fit_of(folder: Path, factors: tuple[float, ...], monkeypatch: pytest.MonkeyPatch) -> Fit:
    """Return a fit to springs of stiffnesses 83 N/m times factors; a formula stands for runs."""
    u = np.linspace(0, 0.06, 31)

    def curves(objective: Objective, values: dict[str, float], scale: float) -> list[ResponseCurve]:
        a, b = values["shear.stiffness"], values["stretch.stiffness"]
        slopes = np.stack([u, u**3], axis=1)
        return [ResponseCurve(u, a * u + b * u**3, 0 * u, slopes, (0, 30), 1e-3)]

    monkeypatch.setattr(Objective, "_curves", curves)
    names = [f"s{i}.csv" for i in range(len(factors))]
    for name, factor in zip(names, factors, strict=True):
        rows = (f"{1e3 * x:.9f},{factor * 83 * x + 9e4 * x**3:.12f}" for x in u)
        (folder / name).write_text("\n".join(["u_mm,F_N", *rows, ""]))
    return read_fit(place(folder, FIT.replace("curve.csv", f"[{', '.join(names)}]")))


def test_each_specimen_has_its_values_and_their_mean_is_the_joint_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    factors = (0.97, 1.0, 1.03)
    fit = fit_of(tmp_path, factors, monkeypatch)
    with Objective(fit, tmp_path / "runs") as objective:
        found = search(objective, fit)
        specimens = specimen_values(objective, fit, found)
    assert [s.measured for s in specimens] == ["s0.csv", "s1.csv", "s2.csv"]
    values = [s.values["shear.stiffness"] for s in specimens]
    # Linear in the logarithm: a change of 3 % is right to 0.05 %.
    np.testing.assert_allclose(values, 83 * np.array(factors), rtol=1.5e-3)
    np.testing.assert_allclose([s.values["stretch.stiffness"] for s in specimens], 9e4, rtol=2e-3)
    centre = np.mean([objective.scaled(s.values) for s in specimens], axis=0)
    np.testing.assert_allclose(centre, objective.scaled(found.values), atol=1e-12)
    lines = describe_specimens(specimens, fit)
    assert len(lines) == 2 and all(f"{value:.4g}" in lines[0] for value in values)


def test_errors_are_those_of_the_mean_and_the_stated_one_at_least(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fit = fit_of(tmp_path, (0.8, 1.0, 1.2), monkeypatch)
    (test,) = fit.tests
    stated = 0.002 * np.abs(test.measured.force).max()
    scatter = 0.2 / np.sqrt(3) * 83 * test.measured.displacement
    np.testing.assert_allclose(test.errors, np.maximum(scatter, stated), rtol=1e-6)
    assert test.errors[0] == pytest.approx(stated) and test.errors[-1] > 2 * stated
    with Objective(fit, tmp_path / "runs") as objective:
        e = objective.evaluate({"shear.stiffness": 83.0, "stretch.stiffness": 8e4})
    distance = e.comparisons[0].computed - test.measured.force
    np.testing.assert_allclose(e.residuals, distance / test.errors, rtol=1e-9, atol=1e-12)
