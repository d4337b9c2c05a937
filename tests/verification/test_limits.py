"""Limits: what a scene must tend to when a parameter becomes huge, zero or irrelevant."""

from __future__ import annotations

import numpy as np
import pytest

from tests import scenes
from wovenfab.model.model import Model, Numerics
from wovenfab.solver.problem import SolverOptions
from wovenfab.stepping.program import cycle, program_of
from wovenfab.stepping.step import Step

TWO_STEPS = Numerics(2, history=2)


def with_values(**changed: dict) -> dict:
    return {**scenes.TABLE_1, **changed}


def cycle_of(model: Model, steps: int = 8, period: float = 0.25) -> list[Step]:
    """Return the steps of one 20 mm cycle."""
    program = program_of(cycle(0.0, 0.02, period, steps))
    return scenes.march(model, program, "bdf2", options=SolverOptions(tolerance=1e-12))


def test_two_placements_tend_to_one_as_the_coupling_grows() -> None:
    """Measured: 1e12 N/m^3 is not enough for yarns as stiff as Table 1's.

    The slip along the yarns fades over sqrt(K_e/K_c), which is 11 mm at 1e12 and
    0.1 mm at 1e16 N/m^3; the force tends to the bonded one from below.
    """
    sheet = scenes.sheet(mesh_size=0.05)
    bonded = scenes.pull(scenes.model(sheet, scenes.BONDED, Numerics(3)), 0.04)
    gaps = []
    for coupling in (1e12, 1e14, 1e16):
        values = with_values(coupling={"stiffness": coupling})
        model = scenes.model(sheet, scenes.COUPLED, Numerics(3), values)
        gaps.append(1 - scenes.pull(model, 0.04) / bonded)
    print(f"\nforce below the bonded one by {np.array(gaps)} at 1e12, 1e14, 1e16 N/m^3")
    assert gaps[0] > gaps[1] > gaps[2] > 0
    assert gaps[2] < 1e-3


@pytest.mark.parametrize(
    ("scene", "nothing"),
    [
        ((*scenes.BONDED, "spin_friction"), {"spin_friction": {"strength": 0.0, "slope": 40.0}}),
        ((*scenes.COUPLED, "slip_friction"), {"slip_friction": {"strength": 0.0, "slope": 70.0}}),
        (scenes.BONDED, {"bending": {"stiffness": (0.0, 0.0)}}),
        (scenes.BONDED, {"shear": {"stiffness": 0.0}}),
    ],
    ids=lambda v: next(iter(v)) if isinstance(v, dict) else "",
)
def test_an_effect_of_zero_strength_is_left_out(scene: tuple[str, ...], nothing: dict) -> None:
    (name,) = nothing
    sheet = scenes.sheet()
    listed = cycle_of(scenes.model(sheet, scene, TWO_STEPS, with_values(**nothing)))
    left_out = cycle_of(scenes.model(sheet, [n for n in scene if n != name], TWO_STEPS))
    for a, b in zip(listed, left_out, strict=True):
        (force, _), (expected, _) = a.reactions["right"], b.reactions["right"]
        assert force == pytest.approx(expected, rel=1e-10, abs=1e-8)
        for effect, stored in b.stored.items():
            assert a.stored[effect] == pytest.approx(stored, rel=1e-9, abs=1e-12)


def test_viscous_slip_is_slip_friction_at_low_rates() -> None:
    """With c = zeta eta; eta w is about 0.01 here, and the laws differ by its square."""
    sheet = scenes.sheet()
    values = with_values(viscous_slip={"viscosity": 199.2e3 * 70.0})
    models = (
        scenes.model(sheet, (*scenes.COUPLED, name), TWO_STEPS, values)
        for name in ("slip_friction", "viscous_slip")
    )
    friction, viscous = (scenes.lost(cycle_of(model, 16, 5.0)[-1]) for model in models)
    assert friction > 0
    assert viscous == pytest.approx(friction, rel=1e-3)


@pytest.mark.slow
def test_quadratic_power_shear_is_the_tangent_law_at_small_angles() -> None:
    sheet = scenes.sheet()
    values = with_values(power_shear={"stiffness": 400.0, "power": 2.0})
    names = ("stretch", "bending", "power_shear")
    power = scenes.pull(scenes.model(sheet, names, values=values), 1e-3)
    tangent = scenes.pull(scenes.model(sheet, scenes.BONDED), 1e-3)
    assert power == pytest.approx(tangent, rel=1e-4)


def test_leaving_effects_out_leaves_out_what_only_they_need() -> None:
    sheet = scenes.sheet()
    whole = scenes.model(sheet, tuple(scenes.TABLE_1), TWO_STEPS)
    no_bending = [n for n in scenes.TABLE_1 if n != "bending"]
    assert whole.facet_integrals == 2 * 3  # of each family: tangent, residual, potential
    assert scenes.model(sheet, no_bending, TWO_STEPS).facet_integrals == 0
    elastic = scenes.model(sheet, scenes.COUPLED, TWO_STEPS)
    assert (elastic.power, elastic.rate_weights, elastic.history) == ({}, (), ())
    bonded = scenes.model(sheet, scenes.BONDED, TWO_STEPS)
    assert 2 * bonded.unknowns == elastic.unknowns == whole.unknowns
