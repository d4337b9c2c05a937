"""Contrasts: stiffnesses that differ by many orders of magnitude, against the limit models."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from benchmarks.hard.measurement import last_force, measured
from benchmarks.hard.pictures import draw_contrasts
from benchmarks.hard.row import Bound, Family, Figures, Row, Setting, together

STEPS = ("program.to=40 mm", "program.steps=4")
AUTO = "discretisation.penalty=auto"
BONDED = Setting("bonded-1x3", (*STEPS, AUTO, "discretisation.degree=3"))
TIED = Setting("elastic-1x3", STEPS)
#: Stiffest coupling that is asked for, and those that reach the bonded limit, N/m^3.
COUPLINGS, STIFFER = (1e0, 1e2, 1e4, 1e6, 1e8, 1e10, 1e12), (1e14, 1e16)
#: By default only meshes of one placement are graded; such cells resolve the decay of the slip.
SAME_MESH = "discretisation.corner_size=2 mm"
FEW, WHOLE = Bound("worst", most=10), Bound("cutbacks", most=0)
CLOSE = Bound("difference from the limit", most=1e-3)
QUICK = ("discretisation.mesh_size=100 mm",)
COARSE = ("discretisation.mesh_size=150 mm", "program.steps=2")
#: Elements that bend without stretching.
ACCURATE = (
    "discretisation.mesh=fibres",
    "discretisation.degree=4",
    "discretisation.mesh_size=50 mm",
)
UNGRADED = (*QUICK, "discretisation.corner_size=100 mm")


def against(limit: Callable[[Setting], Setting]) -> Callable[[Setting], Figures]:
    """Return a measure: the force compared with that of a limit model."""

    def measure(setting: Setting) -> Figures:
        figures = measured(setting)
        exact = last_force(limit(setting))
        return figures.with_checks(
            difference_from_the_limit=abs(figures.series["force"][-1] / exact - 1)
        )

    return measure


def finer(setting: Setting) -> Setting:
    """Return the setting with cells of half the size."""
    size = setting.case.discretisation.mesh_size
    assert size is not None
    return setting.but(f"discretisation.mesh_size={size / 2}")


def bonded(setting: Setting) -> Setting:
    """Return the setting of two placements with one instead, on the same mesh."""
    return setting.but("effects.coupling=null")


def coupled(stiffnesses: tuple[float, ...], setting: Setting) -> Figures:
    """Run with each coupling; compare the forces with each other and the bonded one.

    The bonded sheet has the same mesh, so that its states are among those of two placements.
    """
    runs = [
        measured(setting.but(f"effects.coupling.stiffness={stiffness!r}"))
        for stiffness in stiffnesses
    ]
    forces = [figures.series["force"][-1] for figures in runs]
    limit = last_force(bonded(setting))
    return together(runs, {"stiffness": stiffnesses, "force": forces, "limit": limit}).with_checks(
        force_over_the_bonded=max(forces) / limit,
        growth_with_the_coupling=min(
            (b - a) / limit for a, b in zip([0.0, *forces], forces, strict=False)
        ),
        difference_from_the_limit=abs(forces[-1] / limit - 1),
    )


FAMILY = Family(
    number=5,
    title="Contrasts",
    text=(
        "Forces at 40 mm. The differences from a limit model are relative. At K_c = 1e12 N/m³, "
        "the stiffest coupling asked for, the sheet of Table 1 is *not* within 0.1 % of the bonded "
        "one, and must not be: its yarns slide along themselves over sqrt(K_e/K_c) = 11 mm at the "
        "ends. The row shows that the force grows towards the bonded one of the same mesh and "
        "stays below it; the next row, that 1e16 N/m³ (0.1 mm) is there. At 1e10 N/m³ a long first "
        "step passes a saddle, and goes on by the positive part of the tangent. "
        "At 1 N/m³ yarns slide along curved valleys of the potential, which full steps may leave "
        "a little. "
        "Nearly inextensible yarns (K_e/K_s = 1e9 by way of K_e) need a mesh along the fibres: "
        "on any other, cells that cannot bend without stretching lock."
    ),
    rows=(
        Row(
            name="contrast-soft-shear",
            title="K_e/K_s = 1e9 by K_s = 0.127 N/m, against no shear",
            hard="shear resists nothing; bending alone carries the sheet",
            remedy="symmetric factorisation, exact tangent",
            setting=BONDED.but("effects.shear.stiffness=0.127 N/m"),
            measure=against(lambda s: s.but("effects.shear=null")),
            bounds=(FEW, WHOLE, CLOSE),
            quick=QUICK,
        ),
        Row(
            name="contrast-stiff-yarns",
            title="K_e/K_s = 1e9 by K_e = 4e11 N/m, against cells of half the size",
            hard="yarns are inextensible to a part in a million, kinks are 0.03 mm wide",
            remedy="mesh along the fibres, P4",
            setting=BONDED.but(
                "effects.stretch.stiffness=4e11 N/m",
                *ACCURATE,
            ),
            measure=against(finer),
            bounds=(FEW, WHOLE, Bound("difference from the limit", most=0.02)),
            quick=COARSE,
            quick_bounds=(Bound("difference from the limit", most=0.05),),
        ),
        Row(
            name="contrast-no-bending",
            title="K_b = 1e-6 N m, against no bending",
            hard="14 orders between stretch and bending, which alone couples the cells' slopes",
            remedy="symmetric factorisation, exact tangent",
            setting=BONDED.but("effects.bending.stiffness=1e-6 N*m"),
            measure=against(lambda s: s.but("effects.bending=null", "discretisation.penalty=null")),
            bounds=(FEW, WHOLE, CLOSE),
            quick=QUICK,
        ),
        Row(
            name="contrast-stiff-bending",
            title="K_b = 1e4 N m, against cells of half the size",
            hard="yarns like rods: bending outweighs shear",
            remedy="symmetric factorisation, exact tangent",
            setting=BONDED.but(
                "effects.bending.stiffness=1e4 N*m",
                *ACCURATE,
            ),
            measure=against(finer),
            bounds=(FEW, WHOLE, Bound("difference from the limit", most=0.02)),
            quick=COARSE,
            quick_bounds=(Bound("difference from the limit", most=0.05),),
        ),
        Row(
            name="contrast-coupling",
            title="K_c from 1 to 1e12 N/m³, elastic",
            hard="families from free of each other to tied",
            remedy="placements that jump; positive part of the tangent, steps that may rise",
            setting=TIED.but(SAME_MESH),
            measure=partial(coupled, COUPLINGS),
            bounds=(
                FEW,
                Bound("cutbacks", most=8),
                Bound("growth with the coupling", least=0.0),
                Bound("force over the bonded", most=1.0),
            ),
            quick=(*UNGRADED, "program.steps=1"),
        ),
        Row(
            name="contrast-bonded",
            title="K_c = 1e14 and 1e16 N/m³, the latter against bonded on the same mesh",
            hard="coupling and stretch differ by 8 orders",
            remedy="one continuous placement each",
            setting=TIED.but(SAME_MESH, "discretisation.jumps=false"),
            measure=partial(coupled, STIFFER),
            bounds=(
                FEW,
                WHOLE,
                CLOSE,
                Bound("growth with the coupling", least=0.0),
                Bound("force over the bonded", most=1.0),
            ),
            quick=(*UNGRADED, "program.steps=1"),
        ),
    ),
    draw=draw_contrasts,
)
