"""Errors of continuous elements against those that may jump, and their pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter
from numpy.typing import NDArray

from paper.campaign import JUMPING, REFERENCE, Campaign, Results
from paper.claims import RATIOS, Claim, above, below, falling
from paper.measures import WAY, Profile, across, index_at_largest, profile, sample
from wovenfab.case import Rectangle
from wovenfab.record.fields import read_fields
from wovenfab.report.run_data import open_run_data
from wovenfab.report.sheet import DisplacedSheet, lines, paint, sheet_at
from wovenfab.report.style import (
    APART,
    DASHES,
    INK,
    MILLIMETRE,
    QUIET,
    WIDTH,
    YARNS,
    readable,
    scale_of,
)
from wovenfab.report.yarns import Triangles, material_lines

#: What readers see of the kinds of elements, from the stiffest on.
KINDS = {
    "unstructured": "continuous, any mesh",
    "continuous": "continuous, mesh along yarns",
    JUMPING: "may jump, mesh along yarns",
}


@dataclass(frozen=True)
class Value:
    """A result of some elements and how far it is from the reference.

    Attributes:
        unknowns: Number of unknowns.
        value: The result (SI).
        reference: That of the reference (SI).
    """

    unknowns: int
    value: float
    reference: float

    @property
    def error(self) -> float:
        """The error, with its sign, in parts of the reference."""
        return self.value / self.reference - 1


@dataclass(frozen=True)
class Compared:
    """All values and profiles.

    Attributes:
        peak: Peak force (N) by kind of elements and ratio.
        lost: Energy lost in the largest cycle (J), likewise.
        pulls: Force of the elastic pull (N) by kind of elements, the finest mesh last.
        doubt: How far the reference of the pulls is from the one on the next coarser mesh,
            in parts of it.
        profiles: Across the yarn through a corner of the 1:3 sample, by kind of elements.
    """

    peak: Mapping[str, Mapping[str, Value]]
    lost: Mapping[str, Mapping[str, Value]]
    pulls: Mapping[str, Sequence[Value]]
    doubt: float
    profiles: Mapping[str, Profile]


def compare(campaign: Campaign, results: Results) -> Compared:
    """Return what the runs on other elements gave."""
    loops, pulls = campaign.elements.loops, campaign.elements.pulls
    peak, lost = (
        {
            kind: {
                ratio: _value(results, loops[kind][run], loops[REFERENCE][run], value)
                for ratio, run in RATIOS.items()
            }
            for kind in KINDS
        }
        for value in (_peak, _lost)
    )
    best = pulls[REFERENCE][-1]
    sheet = campaign.case(RATIOS["1:3"]).sheet
    assert isinstance(sheet, Rectangle)
    return Compared(
        peak=peak,
        lost=lost,
        pulls={k: [_value(results, run, best, _force) for run in pulls[k]] for k in KINDS},
        doubt=abs(_value(results, pulls[REFERENCE][-2], best, _force).error),
        profiles={
            kind: profile(results.directory / loops[kind][RATIOS["1:3"]], sheet) for kind in KINDS
        },
    )


def finding(compared: Compared) -> Claim:
    """Return the finding with its measures."""
    peaks = [max(abs(f.error) for f in compared.peak[kind].values()) for kind in KINDS]
    finest = [abs(compared.pulls[kind][-1].error) for kind in KINDS]
    names = "; ".join(KINDS.values())
    stiffer = [
        f.error for kind in ("unstructured", "continuous") for f in compared.peak[kind].values()
    ]
    return Claim(
        8,
        "Figure 3 with other elements",
        "The placement of a family jumps across its yarns through the corners. Elements that "
        "cannot jump are too stiff, most of all where their cells do not follow the yarns.",
        (
            above("jump along the yarn, 1:3", 1e3 * compared.profiles[JUMPING].jump, 0.5, "mm"),
            above("least error of the peak force with continuous elements", min(stiffer), 0, "%"),
            falling(f"largest error of the peak force ({names})", peaks, "%", factor=10),
            falling("error of the elastic force on the finest mesh (same order)", finest, "%", 10),
            below(
                "what that force's reference may be wrong by", compared.doubt, finest[1] / 10, "%"
            ),
        ),
        "With so coarse a mesh the elements may be too coarse for other reasons, too.",
    )


def _value(
    results: Results, run: str, reference: str, figure: Callable[[Results, str], float]
) -> Value:
    unknowns = int(results.summary(run)["unknowns"])
    return Value(unknowns, figure(results, run), figure(results, reference))


def _peak(results: Results, run: str) -> float:
    return results.loops(run)[-1].peak


def _lost(results: Results, run: str) -> float:
    return results.loops(run)[-1].dissipated


def _force(results: Results, run: str) -> float:
    return float(results.history(run)["force_N"][-1])


#: Strokes by the kind of elements.
_STROKES: dict[str, dict[str, Any]] = {
    kind: {"color": APART[i], "linestyle": DASHES[i], "linewidth": 1.3}
    for kind, i in zip(KINDS, (1, 2, 0), strict=True)
}
_MARKERS = dict(zip(KINDS, "sDo", strict=True))


def loops(campaign: Campaign, results: Results) -> Figure:
    """Return the figure: the largest cycle of each ratio with all kinds of elements."""
    figure = Figure(figsize=(WIDTH, 0.46 * WIDTH))
    runs = campaign.elements.loops
    for axes, (ratio, base) in zip(figure.subplots(1, len(RATIOS)), RATIOS.items(), strict=True):
        by_kind = {kind: results.loops(runs[kind][base])[-1] for kind in (REFERENCE, *KINDS)}
        unit = readable("N", by_kind[REFERENCE].peak)
        for kind, loop in by_kind.items():
            u = np.concatenate([WAY, WAY[::-1]]) * loop.amplitude * MILLIMETRE.factor
            force = np.concatenate([loop.out, loop.back[::-1]]) * unit.factor
            stroke = _STROKES.get(kind, {"color": "#c8c8c8", "linewidth": 4})
            axes.plot(u, force, label=KINDS.get(kind, "reference: may jump, degree 4"), **stroke)
        axes.set_title(ratio)
        axes.axhline(0, color=QUIET, linewidth=0.7, zorder=1)
        axes.set_xlabel(f"displacement ({MILLIMETRE.name})")
        axes.set_ylabel(f"force ({unit.name})")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def errors(compared: Compared) -> Figure:
    """Return the figure: errors of the elastic pull, and the slide across the yarn."""
    figure = Figure(figsize=(WIDTH, 0.48 * WIDTH))
    left, right = figure.subplots(1, 2)
    for kind, label in KINDS.items():
        pulls, line = compared.pulls[kind], compared.profiles[kind]
        sizes = [abs(pull.error) for pull in pulls]
        style = {"marker": _MARKERS[kind], "markersize": 4, **_STROKES[kind]}
        left.loglog([pull.unknowns for pull in pulls], sizes, **style)
        distance, slid = line.distance, line.slid
        if kind == JUMPING:  # no line joins both sides
            distance, slid = (np.insert(a, len(a) // 2, np.nan) for a in (distance, slid))
        factor = MILLIMETRE.factor
        right.plot(distance * factor, slid * factor, label=label, **_STROKES[kind])
    left.set_title("Elastic pull of 20 mm")
    left.xaxis.set_major_locator(FixedLocator([1e3, 2e3, 5e3, 1e4, 2e4, 5e4]))
    left.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x / 1e3:g}"))
    left.xaxis.set_minor_formatter(NullFormatter())
    left.set_xlabel("unknowns (thousands)")
    left.set_ylabel("error of the force")
    left.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{100 * y:g} %"))
    left.yaxis.set_minor_formatter(NullFormatter())
    right.set_title("Across the yarn through a corner")
    right.axvline(0, color=QUIET, linewidth=0.7, zorder=1)
    right.set_xlabel(f"held | distance ({MILLIMETRE.name}) | free")
    right.set_ylabel(f"slid along itself ({MILLIMETRE.name})")
    figure.legend(*right.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


Values = NDArray[np.float64]
#: Half the side of the zoom (m), and distance of yarns and marks (m).
_HALF, _SPACING = 0.03, 0.006


def yarns(campaign: Campaign, results: Results) -> Figure:
    """Return the figure: yarns of family 1, and lines on it that were straight at rest."""
    run = RATIOS["1:3"]
    rest = campaign.case(run).sheet
    assert isinstance(rest, Rectangle)
    sheets = {k: _sheet(results, campaign.elements.loops[k][run]) for k in KINDS}
    middle = _moved(sheets[JUMPING][0], rest)
    window = np.array([middle - _HALF, middle + _HALF])
    inside = [beta[_inside(sheet, window)] for sheet, beta in sheets.values()]
    scale = scale_of("beta", "m", inside)
    figure = Figure(figsize=(WIDTH, 0.36 * WIDTH))
    grid = figure.subplots(1, len(KINDS))
    for axes, (kind, (sheet, beta)) in zip(grid, sheets.items(), strict=True):
        painted = paint(axes, sheet, scale(beta), scale.ramp, scale.norm)
        _draw_lines(axes, sheet, rest)
        (left, low), (right, high) = window * MILLIMETRE.factor
        axes.set(xlim=(left, right), ylim=(low, high), aspect="equal")
        axes.set_axis_off()
        axes.set_title(KINDS[kind].replace(", ", ",\n"), fontsize=9)
    figure.colorbar(painted, ax=list(grid), label=f"β ({MILLIMETRE.name})")
    return figure


def _sheet(results: Results, run: str) -> tuple[DisplacedSheet, Values]:
    """Return the sheet of a run at its largest displacement, and beta (m) on it."""
    source = open_run_data(results.directory / run)
    stored = read_fields(source.directory)
    index = index_at_largest(source.directory, stored)
    return sheet_at(source, stored, index), stored.field("beta", index)


def _moved(sheet: DisplacedSheet, rest: Rectangle) -> Values:
    """Return where the place is now (m) at which the yarn through the corner is crossed."""
    place, _, line = across(rest)
    beside = (place - 1e-4 * line)[None]
    moved = [sample(sheet.mesh, sheet.mean[:, i], beside)[0] for i in (0, 1)]
    return np.asarray(place + np.array(moved), dtype=np.float64)


def _inside(sheet: DisplacedSheet, window: Values) -> NDArray[np.bool_]:
    """Return which points of a sheet are now in a window (m)."""
    places = sheet.mesh.points + sheet.mean
    inside: NDArray[np.bool_] = ((places > window[0]) & (places < window[1])).all(axis=1)
    return inside


def _draw_lines(axes: Axes, sheet: DisplacedSheet, rest: Rectangle) -> None:
    """Draw yarns of family 1, and what lay straight across them at rest and moves with them."""
    assert sheet.fibres is not None
    slid, mesh = sheet.families[0], sheet.mesh
    yarns = material_lines(mesh, sheet.fibres[0], slid, _SPACING)
    axes.add_collection(lines(yarns, INK, 1.0))
    for half in _halves(mesh, rest):
        marks = material_lines(half, sheet.fibres[1], slid, _SPACING)
        axes.add_collection(lines(marks, YARNS[1], 0.8))


def _halves(mesh: Triangles, rest: Rectangle) -> list[Triangles]:
    """Return the mesh on both sides of the yarn through the corner, so that no line joins them."""
    place, _, line = across(rest)
    beyond = (mesh.points[mesh.triangles].mean(axis=1) - place) @ line > 0
    return [Triangles(mesh.points, mesh.triangles[where]) for where in (~beyond, beyond)]
