"""The families never cross: the limit of a step, and what happens without it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests import scenes
from wovenfab.model.model import Model
from wovenfab.solver.globalisation import CROSSING_SHARE, first_crossing
from wovenfab.solver.newton import NewtonSolver

SHORT = 0.6  # 1:2, locks at 0.124 m
Array = NDArray[np.float64]


def cross(a: Array, b: Array) -> Array:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def states(number: int) -> tuple[Array, Array, float]:
    """Return random admissible fibre derivatives, changes of all sizes, and the orientation."""
    random = np.random.default_rng(41)
    f = random.standard_normal((4 * number, 2, 2))
    f = f[cross(f[:, 0], f[:, 1]) < -0.05][:number]
    df = random.standard_normal(f.shape) * 10.0 ** random.uniform(-2, 2, (len(f), 1, 1))
    aimed = np.arange(len(f)) % 2 == 0
    across = f[aimed][:, ::-1]  # the families change places
    df[aimed] = (across - f[aimed]) * random.uniform(0.2, 5, (aimed.sum(), 1, 1))
    df[aimed] += 0.1 * random.standard_normal(across.shape)
    return f, df, -1.0


def test_the_first_crossing_is_the_smallest_positive_root_of_the_quadratic() -> None:
    f, df, orientation = states(2000)
    assert len(f) == 2000
    found = first_crossing(f, df, orientation)
    crossed = 0
    for s, (f1, f2), (d1, d2) in zip(found, f, df, strict=True):
        polynomial = [cross(d1, d2), cross(d1, f2) + cross(f1, d2), cross(f1, f2)]
        roots = np.roots(polynomial)
        apart = abs(roots[0] - roots[1]) / abs(roots).max() if len(roots) == 2 else 1.0
        ahead = roots.real[(abs(roots.imag) == 0) & (roots.real > 0)]
        expected = ahead.min(initial=np.inf)
        # Roots that nearly coincide are known less well, by anyone.
        assert s == pytest.approx(expected, rel=1e-12 / min(apart, 1.0) ** 2)
        crossed += np.isfinite(expected)
    assert 1000 < crossed < 2000


@pytest.mark.parametrize("orientation", [1.0, -1.0])
def test_degenerate_directions_have_their_exact_crossing(orientation: float) -> None:
    x, y = np.array([1.0, 0.0]), np.array([0.0, orientation])
    cases = [
        # df_1, df_2 with c = 1 and f = (x, y); crossing
        (0 * x, 0 * y, np.inf),  # no motion
        (-x, 0 * y, 1.0),  # linear: a = 0
        (x, 0 * y, np.inf),  # linear, away
        (-x, y, 1.0),  # (1 - s)(1 + s): b = 0, a < 0
        (x, y, np.inf),  # (1 + s)²
        (2 * y, -2 * x, np.inf),  # 1 + 4 s²: b = 0, a > 0
        (2 * y, 2 * x, 0.5),  # 1 - 4 s²: b = 0, a < 0
        (-x, -y, 1.0),  # (1 - s)²: touches with a double root
        (-2 * x, -4 * y, 0.25),  # two roots ahead: the first
        (-x - y, -x - y, 0.5),  # parallel changes: a = 0
        (1e-300 * x, -y, 1.0),  # a vanishes against b
        (-1e8 * x, 1e-8 * y, 1e-8),  # badly scaled
    ]
    f = np.array([[x, y]] * len(cases))
    df = np.array([[a, b] for a, b, _ in cases])
    found = first_crossing(f, df, orientation)
    assert found == pytest.approx([s for *_, s in cases], rel=1e-12)


def test_no_crossing_lies_behind_even_where_round_off_has_put_the_state_on_the_barrier() -> None:
    f, df, orientation = states(500)
    for c in (0.0, -1e-17):
        on = f.copy()
        on[:, 1] = on[:, 0] * np.linalg.norm(on[:, 1], axis=1, keepdims=True)
        on[:, 1] += c * orientation * np.stack([-on[:, 0, 1], on[:, 0, 0]], axis=1)
        assert (first_crossing(on, df, orientation) >= 0).all()


def bonded() -> Model:
    return scenes.model(scenes.sheet(SHORT), scenes.BONDED, scenes.PROTOTYPE)


def test_no_random_direction_takes_a_step_out_of_the_admissible_set() -> None:
    model = bonded()
    equilibrium = scenes.solver(model)
    barrier, random = equilibrium.crossing, np.random.default_rng(42)
    x = model.field.x.petsc_vec.duplicate()
    y = x.duplicate()
    shortened, outside = 0, 0
    for _ in range(200):
        while True:  # an admissible state, the harder the better
            size = 0.05 * random.uniform()
            model.field.x.array[:] = size * random.standard_normal(model.field.x.array.size)
            if barrier.margin() > 1e-6:
                break
        x.array_w[:] = model.field.x.array
        y.array_w[:] = 10 ** random.uniform(-3, 1) * random.standard_normal(x.getSize())
        model.field.x.array[:] = x.array_r - y.array_r
        outside += barrier.margin() < 0
        shortened += equilibrium.newton.limit_step(x, y)
        model.field.x.array[:] = x.array_r - y.array_r
        assert barrier.margin() > 0
    assert shortened > 100
    assert outside > 100
    x.destroy()
    y.destroy()
    equilibrium.destroy()


def visited(displacement: float, size: float) -> tuple[list[float], bool]:
    """Return the margin of every iterate of one large step, and whether it converged."""
    model = scenes.model(scenes.sheet(SHORT, mesh_size=size), scenes.BONDED, scenes.PROTOTYPE)
    equilibrium = scenes.solver(model)
    constraints = equilibrium.problem.constraints
    margins = []
    equilibrium.newton.snes.setMonitor(lambda *_: margins.append(equilibrium.crossing.margin()))
    constraints.set(displacement)
    outcome = equilibrium.solve()
    margins.append(equilibrium.crossing.margin())
    equilibrium.destroy()
    return margins, outcome.converged


@pytest.mark.parametrize("displacement", [0.13, 0.2, 0.3])
def test_every_iterate_of_a_step_far_beyond_locking_is_admissible(displacement: float) -> None:
    margins, _ = visited(displacement, 0.05)
    assert min(margins) >= 0


def unlimited(newton: NewtonSolver, y: Any) -> float:
    """Note the step and take all of it."""
    newton.step[:] = -y.array_r
    return 1.0


def test_without_the_limit_a_step_tunnels_through_the_barrier_and_even_converges(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(NewtonSolver, "admissible_length", unlimited)
    margins, converged = visited(0.13, 0.05)
    assert converged and margins[-1] < -0.1
    monkeypatch.undo()
    margins, converged = visited(0.13, 0.05)
    assert converged and margins[-1] > 0.1


def test_a_limited_step_goes_its_share_of_the_way() -> None:
    model = bonded()
    equilibrium = scenes.solver(model)
    f_1_onto_f_2 = np.array([[-0.5, 1.0], [0.0, 0.0]])  # of the gradient, D = ±45°
    scenes.set_field(equilibrium.crossing.direction, lambda x: f_1_onto_f_2 @ x[:2])
    limit = equilibrium.crossing.limit(equilibrium.crossing.direction.x.array)
    x, y = model.field.x.petsc_vec.duplicate(), model.field.x.petsc_vec.duplicate()
    x.set(0.0)
    y.array_w[:] = -4 * limit * equilibrium.crossing.direction.x.array
    full = y.array_r.copy()
    assert equilibrium.newton.limit_step(x, y)
    assert y.array_r == pytest.approx(CROSSING_SHARE / 4 * full, rel=1e-12)
    equilibrium.destroy()
    x.destroy()
    y.destroy()
