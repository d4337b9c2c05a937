"""Tunnelling: the shear energy is finite again beyond its pole."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.hard.crossing import exact_crossing
from benchmarks.hard.measurement import Measurement
from benchmarks.hard.pictures import draw_tunnelling
from benchmarks.hard.row import Bound, Family, Figures, Row, Setting
from wovenfab.solver.globalisation import CROSSING_SHARE

STATES = 200
#: Margin of the random states, and the largest program (m) that they are torn towards.
LEAST_MARGIN, FAR = 1e-6, 0.5


def crossings(setting: Setting) -> Figures:
    """Step from random states, every other one aimed across the barrier; serial."""
    measurement, random = Measurement(setting), np.random.default_rng(7)
    crossing, field = measurement.equilibrium.crossing, measurement.model.field
    limits, exact, after = [], [], []
    for i in range(STATES):
        state = _random_state(measurement, random)
        if i % 2:
            direction = _across(measurement, random) - state
            field.x.array[:] = state
            field.x.array[:] += min(1.0, CROSSING_SHARE * crossing.limit(direction)) * direction
        else:
            measurement.constraints.set(FAR * random.uniform(-1, 1))
            measurement.model.last.x.array[:] = state
            measurement.equilibrium.solve()  # one iteration: Newton's direction and what it accepts
        after.append(crossing.margin())
        field.x.array[:] = state
        limits.append(crossing.limit(crossing.direction.x.array))
        f, df = crossing.derivatives(crossing.direction.x.array)
        exact.append(min(exact_crossing(f[k], df[k]) for k in range(len(f))))
    unknowns = measurement.model.unknowns
    measurement.destroy()
    pairs = [(a, b) for a, b in zip(limits, exact, strict=True) if np.isfinite(b)]
    wrong = sum(np.isfinite(limits) != np.isfinite(exact))
    return Figures(
        unknowns, STATES, mean=1.0, worst=1, cutbacks=0, margin=min(after), imbalance=None,
        series={"limit": [a for a, _ in pairs], "exact": [b for _, b in pairs]},
    ).with_checks(
        error_of_the_limit=max(abs(a - b) / b for a, b in pairs),
        wrong_limits=float(wrong),
        aimed_beyond=float(sum(b < 1 for _, b in pairs)),
    )  # fmt: skip


def _random_state(measurement: Measurement, random: np.random.Generator) -> NDArray[np.float64]:
    """Return a random admissible state, and leave the field there."""
    field = measurement.model.field.x.array
    while True:
        field[:] = 0.05 * random.uniform() * random.standard_normal(field.size)
        if measurement.equilibrium.crossing.margin() > LEAST_MARGIN:
            return np.array(field)


def _across(measurement: Measurement, random: np.random.Generator) -> NDArray[np.float64]:
    """Return a state in which the families have changed places, and more."""
    d = measurement.model.sheet.fibres
    gradient = random.uniform(0.3, 3.0) * d[::-1].T @ np.linalg.inv(d.T) - np.eye(2)
    step = measurement.model.field
    step.interpolate(lambda x: gradient @ x[:2])
    noise = 0.01 * random.standard_normal(step.x.array.size)
    return np.array(step.x.array + noise)


FAMILY = Family(
    number=3,
    title="Tunnelling",
    text=(
        "The energy of shear has a pole where the families align and is finite beyond it, so that "
        "a Newton step can tunnel through. From 200 random states, half of them with Newton's own "
        "direction towards a random grip displacement, half aimed at a sheet whose families have "
        "changed places, the limit of the step is compared with the exact crossing: roots of the "
        "quadratic with rational coefficients, to 60 digits."
    ),
    rows=(
        Row(
            name="tunnelling",
            title=f"{STATES} random states and directions",
            hard="half the steps lead beyond the barrier, where the energy is finite",
            remedy="exact step limit",
            setting=Setting(
                "bonded-1x3",
                (
                    "sheet.length=600 mm",
                    "discretisation.mesh_size=150 mm",
                    "solver.max_iterations=1",
                ),
            ),
            measure=crossings,
            quick=("discretisation.mesh_size=300 mm",),
            bounds=(
                Bound("margin", least=0.0),
                Bound("error of the limit", most=1e-12),
                Bound("wrong limits", most=0),
                Bound("aimed beyond", least=STATES / 2),
            ),
        ),
    ),
    draw=draw_tunnelling,
)
