"""Scales: the same sheet in other units, and as another size."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import pint
from numpy.typing import NDArray

from benchmarks.hard.measurement import Measurement
from benchmarks.hard.pictures import draw_scales
from benchmarks.hard.row import Bound, Family, Figures, Row, Setting, together
from wovenfab.case import Case

UNITS = pint.UnitRegistry()
#: All effects, one cycle, two placements.
ALL = Setting(
    "bias-1x3",
    (
        "effects.spin_friction={strength: 30 N/m, slope: 40 s}",
        "program.amplitudes=[40 mm]",
        "time.steps_per_cycle=20",
        "discretisation.degree=2",
    ),
)
QUICK = ("discretisation.mesh_size=150 mm", "time.steps_per_cycle=4")


@dataclass(frozen=True)
class Scale:
    """Factors on lengths, forces and times."""

    length: float = 1.0
    force: float = 1.0
    time: float = 1.0

    def of(self, unit: str) -> float:
        """Return the factor on a quantity of a unit, such as ``"N/m^3"``."""
        dimensions = UNITS.Quantity(1, unit).dimensionality
        mass, length, time = (dimensions.get(f"[{d}]", 0) for d in ("mass", "length", "time"))
        # a mass is force · time² / length
        return float(
            self.force**mass * self.length ** (length - mass) * self.time ** (time + 2 * mass)
        )


def scaled(case: Case, scale: Scale) -> tuple[str, ...]:
    """Return the changes that scale a case."""
    sheet, program, mesh = case.sheet, case.program[0], case.discretisation.mesh_size
    changes = {
        "sheet.length": (sheet.length, "m"),  # type: ignore[union-attr]
        "sheet.width": (sheet.width, "m"),  # type: ignore[union-attr]
        "discretisation.mesh_size": (mesh, "m"),
        "program.max_velocity": (program.max_velocity, "m/s"),  # type: ignore[union-attr]
        "program.amplitudes": (program.amplitudes, "m"),  # type: ignore[union-attr]
    }
    for term in case.scene:
        for p in term.effect.parameters:
            changes[f"effects.{term.name}.{p.name}"] = (term.values[p.name], p.unit)
    return tuple(f"{key}={_times(value, scale.of(unit))}" for key, (value, unit) in changes.items())


def _times(value: object, factor: float) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(repr(float(v) * factor) for v in value) + "]"
    return repr(float(value) * factor)  # type: ignore[arg-type]


def compared(scale: Scale, setting: Setting) -> Figures:
    """Run a case and the scaled one; compare all histories. Collective."""
    runs = [Measurement(s).run() for s in (setting, setting.but(*scaled(setting.case, scale)))]
    histories = [_history(measurement) for measurement in runs]
    figures = [measurement.figures() for measurement in runs]
    energy = scale.length * scale.force
    factors = np.array([scale.time, scale.length, scale.force, energy, energy, energy])
    iterations = [float(sum(f.series["iterations"])) for f in figures]
    same = histories[0].shape == histories[1].shape
    differences = (
        np.abs(histories[1] / factors - histories[0]).max(axis=0) / np.abs(histories[0]).max(axis=0)
        if same
        else np.full(len(factors), np.inf)
    )
    return together(figures[:1], {"differences": differences.tolist()}).with_checks(
        difference=float(differences.max()),
        difference_in_iterations=iterations[1] - iterations[0],
    )


def _history(measurement: Measurement) -> NDArray[np.float64]:
    """Return time, displacement, force, stored and dissipated energy and work by step."""
    steps = measurement.steps
    return np.column_stack(
        [
            [s.time for s in steps],
            [s.displacement for s in steps],
            measurement.force,
            [sum(s.stored.values()) for s in steps],
            [sum(s.dissipated.values()) for s in steps],
            [s.work for s in steps],
        ]
    )


def _row(name: str, title: str, scale: Scale, *changes: str) -> Row:
    return Row(
        name=f"scale-{name}",
        title=title,
        hard="a tolerance with a hidden unit would show",
        remedy="tolerances relative to the sheet's own forces, energies and size",
        setting=ALL.but(*changes),
        measure=partial(compared, scale),
        bounds=(Bound("difference", most=1e-9), Bound("difference in iterations", most=0, least=0)),
        quick=QUICK,
    )


FAMILY = Family(
    number=8,
    title="Scales",
    text=(
        "One cycle with all six effects: times, displacements, forces, energies and work of every "
        "step, scaled back, relative to the largest of each. Case files convert units to SI, so "
        "that the numbers themselves are scaled here: a millimetre is passed off as a metre. "
        "Scaled by powers of two the histories are equal bit for bit."
    ),
    rows=(
        _row("mm-N", "numbers in mm and N", Scale(length=1e3)),
        _row("m-kN", "numbers in m and kN", Scale(force=1e-3)),
        _row("mm-kN-ms", "numbers in mm, kN and ms, unstructured mesh", Scale(1e3, 1e-3, 1e3),
             "discretisation.mesh=unstructured"),
        _row("1cm", "a sheet of 1 cm", Scale(length=1 / 90)),
        _row("100m", "a sheet of 100 m, crossed mesh", Scale(length=1000 / 9),
             "discretisation.mesh=crossed"),
    ),
    draw=draw_scales,
)  # fmt: skip
