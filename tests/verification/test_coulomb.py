"""Coulomb's law against closed forms, and against one scalar minimisation a step.

The second placement of a slider is held everywhere, so that the first slides on it.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from forms.catalogue import effects
from tests import scenes
from tests.verification.test_closed_forms import ALONG, K_C, SECOND_AT_REST, ZETA, whole
from wovenfab.model.constraints import Grip, Held
from wovenfab.model.loads import EdgeLoad
from wovenfab.model.model import Model, Numerics, build_model
from wovenfab.stepping.march import Step
from wovenfab.stepping.program import Program, cycle, program_of, ramp

SLIDER = ("coupling", "slip_friction:coulomb")
VALUES = {"coupling": {"stiffness": K_C}, "slip_friction": {"strength": ZETA}}
AREA = 0.02


def slider(degree: int = 1, law: str = "coulomb", slope: float = 0.0) -> Model:
    values = {**VALUES, "slip_friction": {"strength": ZETA, "slope": slope}}
    names = ("coupling", f"slip_friction:{law}")
    return scenes.model(whole(0.2, 0.1, 0.1, ALONG), names, Numerics(degree, history=2), values)


def imbalance(steps: list[Step]) -> float:
    """Return the largest energy that is missing, over all that is dissipated."""
    missing = [s.work - sum(s.stored.values()) - sum(s.dissipated.values()) for s in steps]
    return float(np.abs(missing).max() / sum(steps[-1].dissipated.values()))


def losses(steps: list[Step]) -> NDArray[np.float64]:
    return np.diff([sum(s.dissipated.values()) for s in steps])


@pytest.mark.parametrize("count", [4, 160])
def test_a_driven_slider_loses_four_zeta_times_the_amplitude_in_each_cycle(count: int) -> None:
    """Per area and component, however few the steps."""
    stroke = np.array([0.02, 0.01])
    drive = Grip("first", (Held(float(stroke[0])), Held(float(stroke[1]))), (0,))
    program = program_of([*cycle(0.0, 1.0, 2.0, count), *cycle(0.0, 1.0, 2.0, count)])
    steps = scenes.march(slider(), program, "backward-euler", (drive, SECOND_AT_REST))
    coulomb = 4 * ZETA * stroke.sum() / 2  # amplitudes about the mean are half the strokes
    assert steps[-1].dissipated["slip_friction"] == pytest.approx(2 * coulomb * AREA, rel=1e-12)
    assert (losses(steps) > 0).all()
    for before, now in zip(steps, steps[1:], strict=False):
        way = np.sign(now.displacement - before.displacement)
        force = (K_C * now.displacement * stroke + ZETA * way) * AREA
        assert now.reactions["first"] == pytest.approx(force, rel=1e-9)
    assert all(s.iterations <= 12 for s in steps)


def pushed(force: float, program: Program) -> tuple[list[Step], list[float]]:
    """Push a slider at the end of yarns that hardly stretch; return its slips (m)."""
    values = {"stretch": {"stiffness": (1e13, 1e13)}, **VALUES}
    chosen = [effects()["stretch"], *(scenes.effect(name) for name in SLIDER)]
    load = EdgeLoad("right", (0,), (lambda x, t: force * 0.2 * t, 0.0))
    numerics = Numerics(1, history=1)
    model = build_model(whole(0.2, 0.1, 0.1, ALONG), chosen, values, numerics, loads=[load])
    slips = []

    def look(_: Step) -> None:
        slips.append(float(model.field.x.array.reshape(-1, 2)[::2, 0].mean()))

    return scenes.march(model, program, grips=(SECOND_AT_REST,), look=look), slips


def test_a_pushed_slider_moves_by_what_its_bound_leaves_over() -> None:
    """K_c b + zeta sign(db/dt) = f, and at rest while the spring needs less than zeta."""
    loads = [0.5, 1.0, 1.5, 3.0, 2.0, 1.0, 0.5, -1.0, -3.0, 0.0, 2.5]  # of zeta
    way = [ramp(a, b, 1.0, 1) for a, b in zip([0.0, *loads], loads, strict=False)]
    _, slips = pushed(ZETA, program_of(way))
    b, exact = 0.0, []
    for load in loads:
        b = min(max(b, (load - 1) * ZETA / K_C), (load + 1) * ZETA / K_C)
        exact.append(b)
    assert slips[1:] == pytest.approx(exact, abs=1e-9 * ZETA / K_C)
