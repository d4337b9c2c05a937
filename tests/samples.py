"""Bias-extension samples whose forces the tests of accuracy know."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tests import scenes
from tests.outlines import aligned
from wovenfab.model.model import Numerics
from wovenfab.sheet.sheet import Sheet, rectangle_outline


@dataclass(frozen=True)
class Sample:
    """A rectangle 0.3 m wide, clamped at its short ends.

    Attributes:
        length: In widths.
        angles: Of the fibres, degrees.
        yarns: Stiffness of the yarns against stretch, N/m, and bending, N m; None for Table 1.
    """

    length: int = 3
    angles: tuple[float, float] = (45, -45)
    yarns: tuple[float, float] | None = None

    @property
    def values(self) -> Mapping[str, Mapping[str, float | tuple[float, float]]]:
        """Parameters by effect."""
        if self.yarns is None:
            return scenes.TABLE_1
        stretch, bending = self.yarns
        changed = {"stretch": stretch, "bending": bending}
        return scenes.TABLE_1 | {name: {"stiffness": (k, k)} for name, k in changed.items()}

    def sheet(self, mesh_size: float, steep: bool = False, jumps: bool = True) -> Sheet:
        """Return it with a mesh along its fibres: graded where one placement is steep, or not."""
        outline = rectangle_outline(0.3 * self.length, 0.3)
        return aligned(outline, self.angles, mesh_size, jumps=jumps, steep=steep)

    def pull(
        self, names: Sequence[str], displacement: float, degree: int, on: Sheet
    ) -> tuple[int, float]:
        """Return unknowns and force (N) at a displacement (m)."""
        model = scenes.model(on, names, Numerics(degree), self.values)
        return model.unknowns, scenes.pull(model, displacement)


SAMPLES = {
    "1:3": Sample(),
    "1:2": Sample(length=2),
    "1:4": Sample(length=4),
    "30/-60": Sample(angles=(30, -60)),
    "soft": Sample(yarns=(8.55e7, 24.05)),
    "stiff": Sample(yarns=(1.25e8, 560.8)),
}
