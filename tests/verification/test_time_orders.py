"""What each time scheme promises: its order in force and losses, and its energy balance.

One cycle of the bias-extension sample on a coarse mesh. The speeds leave the friction
between viscous and saturated (eta times the rate of order one), so that its switch at a
reversal takes several steps; faster, every scheme needs more steps before its order shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from math import pi

import numpy as np
import pytest
from numpy.typing import NDArray

from tests import scenes
from wovenfab.stepping.program import cycle, program_of
from wovenfab.stepping.schemes import SCHEMES
from wovenfab.stepping.step import Step

COUNTS = (20, 40, 80, 160)
AMPLITUDE = 0.04
#: Effects, grip speed (m/s) and mesh size (m).
SCENES = {
    "slip": ((*scenes.COUPLED, "slip_friction"), 0.1, 0.3),
    "spin": (("stretch", "shear", "spin_friction"), 0.005, 0.15),
}
#: Largest energy imbalance over dissipated energy at the end of a cycle of 80 steps.
IMBALANCE = {"backward-euler": 5e-3, "bdf2": 5e-3, "bdf3": 2e-3, "midpoint": 5e-6}

#: Two scenes, of which one is in make test.
in_each = pytest.mark.parametrize("scene", ["slip", pytest.param("spin", marks=pytest.mark.slow)])


def refinements(scene: str, scheme: str) -> tuple[list[Step], ...]:
    """Return the steps at 20 equal times of a cycle with 20, 40, 80 and 160 steps."""
    names, speed, size = SCENES[scene]
    numerics = replace(scenes.PROTOTYPE, history=max(2, SCHEMES[scheme].memory))
    model = scenes.model(scenes.sheet(mesh_size=size), names, numerics)
    programs = (program_of(cycle(0.0, AMPLITUDE, pi * AMPLITUDE / speed, n)) for n in COUNTS)
    runs = (scenes.march(model, program, scheme) for program in programs)
    planned = ([s for s in steps if s.milestone is not None] for steps in runs)
    return tuple(steps[:: (len(steps) - 1) // 20] for steps in planned)


def orders(curves: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return the orders of convergence from the differences of successive refinements."""
    return scenes.orders([np.linalg.norm(b - a) for a, b in pairwise(curves)])


@in_each
def test_force_and_loss_converge_with_the_schemes_order_to_the_same_loop(scene: str) -> None:
    """And work is stored or dissipated to that order."""
    finest = []
    for scheme in SCHEMES:
        runs = refinements(scene, scheme)
        assert_orders(scene, scheme, runs)
        assert_balance(scene, scheme, [steps[-1] for steps in runs])
        finest.append(runs[-1])
    *others, last = finest
    force, loss = scenes.forces(last), scenes.lost(last[-1])
    for other in others:
        assert scenes.forces(other) == pytest.approx(force, abs=0.01 * force.max())
        assert scenes.lost(other[-1]) == pytest.approx(loss, rel=0.03)


def assert_orders(scene: str, scheme: str, runs: Sequence[list[Step]]) -> None:
    theory = SCHEMES[scheme].order
    force = orders([scenes.forces(steps) for steps in runs])
    dissipated = orders([np.array([*map(scenes.lost, steps)]) for steps in runs])
    print(f"\n{scene}, {scheme}: observed {np.round(force, 2)} in force, ", end="")
    print(f"{np.round(dissipated, 2)} in dissipated energy, theory {theory}")
    if theory == 3:  # differences change their sign on the way, and so fall faster at times
        assert min(force[-1], dissipated[-1]) > 2.7
        return
    assert force[-1] == pytest.approx(theory, abs=0.2)
    assert dissipated[-1] == pytest.approx(theory, abs=0.2)


def assert_balance(scene: str, scheme: str, ends: Sequence[Step]) -> None:
    shares = np.array([abs(scenes.imbalance(end)) / scenes.lost(end) for end in ends])
    fall = scenes.orders(shares).mean()
    print(f"{scene}, {scheme}: imbalance {shares} of the loss, order {fall:.2f}")
    assert shares[COUNTS.index(80)] < IMBALANCE[scheme]
    assert fall > min(SCHEMES[scheme].order, 2) - 0.15  # work is summed by the trapezoidal rule


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["backward-euler", "midpoint"])
def test_without_friction_work_is_stored_with_order_two_and_given_back(scheme: str) -> None:
    """The trapezoid sums the work, whatever the scheme; a symmetric cycle cancels its error."""
    model = scenes.model(scenes.sheet(), scenes.BONDED, scenes.PROTOTYPE)
    missing = []
    for n in (60, 120, 240):
        steps = scenes.march(model, program_of(cycle(0.0, 0.005, 1.0, n)), scheme)
        top = steps[n // 2]
        missing.append(abs(top.work / scenes.stored(top) - 1))
        assert abs(steps[-1].work) < 1e-8 * top.work
        assert abs(scenes.stored(steps[-1])) < 1e-8 * top.work
    fall = scenes.orders(missing)
    print(f"\n{scheme}: work over stored energy at the top less one {missing}, orders {fall}")
    assert fall[-1] == pytest.approx(2.0, abs=0.2)
    assert missing[-1] < 1e-6
