"""How fields are named, scaled and coloured for readers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.collections import TriMesh
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from wovenfab.record.fields import StoredFields
from wovenfab.report.style import DEGREE, Unit, both_ways, fill, readable

Values = NDArray[np.float64]
#: Share of the values within the colours; the rest, at corners mostly, takes the last colour.
SHARE = 99.5
#: Size of a field up to which it is round-off, and shown as none; lengths depend on the sheet's,
#: which may be small, too.
NOTHING = {"rad": 1e-8, "1": 1e-8, "1/m": 1e-8, "m": 1e-13}


@dataclass(frozen=True)
class FieldStyle:
    """What readers see of a scalar field.

    Attributes:
        label: Its name in words.
        signed: Whether both signs mean something.
    """

    label: str
    signed: bool = False


@dataclass(frozen=True)
class Scale:
    """One scale for a field in several pictures.

    Attributes:
        label: Name and unit.
        factor: From SI to that unit.
        ramp: Colours.
        norm: First and last value of the colours, in the unit.
        extend: Which ends have values beyond, in matplotlib's words.
    """

    label: str
    factor: float
    ramp: Colormap
    norm: Normalize
    extend: str

    def __call__(self, values: Values) -> Values:
        """Return values (SI) in the unit of the scale."""
        return values * self.factor


FIELD_STYLES = {
    "beta": FieldStyle("slip between the families β"),
    "shear_angle": FieldStyle("shear angle \N{GREEK SMALL LETTER GAMMA}"),
    "curvature_1": FieldStyle("curvature of family 1, κ₁"),
    "curvature_2": FieldStyle("curvature of family 2, κ₂"),
    "stretch_1": FieldStyle("strain of family 1", signed=True),
    "stretch_2": FieldStyle("strain of family 2", signed=True),
}


def painted_fields(stored: StoredFields) -> list[str]:
    """Return the stored fields that can be painted, the telling ones first."""
    return [name for name in FIELD_STYLES if name in stored.units]


def telling_field(stored: StoredFields, index: int) -> str | None:
    """Return the first of the painted fields that is not zero at a stored time, if any is."""
    names = painted_fields(stored)
    found = (
        name for name in names if _size(stored.field(name, index)) > NOTHING[stored.units[name]]
    )
    return next(found, names[0] if names else None)


def scale_of(name: str, unit: str, values: Sequence[Values]) -> Scale:
    """Return the scale on which a field shows alike in several pictures.

    Args:
        name: Name of the field.
        unit: Its SI unit.
        values: The field in each picture (SI), arrays of shape (n,).
    """
    look = FIELD_STYLES[name]
    everything = np.concatenate(values)
    size = _size(everything)
    size = size if size > NOTHING[unit] else 1.0
    shown = _unit(unit, size)
    low, high = float(everything.min()), float(everything.max())
    signed = look.signed or low < -0.2 * size
    first = -size if signed else 0.0
    beyond = (low < first - 1e-9 * size, high > size + 1e-9 * size)
    return Scale(
        label=f"{look.label} ({shown.name})",
        factor=shown.factor,
        ramp=both_ways() if signed else fill(),
        norm=Normalize(first * shown.factor, size * shown.factor),
        extend={(1, 1): "both", (1, 0): "min", (0, 1): "max"}.get(beyond, "neither"),
    )


def colour_bar(
    figure: Figure,
    axes: Any,
    painted: TriMesh,
    scale: Scale,
    shrink: float = 0.5,
    aspect: float = 40,
) -> None:
    """Draw the key of a painted field below what it belongs to.

    Args:
        figure: The figure.
        axes: One, or an array of them.
        painted: What was painted on that scale.
        scale: The scale.
        shrink: Its length over that of the axes.
        aspect: Its length over its height.
    """
    figure.colorbar(
        painted,
        ax=axes,
        label=scale.label,
        extend=scale.extend,
        ticks=MaxNLocator(8, steps=[1, 2, 2.5, 5, 10]),
        shrink=shrink,
        aspect=aspect,
        location="bottom",
    )


def _size(values: Values) -> float:
    return float(np.percentile(np.abs(values), SHARE))


def _unit(unit: str, size: float) -> Unit:
    if unit == "rad":
        return DEGREE
    if unit == "1":
        return Unit("%", 1e2) if size >= 1e-3 else Unit("10⁻⁶", 1e6)
    return Unit("1/m", 1.0) if unit == "1/m" else readable(unit, size)
