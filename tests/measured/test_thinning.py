"""Long records with fewer rows: the stated error holds, reversals and weights stay."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from wovenfab.case import CaseError
from wovenfab.measured.curve import Measured
from wovenfab.measured.replicates import Replicates, replicates_of
from wovenfab.measured.thinning import NOISE, scatter_of, thinned
from wovenfab.study.fit.fit_file import MeasuredTest, read_fit

Array = NDArray[np.float64]
CASE = """\
sheet: {length: 200 mm, width: 100 mm, fibres: [45 deg, -45 deg]}
effects: {stretch: {stiffness: 2e4 N/m}, shear: {stiffness: 50 N/m}}
boundary: {left: clamp, right: {displacement: [program, 0]}}
program: {type: ramp, to: 30 mm, steps: 4}
"""


def record(seed: int, rows: int, turns: int, noise: float = 0.0) -> tuple[Measured, Array]:
    """Return a random record that reverses, with friction that jumps there, and its true force."""
    rng = np.random.default_rng(seed)
    ends = np.array([0.0, *(rng.uniform(0.4, 1.0, turns + 1) * (-1.0) ** np.arange(turns + 1))])
    way = np.abs(np.diff(ends))
    s = np.linspace(0.0, way.sum(), rows)
    u = np.interp(s, [0.0, *np.cumsum(way)], ends)
    sign = np.sign(np.gradient(u))
    a, b, c = rng.normal(size=3)
    force = 3 * u + a * u**3 + b * np.sin(4 * u + c) + 0.3 * sign + 2.0 * np.maximum(u - 0.3, 0)
    noisy = force + noise * rng.standard_normal(rows)
    return Measured(Path("a.csv"), 1e-3 * u, noisy), force


def distances(curves: Replicates, whole: Measured, force: Array) -> Array:
    """Return how far forces at all rows of a record are from lines between the rows left."""
    found = []
    pairs = zip(whole.branches(), curves.mean.branches(), strict=True)
    for number, (rows, left) in enumerate(pairs):
        u, f = curves.mean.displacement[left], curves.mean.force[left]
        way = slice(None) if u[0] < u[-1] else slice(None, None, -1)
        assert (np.diff(u[way]) > 0).all()
        own = rows[number > 0 :]
        found.append(force[own] - np.interp(whole.displacement[own], u[way], f[way]))
    return np.abs(np.concatenate(found))


@pytest.mark.parametrize("turns", [0, 1, 4])
@pytest.mark.parametrize("seed", range(6))
def test_no_row_of_a_smooth_record_is_farther_than_the_error(seed: int, turns: int) -> None:
    whole, force = record(seed, 4000, turns)
    error = 10.0 ** -np.random.default_rng(seed).uniform(3, 5) * np.abs(force).max()
    curves, told = thinned(replicates_of([whole]), error)
    far = distances(curves, whole, whole.force)
    assert NOISE * told.scatter < 0.01 * error  # of a smooth curve between neighbouring rows
    assert far.max() <= error + NOISE * told.scatter
    assert told.deviation == pytest.approx(far.max() - NOISE * told.scatter)
    assert (told.before, told.after) == (4000, len(curves.mean.force))
    assert 52 * (turns + 1) < told.after < 2000
    assert curves.counts is not None and curves.counts.sum() == 4000
    kept = [whole.displacement[rows[0]] for rows in whole.branches()]
    assert [curves.mean.displacement[rows[0]] for rows in curves.mean.branches()] == kept


@pytest.mark.parametrize("turns", [0, 3])
@pytest.mark.parametrize("noise", [0.01, 0.1])
def test_noise_is_averaged_and_shape_is_kept(noise: float, turns: int) -> None:
    whole, force = record(11, 20_000, turns, noise)
    assert scatter_of(whole) == pytest.approx(noise, rel=0.05)
    error = 0.02
    curves, told = thinned(replicates_of([whole]), error)
    assert told.after < 500
    far = distances(curves, whole, force)  # from the truth without noise
    # Noise of means: of 20 rows at least, but at reversals.
    assert np.quantile(far, 0.98) < error + 4 * noise / np.sqrt(20)
    assert np.sqrt(np.mean(far**2)) < error


def test_a_smaller_error_keeps_more_rows_and_a_tiny_one_all() -> None:
    whole, _ = record(3, 300, 1)
    counts = [thinned(replicates_of([whole]), error)[1].after for error in (1e-1, 1e-2, 1e-3, 0)]
    assert counts == sorted(counts) and 100 < counts[0] < 120
    assert counts[-1] > 250


def test_a_scale_that_is_fitted_moves_by_less_than_the_error_implies() -> None:
    # Of F = K g(u) least squares gives K; an error e of all forces moves it by at most
    # e sum|g|/sum g^2.
    whole, force = record(5, 8000, 2)
    g = force / 2.5
    size = np.abs(force).max()
    for error in (1e-2 * size, 1e-3 * size):
        curves, _ = thinned(replicates_of([whole]), error)
        at = np.concatenate([
            np.interp(
                curves.mean.displacement[left], *(
                    v[rows][np.argsort(whole.displacement[rows])] for v in (whole.displacement, g)
                )
            )[number > 0 :]
            for number, (rows, left) in enumerate(
                zip(whole.branches(), curves.mean.branches(), strict=True)
            )
        ])  # fmt: skip
        weights = curves.shares
        fitted = (weights * at) @ curves.mean.force / ((weights * at) @ at)
        assert abs(fitted - 2.5) < error * np.abs(g).sum() / (g @ g)


def test_specimens_are_thinned_at_the_same_places() -> None:
    whole, _ = record(7, 3000, 1)
    stiffer = Measured(Path("b.csv"), whole.displacement, 1.1 * whole.force)
    curves, _ = thinned(replicates_of([whole, stiffer]), 0.05)
    assert curves.forces.shape == (2, len(curves.mean.force))
    np.testing.assert_allclose(curves.forces[1], 1.1 * curves.forces[0])
    np.testing.assert_allclose(curves.forces.mean(axis=0), curves.mean.force)


def test_a_fit_file_thins_and_weighs_each_mean_by_its_rows(tmp_path: Path) -> None:
    (tmp_path / "case.yaml").write_text(CASE)
    u = np.linspace(0, 30, 5000)
    rows = "\n".join(f"{a},{b}" for a, b in zip(u, 1e-3 * u**3, strict=True))
    (tmp_path / "curve.csv").write_text(f"u_mm,F_N\n{rows}\n")

    def test_of(thin: str) -> MeasuredTest:
        (tmp_path / "fit.yaml").write_text(
            f"tests: [{{case: case.yaml, measured: curve.csv, thin: {thin}}}]\n"
            "parameters: {shear.stiffness: }\n"
        )
        (test,) = read_fit(tmp_path / "fit.yaml").tests
        assert isinstance(test, MeasuredTest)
        return test

    test = test_of("0.1 %")
    assert test.thinning is not None and test.thinning.after == test.factors.size < 100
    assert test.thinning.deviation <= 0.001 * 27.0
    counts = test.replicates.counts
    assert counts is not None
    # Together they weigh as so many rows with the error as it is stated, each by its share.
    np.testing.assert_allclose(test.factors**2 * 0.27**2, counts / counts.mean())
    in_newtons = test_of("0.027 N").thinning
    assert in_newtons is not None and in_newtons.after == test.thinning.after
    with pytest.raises(CaseError, match=r"fit\.yaml"):
        test_of("often")
