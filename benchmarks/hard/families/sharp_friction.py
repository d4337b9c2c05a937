"""Sharp friction: laws from gentle to all but set-valued, and Coulomb's own."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import ufl
from numpy.typing import NDArray

from benchmarks.hard.measurement import Measurement
from benchmarks.hard.pictures import draw_friction
from benchmarks.hard.row import Bound, Family, Figures, Row, Setting, together
from wovenfab.forms.balance import Balance
from wovenfab.forms.effect import Term
from wovenfab.forms.kinematics import point_of
from wovenfab.model.assembly import compile_expression
from wovenfab.stepping.step import Step

#: Strengths by kind of friction (N/m^2; N/m), slopes (s/m; s), and shares of the speed.
STRENGTHS = {
    "slip_friction": (1e2, 1e3, 1e4, 1e5, 1e6, 1e7),
    "spin_friction": (1e0, 1e1, 1e2, 1e3),
}
SLOPES = (1e0, 1e2, 1e4, 1e6)
SPEEDS = (1, 10, 1000)
#: Points of a cell (reference triangle) at which a smooth law's stress is evaluated.
POINTS = np.array([[1 / 3, 1 / 3], [0.05, 0.05], [0.9, 0.05], [0.05, 0.9]])
#: Out, a hold, an instant reversal, a jump in velocity, another reversal and hold.
WAYS = ((20, 0.2, 4), (20, 0.1, 2), (5, 0.15, 4), (15, 0.01, 2), (10, 0.005, 2), (10, 0.1, 1))
FEW_WAYS = ((20, 0.2, 2), (20, 0.1, 1), (15, 0.05, 1), (20, 0.001, 1))
ELASTIC = Setting("elastic-1x3", ("discretisation.mesh_size=100 mm",))


def path(ways: tuple[tuple[float, float, int], ...] = WAYS, speed: float = 1) -> str:
    """Return what sets a program that goes to some displacements (mm) in some times (s)."""
    parts, before = [], 0.0
    for to, time, steps in ways:
        kind = "hold" if to == before else f"ramp, to: {to} mm"
        parts.append(f"{{type: {kind}, duration: {time / speed} s, steps: {steps}}}")
        before = to
    return f"program=[{', '.join(parts)}]"


def pulled(setting: Setting) -> tuple[Figures, float, float]:
    """Run; return the figures, the largest stress over its bound and the least loss.

    The loss is that of a step over that of all; collective.
    """
    measurement = Measurement(setting)
    stresses: list[float] = []
    measurement.run(lambda step: stresses.append(largest_stress(measurement, step)))
    lost = np.array([sum(s.dissipated.values()) for s in measurement.steps])
    least = float(np.diff(lost).min() / max(lost[-1], np.finfo(float).tiny))
    figures = measurement.figures()
    series = {**figures.series, "loss": lost.tolist()}
    return replace(figures, series=series), max(stresses), least


def largest_stress(measurement: Measurement, step: Step) -> float:
    """Return the largest stress over its bound, of all points; collective."""
    if step.number == 0:
        return 0.0
    balance = measurement.model.balance
    frictions = measurement.equilibrium.problem.model.friction_stresses
    here = [0.0]
    for one in frictions:
        strength = float(one.term.values["strength"].value)
        here.append(float(np.abs(one.stress.x.array).max(initial=0.0)) / strength)
    for term in () if frictions else balance.terms:
        if term.effect.bound is not None:
            here.append(float(np.abs(_stress(balance, term, measurement)).max(initial=0.0)))
    return float(max(measurement.model.comm.allgather(max(here))))


def _stress(balance: Balance, term: Term, measurement: Measurement) -> NDArray[np.float64]:
    """Return the stress of a smooth law over its bound on this rank's cells."""
    assert term.effect.dissipation is not None and term.effect.bound is not None
    point = point_of(balance.field, balance.fibres, balance.second_gradient)
    rate = ufl.variable(balance.rate_of(term.effect, point))
    stress = ufl.diff(term.effect.dissipation(rate, term.values), rate)
    mesh = measurement.model.sheet.mesh
    cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
    share = compile_expression(stress / term.effect.bound.strength(term.values), POINTS)
    return np.asarray(share.eval(mesh, cells))


