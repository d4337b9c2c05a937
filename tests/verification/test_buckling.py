"""Where a strip of yarns buckles, and how it goes on: Euler's columns and the elastica.

The yarns run along x from clamp to clamp. They slide on each other without resistance where
there is no shear stiffness, so that the strip is a bundle of columns with EI = K_b width.
"""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

from tests import scenes
from wovenfab.model.model import Model, Numerics
from wovenfab.stepping.program import program_of, ramp
from wovenfab.stepping.stability import StabilityLostError

#: Length 1 and K_b = 1.
WIDTH = 0.0625
K_E = 1e5
BOTH = ("left", "right")


def strip(cells: int, degree: int, shear: float, held: tuple[str, ...]) -> Model:
    """Return a strip of yarns along x with ``cells`` cells over its length."""
    values = {
        "stretch": {"stiffness": (K_E, K_E)},
        "shear": {"stiffness": shear},
        "bending": {"stiffness": (1.0, 1.0)},
    }
    on = scenes.sheet(1.0, WIDTH, 1 / cells, fibres=scenes.ALONG)
    return scenes.model(on, scenes.BONDED, Numerics(degree), values, rotation_edges=held)


def euler(wave: float, shear: float) -> tuple[float, float]:
    """Return load (N) and shortening at which extensible yarns buckle, w ~ cos(wave x).

    A straight yarn of stretch 1 - u carries K_e u for each width. Its second variation is
    K_b w''²/(1-u)² + S w'²/(1-u)² - K_e u w'²/(1-u), where S is the shear stiffness in
    series with that of the cross yarns, which turn with the section if the yarns stretch.
    """
    section = K_E * WIDTH**2 / 12 * wave**2
    resistance = wave**2 + (1 / (1 / shear + 1 / section) if shear else 0.0)
    u = brentq(lambda u: K_E * u * (1 - u) - resistance, 0.0, 0.1)
    return K_E * u * WIDTH, u


def critical(cells: int, degree: int, shear: float, held: tuple[str, ...]) -> tuple[float, float]:
    """Return the relative errors of critical load and shortening."""
    load, shortening = euler(2 * pi if held else pi, shear)
    model = strip(cells, degree, shear, held)
    program = program_of([ramp(0.0, 1.25 * shortening, 1.0, 1)])
    failure = scenes.push(model, program, "stop", 2.0**-24).failure
    assert isinstance(failure, StabilityLostError)
    loss = failure.loss
    assert loss.negatives == 1
    return -loss.reactions["right"][0] / load - 1, loss.displacement / shortening - 1


@pytest.mark.parametrize(
    ("degree", "cells", "order"), [pytest.param(2, 16, 2, marks=pytest.mark.slow), (3, 8, 4)]
)
def test_yarns_with_held_ends_buckle_at_eulers_load(degree: int, cells: int, order: int) -> None:
    errors = np.array([critical(n, degree, 0.0, BOTH) for n in (cells, 2 * cells)])
    (observed,) = scenes.orders(errors[:, 0])
    print(f"\nP{degree}: errors {errors[:, 0]} at {cells} cells and twice, order {observed:.2f}")
    assert observed > order - 0.1  # twice that of the energy norm
    assert (errors[1] > 0).all()  # conforming or not: from above
    assert errors[1].max() < (2e-3 if degree == 2 else 2e-5)
    assert errors[:, 0] == pytest.approx(errors[:, 1], rel=1e-3)


def test_shear_stiffness_adds_to_the_load_as_in_timoshenkos_column() -> None:
    """Both waves vanish at held ends: 1 - cos of the deflection, sin of the section's turn."""
    errors = critical(16, 3, 20.0, BOTH)
    print(f"\nerror of the load with shear stiffness: {errors[0]:.1e}")
    assert errors == pytest.approx((0, 0), abs=1e-4)


def elastica(shortening: float) -> tuple[float, float]:
    """Return load over Euler's and deflection over length of a hinged inextensible yarn."""
    m = brentq(lambda m: 2 * (1 - ellipe(m) / ellipk(m)) - shortening, 1e-12, 0.99)
    return (2 * ellipk(m) / pi) ** 2, sqrt(m) / ellipk(m)


def test_the_branch_that_is_followed_is_the_elastica() -> None:
    model = strip(16, 3, 0.0, ())
    run = scenes.push(model, program_of([ramp(0.0, 0.3, 1.0, 6)]), "follow")
    assert run.failure is None
    assert not any(s.negatives for s in run.steps)
    (loss,) = [s.loss for s in run.steps if s.loss]
    assert loss.displacement == pytest.approx(euler(pi, 0.0)[1], rel=2e-3)
    end = run.steps[-1]
    expected = np.array(elastica(end.displacement))
    middle = np.abs(model.field.x.array[1::2]).max()
    observed = np.array([-end.reactions["right"][0] / WIDTH / pi**2, middle])
    print(f"\nload and deflection {observed / expected - 1} off the elastica")
    assert observed == pytest.approx(expected, rel=5e-4)
