"""Locking: the yarns of the two families all but align."""

from __future__ import annotations

import numpy as np

from benchmarks.hard.measurement import Measurement
from benchmarks.hard.pictures import draw_locking
from benchmarks.hard.row import Bound, Family, Figures, Row, Setting

ADMISSIBLE = Bound("margin", least=1e-6)
PULL = Setting("bonded-1x3", ("discretisation.penalty=auto", "discretisation.degree=3"))


def growth(setting: Setting) -> Figures:
    """Run, and measure how smoothly the force grows; collective."""
    measurement = Measurement(setting).run()
    gains = np.diff(measurement.force)
    ratios = gains[1:] / gains[:-1]
    if not len(ratios):
        return measurement.figures()
    return measurement.figures(least_growth=float(ratios.min()), largest_growth=float(ratios.max()))


def _row(length: str, ratio: str, to: str, stiffness: int) -> Row:
    return Row(
        name=f"locking-{ratio.replace(':', 'x')}-{stiffness}",
        title=f"bonded {ratio} to {to} in 24 steps, K_s = {stiffness} N/m",
        hard="beyond the inextensible sheet's locking; the force grows by orders of magnitude",
        remedy="exact step limit, line search on the potential",
        setting=PULL.but(
            f"sheet.length={length}",
            f"program.to={to}",
            "program.steps=24",
            f"effects.shear.stiffness={stiffness} N/m",
        ),
        measure=growth,
        bounds=(
            Bound("worst", most=12),
            Bound("cutbacks", most=0),
            ADMISSIBLE,
            Bound("least growth", least=1.0),
            Bound("largest growth", most=2.5),
        ),
        quick=("discretisation.mesh_size=100 mm",),
    )


FAMILY = Family(
    number=2,
    title="Locking",
    text=(
        "The inextensible 1:2 sheet locks at 124 mm, the 1:3 sheet at 249 mm. Growth is the "
        "increment of force of a step over that of the step before: never below 1, for the force "
        "is convex, and without a jump. The smallest margin is taken over all iterates, those on "
        "the way included. Far beyond locking, on cells of 150 mm, the yarns align at a point on "
        "the free edge, where no energy of the discrete sheet acts: the run stops and says so."
    ),
    rows=(
        _row("600 mm", "1:2", "130 mm", 400),
        _row("600 mm", "1:2", "130 mm", 4),
        _row("900 mm", "1:3", "260 mm", 400),
        _row("900 mm", "1:3", "260 mm", 4),
        Row(
            name="locking-one-step",
            title="bonded 1:2 to 130 mm in one step, 0.1 mm at the corners",
            hard="one step from rest to beyond locking, on a mesh that spans four decades",
            remedy="positive part of the tangent, line search on the potential",
            setting=PULL.but(
                "sheet.length=600 mm",
                "program.to=130 mm",
                "program.steps=1",
                "discretisation.mesh=unstructured",
                "discretisation.mesh_size=50 mm",
                "discretisation.corner_size=0.1 mm",
            ),
            measure=growth,
            # Attempts that are given up come nearer to the barrier than a step that succeeds.
            bounds=(Bound("cutbacks", most=12), Bound("margin", least=1e-10)),
            quick=("discretisation.mesh_size=100 mm", "discretisation.corner_size=1 mm"),
            quick_bounds=(ADMISSIBLE,),
        ),
        Row(
            name="locking-end",
            title="bonded 1:2 to 300 mm in 60 steps, cells of 150 mm",
            hard="2.4 times the displacement at which the sheet locks: here physics ends",
            remedy="stop with a diagnosis",
            setting=Setting(
                "bonded-1x3",
                (
                    "sheet.length=600 mm",
                    "program.to=300 mm",
                    "program.steps=60",
                    "discretisation.mesh_size=150 mm",
                ),
            ),
            measure=growth,
            bounds=(Bound("margin", least=0.0), Bound("steps", least=30)),
            stops="the sheet locks",
        ),
    ),
    draw=draw_locking,
)
