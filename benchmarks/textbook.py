"""What the usual way would need for the accuracy that the default way reaches.

Textbook: continuous quadratic elements on a uniform mesh, backward Euler with fixed steps,
plain Newton from the last state, LU. Its errors in space and in time are measured apart and
follow power laws, and so does its time; from these follows the cheapest mesh and step of a
target accuracy, where the magnitudes of both errors add up, since nobody can count on their
different signs. Times beyond the measured sizes are extrapolated by the laws.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.figure import Figure
from benchmarks.probe import Sample, sample

CYCLE = ("program.amplitudes=40mm",)
EULER = ("time.scheme=backward-euler",)
TEXTBOOK = (
    *EULER,
    "discretisation.mesh=crossed",
    "discretisation.degree=2",
    "solver.predictor=none",
    "solver.tangent=plain",
    "solver.factor=renewed",
    "solver.stability=ignore",
    "solver.petsc={pc_type: lu}",
)
#: Sizes of textbook's cells (mm) and its steps in a cycle; our best mesh and number of steps.
SIZES, STEPS = (100.0, 50.0, 37.5, 25.0), 40
FINE, MANY = ("discretisation.degree=4", "discretisation.mesh_size=50mm"), 320
COARSE = ("discretisation.degree=4", "discretisation.mesh_size=100mm")
#: Target accuracy, least ratio, and our settings.
TARGETS = (
    (0.01, 100.0, (*COARSE, "time.steps_per_cycle=40")),
    (
        0.002,
        1000.0,
        ("discretisation.degree=4", "discretisation.mesh_size=75mm", "time.steps_per_cycle=100"),
    ),
)
Errors = NDArray[np.float64]


@dataclass(frozen=True)
class Law:
    """y = factor · x^power."""

    factor: float
    power: float

    @staticmethod
    def fitted(x: Sequence[float], y: Sequence[float]) -> Law:
        """Return the law closest to points in the logarithm."""
        power, logarithm = np.polyfit(np.log(x), np.log(y), 1)
        return Law(float(np.exp(logarithm)), float(power))

    def __call__(self, x: float) -> float:
        """Return y."""
        return float(self.factor * x**self.power)


def cheapest(
    accuracy: float,
    in_space: Sequence[Law],
    in_time: Sequence[Law],
    seconds: Callable[[float, float], float],
) -> tuple[float, float, float]:
    """Return cell size (mm), steps and time (s) of the cheapest run of an accuracy.

    Args:
        accuracy: Largest relative error of each quantity, magnitudes in space and time added.
        in_space: Error of each quantity against the cell size.
        in_time: Error of each quantity against the number of steps.
        seconds: Time against cell size and number of steps.
    """
    runs = []
    for share in np.linspace(0.05, 0.95, 91):
        space, rest = share * accuracy, (1 - share) * accuracy
        size = min((space / law.factor) ** (1 / law.power) for law in in_space)
        steps = max((rest / law.factor) ** (1 / law.power) for law in in_time)
        runs.append((seconds(size, steps), size, steps))
    least, size, steps = min(runs)
    return size, steps, least


def textbook() -> list[Figure]:
    """Print the laws of both; return the ratios of time at equal accuracy."""
    few = _steps(STEPS)
    # Errors in space and time of our best are so small that they add: the limit follows from
    # the fine mesh with few steps, and the coarse one with few and with many.
    fine, coarse, timely = (_run(*FINE, few), _run(*COARSE, few), _run(*COARSE, _steps(MANY)))
    exact = _values(fine) + _values(timely) - _values(coarse)
    print(f"limit: {exact[0]:.2f} N, {exact[1]:.4f} J")
    samples = [_run(*TEXTBOOK, f"discretisation.mesh_size={h}mm", few) for h in SIZES]
    mesh = (*COARSE, *EULER)
    slow = [_run(*mesh, _steps(n)) for n in (STEPS, 2 * STEPS)]
    at_few = _values(_run(*FINE, *EULER, few))
    space = np.array([np.abs(_values(s) - at_few) / exact for s in samples])
    # The error in time, from its change with the steps: e(n) - e(2n) = e(n) (1 - 2^-order).
    halved = np.abs(_values(slow[1]) - _values(slow[0])) / exact
    in_space = [Law.fitted(SIZES, [float(e) for e in space[:, i]]) for i in (0, 1)]
    in_time = [Law(2 * float(e) * STEPS, -1.0) for e in halved]
    unknowns = Law.fitted(SIZES, [s.unknowns for s in samples])
    step = Law.fitted([s.unknowns for s in samples], [s.seconds / s.steps for s in samples])
    for s, size, e in zip(samples, SIZES, space, strict=True):
        print(
            f"textbook {size:6.1f} mm {s.unknowns:7d} unknowns {s.seconds:7.1f} s "
            f"{s.iterations / s.steps:.1f} iterations a step, errors in space {_percent(e)}"
        )
    print(f"its error in time with {STEPS} steps: {_percent(2 * halved)}")
    print(
        f"its laws: force h^{in_space[0].power:.2f}, losses h^{in_space[1].power:.2f}, "
        f"time of a step N^{step.power:.2f}"
    )
    figures = []
    for accuracy, least, settings in TARGETS:
        ours = _run(*settings)
        errors = np.abs(_values(ours) / exact - 1)
        size, steps, seconds = cheapest(
            accuracy, in_space, in_time, lambda h, n: n * step(unknowns(h))
        )
        percent = f"{100 * accuracy:g} %"
        figures += [
            Figure(
                f"error of our run for {percent}",
                100 * float(errors.max()),
                100 * accuracy,
                "%",
                f"peak force and losses: {_percent(errors)}, {ours.unknowns} unknowns, "
                f"{ours.steps} steps, {ours.seconds:.1f} s: {', '.join(settings)}",
            ),
            Figure(
                f"textbook's time over ours at {percent}",
                seconds / ours.seconds,
                least,
                "x",
                f"extrapolated by its laws to {size:.2g} mm, {unknowns(size):.3g} unknowns and "
                f"{steps:.0f} steps: {seconds:.3g} s over {ours.seconds:.1f} s",
                at_least=True,
            ),
        ]
    return figures


def _run(*overrides: str) -> Sample:
    return sample((*CYCLE, *overrides))


def _steps(number: int) -> str:
    return f"time.steps_per_cycle={number}"


def _values(of: Sample) -> Errors:
    return np.array([of.force, of.dissipated])


def _percent(errors: Errors) -> str:
    return " and ".join(f"{100 * e:.2g} %" for e in errors)