def strengths(kind: str, slope: float | None, setting: Setting) -> Figures:
    """Run with each strength, by Coulomb's law where there is no slope; collective."""
    law = "law: coulomb" if slope is None else f"slope: {slope!r}"
    chosen = STRENGTHS[kind][1::2] if _is_quick(setting) else STRENGTHS[kind]
    runs = [
        pulled(setting.but(f"effects.{kind}={{strength: {strength!r}, {law}}}"))
        for strength in chosen
    ]
    parts = [figures for figures, _, _ in runs]
    series = {
        "strength": chosen,
        "worst": [f.worst for f in parts],
        "displacement": [f.series["displacement"] for f in parts],
        "force": [f.series["force"] for f in parts],
    }
    return together(parts, series).with_checks(
        stress_over_bound=max(stress for _, stress, _ in runs),
        least_loss=min(least for _, _, least in runs),
    )


def speeds(kind: str, setting: Setting) -> Figures:
    """Run by Coulomb's law at several speeds; compare the loops; collective."""
    strength = STRENGTHS[kind][2]
    ways = FEW_WAYS if _is_quick(setting) else WAYS
    law = f"effects.{kind}={{strength: {strength!r}, law: coulomb}}"
    runs = [pulled(setting.but(law, path(ways, speed))) for speed in SPEEDS]
    parts = [figures for figures, _, _ in runs]
    loops = np.array([[f.series["force"], f.series["loss"]] for f in parts])
    sizes = np.abs(loops[0]).max(axis=1)
    changes = np.abs(loops - loops[0]).max(axis=(0, 2)) / sizes
    return together(parts, {"force": [f.series["force"] for f in parts]}).with_checks(
        stress_over_bound=max(stress for _, stress, _ in runs),
        least_loss=min(least for _, _, least in runs),
        change_with_the_speed=float(changes.max()),
    )


def _is_quick(setting: Setting) -> bool:
    return path(FEW_WAYS) in setting.overrides


SOUND = (
    Bound("worst", most=12),
    Bound("stress over bound", most=1.0 + 1e-12),  # tanh is rounded
    Bound("least loss", least=0.0),
)
QUICK = ("discretisation.degree=2", "discretisation.mesh_size=150 mm", path(FEW_WAYS))
NAMES = {"slip_friction": "slip", "spin_friction": "spin"}


def _rows(kind: str) -> list[Row]:
    name, least, most = NAMES[kind], STRENGTHS[kind][0], STRENGTHS[kind][-1]
    unit = {"slip": ("s/m", "N/m²"), "spin": ("s", "N/m")}[name]
    span = f"strengths {least:g} to {most:g} {unit[1]}"
    rows = [
        Row(
            name=f"friction-{name}-{slope:g}",
            title=f"{name} friction, slope {slope:g} {unit[0]}, {span}",
            hard="holds, instant reversals and a jump in velocity",
            remedy="stress at points by an interior-point method once Newton's needs too many",
            setting=ELASTIC.but(path()),
            measure=partial(strengths, kind, slope),
            bounds=SOUND,
            quick=QUICK,
        )
        for slope in SLOPES
    ]
    coulomb = Row(
        name=f"friction-{name}-coulomb",
        title=f"{name} friction by Coulomb's law, {span}",
        hard="set-valued: no function from the rate to the stress",
        remedy="stress at points by an interior-point method",
        setting=ELASTIC.but(path()),
        measure=partial(strengths, kind, None),
        bounds=(*SOUND, Bound("cutbacks", most=0)),
        quick=QUICK,
    )
    speed = Row(
        name=f"friction-{name}-speed",
        title=f"the same, one strength, at {', '.join(map(str, SPEEDS))} times the speed",
        hard="nothing may depend on time",
        remedy="increments in place of rates",
        setting=ELASTIC.but(path()),
        measure=partial(speeds, kind),
        bounds=(
            *SOUND,
            Bound("cutbacks", most=0),
            Bound("change with the speed", most=1e-10),
        ),
        quick=QUICK,
    )
    return [*rows, coulomb, speed]


FAMILY = Family(
    number=4,
    title="Sharp friction",
    text=(
        "20 mm out, a hold, an instant reversal, a jump in velocity by a factor of ten and another "
        "reversal, in 15 steps. Stress over bound is the largest |tau|/zeta of all points; the "
        "least loss is that of a step over what all lose. A step that Newton's method does not "
        "solve in 12 iterations is begun anew with the stress as a variable at quadrature points, "
        "and so is the next one; after each further such failure twice as many, 32 at most. "
        "Iterations are those of the attempt that succeeds. How the "
        "loop of the smooth law tends to Coulomb's is printed by "
        "`pytest -s tests/verification/test_coulomb.py`."
    ),
    rows=tuple(row for kind in STRENGTHS for row in _rows(kind)),
    draw=draw_friction,
)
