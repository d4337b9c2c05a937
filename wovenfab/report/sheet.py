"""The sheet at one time: where it is, and how it is painted, outlined and threaded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, TriMesh
from matplotlib.colors import Colormap, Normalize
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from wovenfab.record.fields import StoredFields
from wovenfab.report.run_data import RunData
from wovenfab.report.style import INK, MILLIMETRE, QUIET, YARNS
from wovenfab.report.yarns import Polyline, Triangles, material_lines, outline

Values = NDArray[np.float64]
#: Number of yarns of a family along the longest side of the sheet, about.
YARNS_ALONG = 30


@dataclass(frozen=True)
class Sheet:
    """The sheet at one stored time.

    Attributes:
        mesh: The stored mesh.
        families: Displacement of each placement (m), each of shape (n, 2): one or two.
        fibres: Reference directions, a row a family, shape (2, 2), if known.
    """

    mesh: Triangles
    families: tuple[Values, ...]
    fibres: Values | None

    @property
    def mean(self) -> Values:
        """Mean displacement of the families (m), shape (n, 2)."""
        middle: Values = np.mean(self.families, axis=0)
        return middle

    def yarns(self, family: int, along: float = YARNS_ALONG) -> list[Polyline]:
        """Return the yarns of a family (0 or 1) where they are (m), ``along`` a side about."""
        if self.fibres is None:
            return []
        spacing = float(np.ptp(self.mesh.points, axis=0).max()) / along
        own = self.families[family % len(self.families)]
        return material_lines(self.mesh, self.fibres[family], own, spacing)


def sheet_at(source: RunData, stored: StoredFields, index: int) -> Sheet:
    """Return the sheet at a stored time, given by its place in ``stored.times``."""
    families = tuple(stored.field(name, index) for name in displacements(stored))
    return Sheet(Triangles(stored.points(), stored.triangles()), families, source.fibres)


def displacements(stored: StoredFields) -> list[str]:
    """Return the names of the displacement fields: one, or one for each family."""
    return sorted(name for name in stored.units if name.split("_")[0] == "displacement")


def paint(axes: Axes, sheet: Sheet, values: Values, ramp: Colormap, norm: Normalize) -> TriMesh:
    """Paint the sheet where the families are in the mean.

    Args:
        axes: Axes in mm.
        sheet: The sheet.
        values: Value at each point, shape (n,).
        ramp: Colours.
        norm: Values of the first and last of them.
    """
    x, y = ((sheet.mesh.points + sheet.mean) * MILLIMETRE.factor).T
    surface = Triangulation(x, y, sheet.mesh.triangles)
    return axes.tripcolor(surface, values, shading="gouraud", cmap=ramp, norm=norm)


def draw_outline(axes: Axes, sheet: Sheet, width: float = 0.8) -> None:
    """Draw the edge of the sheet, and in dashes the one at rest."""
    axes.add_collection(lines(outline(sheet.mesh), QUIET, width, "at rest", dashed=True))
    axes.add_collection(lines(outline(sheet.mesh, sheet.mean), INK, width))


def draw_yarns(axes: Axes, sheet: Sheet, along: float = YARNS_ALONG, width: float = 0.6) -> None:
    """Draw yarns of both families, if their directions are known."""
    if sheet.fibres is None:
        return
    for family, shade in enumerate(YARNS):
        label = f"family {family + 1}"
        axes.add_collection(lines(sheet.yarns(family, along), shade, width, label))


def lines(
    found: Sequence[Polyline], colour: str, width: float, label: str = "", dashed: bool = False
) -> LineCollection:
    """Return polylines (m) as matplotlib draws them (mm)."""
    return LineCollection(
        [line * MILLIMETRE.factor for line in found],
        colors=colour,
        linewidths=width,
        linestyles=[(0, (5, 3))] if dashed else "solid",
        capstyle="round",
        label=label,
    )
