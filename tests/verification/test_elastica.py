"""A yarn that bends like an elastica: large rotations, held direction, no shear stiffness.

The sheet is a strip of parallel cantilevers along x. Its left edge holds place and
direction, its right edge is moved across and is free along.
"""

from __future__ import annotations

from math import asin, sin, sqrt

import numpy as np
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

from tests import scenes
from wovenfab.model.constraints import Grip, Held
from wovenfab.model.model import Numerics
from wovenfab.stepping.program import program_of, table

LOADS = (1.0, 2.0, 5.0, 10.0)
WIDTH = 0.0625
#: Length 1 and K_b = 1; the yarn's own stretch is P/K_e, at most 1e-6.
VALUES = {
    "stretch": {"stiffness": (1e7, 1e7)},
    "shear": {"stiffness": 0.0},
    "bending": {"stiffness": (1.0, 1.0)},
}
GRIPS = (Grip("left", (Held(), Held())), Grip("right", (None, Held(1.0))))


def elastica(load: float) -> tuple[float, float]:
    """Return shortening and deflection over length for P L²/EI, by elliptic integrals."""
    root = sqrt(load)

    def start(m: float) -> float:
        return asin(1 / sqrt(2 * m))

    m = brentq(lambda m: ellipk(m) - ellipkinc(start(m), m) - root, 0.5 + 1e-12, 1 - 1e-12)
    shortening = 1 - sqrt(2 * sin(asin(2 * m - 1))) / root
    return shortening, 1 - 2 * (ellipe(m) - ellipeinc(start(m), m)) / root


def errors(cells: int) -> np.ndarray:
    """Return the relative errors of load and shortening, shape (loads, 2)."""
    on = scenes.sheet(1.0, WIDTH, 1 / cells, fibres=scenes.ALONG)
    model = scenes.model(on, scenes.BONDED, Numerics(3), VALUES, rotation_edges=("left",))
    exact = np.array([elastica(load) for load in LOADS])
    program = program_of(table(0.0, (1.0, 2.0, 3.0, 4.0), tuple(exact[:, 1])))
    run = scenes.run(model, program, grips=GRIPS)
    assert run.failure is None
    tip = 2 * model.placements.on_facets(on.edge_facets("right"), 0)
    planned = [i for i, s in enumerate(run.steps) if s.milestone is not None and s.number]
    loads = [run.steps[i].reactions["right"][1] / WIDTH for i in planned]
    shortenings = [-run.fields[i][tip].mean() for i in planned]
    return np.abs(np.stack([loads, shortenings], 1) / np.stack([LOADS, exact[:, 0]], 1) - 1)


def test_the_closed_form_is_the_tabulated_elastica() -> None:
    known = {1: (0.056433, 0.301721), 2: (0.160642, 0.493457), 5: (0.387628, 0.713792)}
    for load, pair in known.items():
        assert np.round(elastica(load), 6).tolist() == list(pair)


def test_cubic_elements_converge_to_the_elastica_at_every_load() -> None:
    coarse, fine = errors(16), errors(32)
    (order,) = scenes.orders([coarse[:, 0].max(), fine[:, 0].max()])
    print(f"\nP L²/EI {LOADS}: errors of load {fine[:, 0]}, of shortening {fine[:, 1]}")
    print(f"order of the load {order:.1f}, theory 4 (twice that of the energy norm)")
    assert fine.max() < 1e-4
    assert order > 3.5
