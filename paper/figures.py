"""The paper's figures: what each shows, and which runs it is drawn from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from paper.claims import RATIOS, SPIN, STIFFNESSES

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
