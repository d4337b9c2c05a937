"""The paper's figures: contents, the runs they are drawn from, and the numbers beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from paper.campaign import Results
from paper.claims import RATIOS, SPIN, STIFFNESSES, digits

#: The largest cycle of the 1:3 sample in motion.
CYCLE = "cycle.gif"
Kind = Literal["program", "loops", "sheets"]


@dataclass(frozen=True)
class Panel:
    """One picture of a figure.

    Attributes:
        label: What is written above it.
        run: What it is drawn from.
        field: What colours the sheet, for a picture of one.
        beside: Run whose loops are drawn in grey behind, to compare.
        beside_label: What that is called.
    """

    label: str
    run: str
    field: str = ""
    beside: str = ""
    beside_label: str = ""


@dataclass(frozen=True)
class PaperFigure:
    """A figure.

    Attributes:
        number: Its number in the paper.
        title: What it shows.
        says: What the paper says of it.
        kind: How it is drawn.
        panels: Its pictures, in the paper's order.
        alike: Panels that have the same colours as these, those of other figures among them.
    """

    number: int
    title: str
    says: str
    kind: Kind
    panels: tuple[Panel, ...]
    alike: tuple[Panel, ...] = ()

    @property
    def file(self) -> str:
        """Name of the picture: vector graphics for curves, pixels for fields."""
        return f"figure-{self.number:02d}.{'png' if self.kind == 'sheets' else 'svg'}"


def _bent(ratio: str) -> tuple[Panel, ...]:
    run = RATIOS[ratio]
    return tuple(Panel(f"{ratio}, family {i}", run, f"curvature_{i}") for i in (1, 2))


def _curvatures(number: int, ratio: str) -> PaperFigure:
    return PaperFigure(
        number,
        f"Curvature of both families, {ratio}",
        "The curvature does not vanish in regions that are comparable with the sample, so that "
        "the energy of bending cannot be neglected.",
        "sheets",
        _bent(ratio),
        alike=tuple(panel for other in RATIOS for panel in _bent(other)),
    )


_VELOCITY, _FREQUENCY = "constant maximum velocity", "constant frequency"

FIGURES: tuple[PaperFigure, ...] = (
    PaperFigure(
        2,
        "Program at constant maximum velocity",
        "The cycles grow, and the largest velocity is the same in all of them.",
        "program",
        (Panel(_VELOCITY, RATIOS["1:3"]),),
    ),
    PaperFigure(
        3,
        "Loops for three ratios",
        "At the same displacement the force is much larger for a shorter sample, and the response "
        "is more nonlinear.",
        "loops",
        tuple(Panel(ratio, run) for ratio, run in RATIOS.items()),
    ),
    PaperFigure(
        4,
        "Program at constant frequency",
        "All cycles take the same time, so that the velocity grows with the amplitude.",
        "program",
        (Panel(_FREQUENCY, "frequency-1x3"),),
    ),
    PaperFigure(
        5,
        "Loops at constant maximum velocity and at constant frequency",
        "They differ, because a part of the friction is viscous; how much depends on the slope of "
        "the friction law.",
        "loops",
        (Panel(_VELOCITY, RATIOS["1:3"]), Panel(_FREQUENCY, "frequency-1x3")),
    ),
    PaperFigure(
        6,
        "Loops of a soft and a stiff sample",
        "The soft one is more nonlinear and dissipates little; the stiff one is more linear and "
        "dissipates more.",
        "loops",
        tuple(Panel(name, STIFFNESSES[name]) for name in ("soft", "stiff")),
    ),
    PaperFigure(
        7,
        "Loops with spin friction",
        "Spin friction dissipates more and changes the loops near the reversals.",
        "loops",
        tuple(
            Panel(name, spun, beside=without, beside_label="without spin friction")
            for name, (without, spun) in SPIN.items()
        ),
    ),
    PaperFigure(
        8,
        "Slip between the families for three ratios",
        "The pattern is almost the same; the values follow the amplitude against the sample.",
        "sheets",
        tuple(Panel(ratio, run, "beta") for ratio, run in RATIOS.items()),
    ),
    PaperFigure(
        9,
        "Slip between the families of a soft and a stiff sample",
        "The slip is in the same regions, but its size and the shape of the sample differ.",
        "sheets",
        tuple(Panel(name, STIFFNESSES[name], "beta") for name in ("soft", "stiff")),
    ),
    *(_curvatures(number, ratio) for number, ratio in zip((10, 11, 12), RATIOS, strict=True)),
    PaperFigure(
        13,
        "Shear angle for two ratios",
        "It is almost uniform over a large central zone.",
        "sheets",
        tuple(Panel(ratio, RATIOS[ratio], "shear_angle") for ratio in ("1:3", "1:4")),
    ),
)


#: Rows of a table, the first one its headings.
Table = list[list[str]]


def numbers(figure: PaperFigure, results: Results) -> Table:
    """Return the figures of a figure as a table."""
    if figure.kind == "program":
        return _program(results, figure.panels[0])
    if figure.kind == "loops":
        return _loops(results, figure.panels)
    return _sheets(results, figure.panels)


def _program(results: Results, panel: Panel) -> Table:
    history, cycles = results.history(panel.run), results.summary(panel.run)["cycles"]
    time, u = history["time_s"], history["displacement_m"]
    rows = [["cycle", "amplitude (mm)", "duration (s)", "largest velocity (m/s)"]]
    for number, cycle in enumerate(cycles, 1):
        inside = (time >= cycle["start_s"]) & (time <= cycle["end_s"])
        amplitude, duration = float(u[inside].max()), cycle["end_s"] - cycle["start_s"]
        # of the program A/2 (1 - cos(2 pi t/T)) itself, which differences would fall short of
        fastest = np.pi * amplitude / duration
        rows.append([str(number), *(digits(v) for v in (1e3 * amplitude, duration, fastest))])
    return rows


def _loops(results: Results, panels: Sequence[Panel]) -> Table:
    heads = ["", "unknowns", "peak force (N)", "lost in the largest cycle (J)"]
    rows = [[*heads, "energy imbalance (J)", "nonlinearity"]]
    for panel in panels:
        summary, loop = results.summary(panel.run), results.loops(panel.run)[-1]
        worst = summary["worst_imbalance_J"]
        values = (digits(v) for v in (loop.peak, loop.dissipated, worst, loop.nonlinearity))
        rows.append([panel.label, str(summary["unknowns"]), *values])
    return rows


def _sheets(results: Results, panels: Sequence[Panel]) -> Table:
    rows = [["", "mean", "99.5 % of the sheet stay below", "largest"]]
    for panel in panels:
        field = results.field(panel.run, panel.field)
        factor, unit = _UNITS[panel.field]
        values = (field.mean(), field.size(), float(field.values.max()))
        rows.append([panel.label, *(f"{digits(factor * value)} {unit}" for value in values)])
    return rows


_UNITS = {
    "beta": (1e3, "mm"),
    "curvature_1": (1.0, "1/m"),
    "curvature_2": (1.0, "1/m"),
    "shear_angle": (float(np.degrees(1.0)), "°"),
}
