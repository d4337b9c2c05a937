"""Dead loads, one family of an edge, and values that vary over the sheet, in closed form."""

from __future__ import annotations

import numpy as np
import pytest
import ufl

from tests import scenes
from wovenfab.model.constraints import EdgeLoad, Grip, Held
from wovenfab.model.model import Model
from wovenfab.solver.problem import SolverOptions

LEFT, TIGHT = (Grip("left", scenes.CLAMP),), SolverOptions(tolerance=1e-12)
STIFFNESS, LENGTH, WIDTH = 1e4, 0.9, 0.3
STRETCHED = {"stretch": {"stiffness": (STIFFNESS, STIFFNESS)}, "shear": {"stiffness": 400.0}}


def strip(values: dict, loads: tuple[EdgeLoad, ...] = ()) -> Model:
    """Return a strip with its first family along it."""
    sheet = scenes.sheet(fibres=scenes.ALONG)
    return scenes.model(sheet, tuple(values), values=values, loads=loads)


def tip(model: Model) -> float:
    """Return the largest displacement along the strip (m)."""
    return float(model.field.x.array.reshape(-1, 2)[:, 0].max())


def test_a_dead_load_stretches_a_strip_by_force_over_stiffness() -> None:
    load = 120.0
    model = strip(STRETCHED, (EdgeLoad("right", (0, 1), (load, 0.0)),))
    held = scenes.force(model, LEFT, 0.0, TIGHT)
    assert tip(model) == pytest.approx(load / STIFFNESS * LENGTH, rel=1e-9)
    assert held["left"] == pytest.approx((-load * WIDTH, 0.0), abs=1e-8)
    work = model.loading.force() @ model.field.x.array
    assert work == pytest.approx(load * WIDTH * tip(model), rel=1e-9)


def test_a_stiffness_that_varies_along_the_strip_acts_as_springs_in_series() -> None:
    """K(x) = K_0 (1 + x/L): the compliance is the integral of 1/K, L log(2)/K_0."""
    stretch = {"stiffness": (lambda x: STIFFNESS * (1 + x[0] / LENGTH),) * 2}
    load = 10.0
    model = strip({**STRETCHED, "stretch": stretch}, (EdgeLoad("right", (0, 1), (load, 0.0)),))
    scenes.force(model, LEFT, 0.0, TIGHT)
    assert tip(model) == pytest.approx(load * LENGTH * np.log(2) / STIFFNESS, rel=1e-4)


def test_a_bending_stiffness_may_vary_over_the_facets_too() -> None:
    sheet = scenes.sheet()
    field = {"stiffness": (lambda x: 254.1 + 0 * ufl.sin(x[0]),) * 2}
    values = {**scenes.TABLE_1, "bending": field}
    varied = scenes.model(sheet, scenes.BONDED, values=values)
    expected = scenes.pull(scenes.model(sheet, scenes.BONDED), 0.02)
    assert scenes.pull(varied, 0.02) == pytest.approx(expected, rel=1e-9)


def test_an_edge_may_hold_one_family_alone() -> None:
    """The cross yarns are pulled; those along the strip follow by the coupling, and lag."""
    model = strip({**STRETCHED, "coupling": {"stiffness": 6e5}})
    grips = (*LEFT, Grip("right", (Held(1.0), Held()), families=(1,)))
    scenes.force(model, grips, 0.01, TIGHT)
    places, x = model.placements, model.field.x.array[::2]
    facets = model.sheet.edge_facets("right")
    along, across = (x[places.on_facets(facets, family)] for family in (0, 1))
    assert across == pytest.approx(0.01)
    assert (along < 0.0099).all()
