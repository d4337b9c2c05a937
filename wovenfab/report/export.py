"""Stored fields for other programs, and beside displacements that a camera has measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from wovenfab.case import units
from wovenfab.lacking import load
from wovenfab.record.fields import StoredFields
from wovenfab.record.results import rows_of, write_csv
from wovenfab.report.run_data import RunData, origin_of
from wovenfab.report.sheet import figure_size, lines
from wovenfab.report.style import (
    INK,
    MILLIMETRE,
    QUIET,
    Scale,
    Values,
    colour_bar,
    fill,
    label_sheet,
    readable,
    save,
)
from wovenfab.report.yarns import Triangles, displacements, outline

#: Folder of what is exported.
FOLDER = "export"
#: Share of the points of a cloud that must lie on the sheet.
LEAST = 0.5


def chosen_times(
    source: RunData,
    stored: StoredFields,
    at: Sequence[str] = (),
    every: int | None = None,
    last: bool = False,
) -> list[int]:
    """Return the indices of stored times.

    Args:
        source: The run.
        stored: Its fields.
        at: Times or displacements of the program, such as ``0.5 s`` and ``20 mm``; the nearest
            stored time is taken, of a displacement the first one.
        every: Every so many of them, the first one among them.
        last: The last one.

    Raises:
        ValueError: Something is no time and no displacement, or nothing was stored near it.
    """
    if not at and every is None and not last:
        return list(range(len(stored.times)))
    found = [*range(0, len(stored.times), every)] if every else []
    for text in at:
        values, si = (source.reached(stored), "m") if _is(text, "m") else (stored.times, "s")
        try:
            value = units.parse(text, si)
        except ValueError as error:
            kinds = "a time or displacement such as '0.5 s' or '20 mm'"
            raise ValueError(f"expected {kinds}, got {error}") from error
        slack = 1e-9 * float(np.ptp(values))
        if not values.min() - slack <= value <= values.max() + slack:
            low, high = (f"{v:.6g} {si}" for v in (values.min(), values.max()))
            raise ValueError(f"{text.strip()} is not among what was stored, {low} to {high}")
        found.append(int(np.argmin(np.round((values - value) / (slack or 1.0)) ** 2)))
    return sorted({*found, *([len(stored.times) - 1] if last else [])})


def _is(text: str, unit: str) -> bool:
    """Return whether a text has a unit of a kind."""
    try:
        units.parse(text, unit)
    except ValueError:
        return False
    return not text.strip()[-1:].isdigit()


def export(stored: StoredFields, index: int, folder: Path) -> list[Path]:
    """Write the fields of a stored time as VTU and as CSV; return both paths.

    Each cell has points of its own, as in ``fields.xdmf``.
    """
    pv = load("pyvista", "pyvista", "a VTU file")
    points = stored.points()
    space = np.column_stack([points, np.zeros(len(points))])
    grid = pv.UnstructuredGrid({pv.CellType.TRIANGLE: stored.triangles()}, space)
    for name in stored.units:
        values = stored.field(name, index)
        flat = values.ndim == 1
        grid[name] = values if flat else np.column_stack([values, np.zeros(len(values))])
    grid.field_data["TimeValue"] = [float(stored.times[index])]
    paths = [folder / f"step-{stored.steps[index]:06d}.{kind}" for kind in ("vtu", "csv")]
    paths[0].unlink(missing_ok=True)  # it may be a link to elsewhere
    grid.save(paths[0])
    place = {"x_m": points[:, 0], "y_m": points[:, 1]}
    write_csv(paths[1], rows_of(place | stored.columns(index)))
    return paths


@dataclass(frozen=True)
class Distances:
    """How far a computed displacement is from a measured one, at the measured points.

    Attributes:
        points: Reference positions on the sheet, shape (n, 2), m.
        measured, computed: Displacements, shape (n, 2), m.
        beside: Number of measured points that are not on the sheet and were left out.
    """

    points: Values
    measured: Values
    computed: Values
    beside: int

    @property
    def sizes(self) -> Values:
        """Length of the difference at each point, shape (n,), m."""
        return np.asarray(np.linalg.norm(self.computed - self.measured, axis=1))

    def __str__(self) -> str:
        """Return root mean square and largest distance in words."""
        sizes, worst = self.sizes, int(self.sizes.argmax())
        rms, most = float(np.sqrt(np.mean(sizes**2))), float(sizes[worst])
        moved = float(np.linalg.norm(self.measured, axis=1).max())
        unit = readable("m", most)
        share = f" ({100 * rms / moved:.2g} % of the largest measured one)" if moved else ""
        x, y = self.points[worst] * MILLIMETRE.factor
        left_out = f", {self.beside} not on the sheet" if self.beside else ""
        return (
            f"distance of displacements: root mean square {rms * unit.factor:.3g} {unit.name}"
            f"{share}, largest {most * unit.factor:.3g} {unit.name} at x = {x:.4g} mm, "
            f"y = {y:.4g} mm; {len(sizes)} points{left_out}"
        )


def compare(stored: StoredFields, index: int, points: Values, measured: Values) -> Distances:
    """Compare the mean displacement of the families with a measured one at a stored time.

    Args:
        stored: The fields.
        index: Which time.
        points: Reference positions, shape (n, 2), m.
        measured: Displacements there, shape (n, 2), m.

    Raises:
        ValueError: No point is on the sheet.
    """
    at, names = stored.at(points), displacements(stored)
    if not names:
        raise ValueError("the run stored no displacement: add it to output.fields")
    computed = np.mean([at(name, index) for name in names], axis=0)
    on = np.isfinite(computed).all(axis=1)
    if on.sum() < LEAST * len(points):
        found, sheet = _extent(points), _extent(stored.points())
        count = f"only {on.sum()} of {len(points)} points" if on.any() else "no point"
        raise ValueError(
            f"{count} of the cloud lie on the sheet: x and y are positions at rest in the sheet's "
            f"coordinates, {sheet}; those of the cloud are {found}. Add what the origins "
            "differ by, or find it with --align"
        )
    return Distances(points[on], measured[on], computed[on], int((~on).sum()))


def _extent(points: Values) -> str:
    """Return the least and largest coordinates in words."""
    low, high = points.min(axis=0), points.max(axis=0)
    return " and ".join(
        f"{name} from {1e3 * a:.4g} to {1e3 * b:.4g} mm"
        for name, a, b in zip("xy", low, high, strict=True)
    )


def write_distances(
    found: Distances, source: RunData, stored: StoredFields, words: str, path: Path
) -> list[Path]:
    """Write the map of distances as a picture and as CSV, ``path`` with suffixes; return both."""
    parts = {"": found.points, "u": found.computed, "measured_u": found.measured}
    columns = {f"{n}{xy}_m": v[:, k] for n, v in parts.items() for k, xy in enumerate("xy")}
    table = path.with_suffix(".csv")
    write_csv(table, rows_of(columns | {"distance_m": found.sizes}))
    figure = draw_distances(found, source, stored, words)
    return [save(figure, path.with_suffix(".png"), origin_of(source.directory)), table]


def draw_distances(found: Distances, source: RunData, stored: StoredFields, words: str) -> Figure:
    """Return the figure: the measured points at rest, coloured by the distance."""
    unit = readable("m", float(found.sizes.max()))
    sizes = found.sizes * unit.factor
    norm = Normalize(0.0, float(sizes.max()) or 1.0)
    scale = Scale(f"distance of displacements ({unit.name})", unit.factor, fill(), norm, "neither")
    figure = Figure(figsize=figure_size(np.ptp(stored.points(), axis=0)))
    axes = figure.add_subplot(aspect="equal")
    x, y = found.points.T * MILLIMETRE.factor
    dots = axes.scatter(
        x, y, s=9, c=sizes, cmap=scale.ramp, norm=norm, linewidths=0.2, edgecolors=QUIET
    )
    axes.add_collection(lines(outline(Triangles(stored.points(), stored.triangles())), INK, 0.8))
    colour_bar(figure, axes, dots, scale, shrink=0.6, aspect=36)
    label_sheet(axes, source.title, words)
    axes.autoscale_view()
    return figure
