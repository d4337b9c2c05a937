"""The house style of all pictures: colours, units, scales of fields, and files with provenance."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from math import degrees, isclose, log10
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.style import context
from matplotlib.ticker import FuncFormatter, LogFormatter, MaxNLocator, NullFormatter
from numpy.typing import NDArray
from PIL import Image, PngImagePlugin

from wovenfab import __version__
from wovenfab.record.fields import StoredFields
from wovenfab.record.results import Provenance, this_process, write_whole

MAKER = f"wovenfab {__version__}"
Values = NDArray[np.float64]
#: Text width of a two-column page (in).
WIDTH = 7.0
INK = "#1a1a1a"
QUIET = "#8a8a8a"
#: Colours of the two yarn families, distinct from each other and from the colours of fields.
YARNS = ("#1a1a1a", "#1f5fa8")
#: matplotlib's style sheet of the house.
STYLE = Path(__file__).with_name("house.mplstyle")
#: Colours without an order: the cycle of the style sheet.
APART: tuple[str, ...] = tuple(
    mpl.rc_params_from_file(STYLE, use_default_template=False)["axes.prop_cycle"].by_key()["color"]
)
#: Line styles that go with them, for print.
DASHES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (1.5, 1)), (0, (5, 1.5, 1.5, 1.5)))
#: Share (%) of the values within the colours; the rest, mostly at corners, has the last colour.
SHARE = 99.5
#: Size of a field up to which it is round-off, by unit; sheets may be small, and so lengths.
NOTHING = {"rad": 1e-8, "1": 1e-8, "1/m": 1e-8, "m": 1e-13}


_DUBLIN_CORE = "{http://purl.org/dc/elements/1.1/}"


@dataclass(frozen=True)
class Unit:
    """A unit for reading: ``value in SI * factor`` is the number on the axis."""

    name: str
    factor: float


MILLIMETRE = Unit("mm", 1e3)
DEGREE = Unit("°", degrees(1.0))
DISPLACEMENT = f"displacement ({MILLIMETRE.name})"


@dataclass(frozen=True)
class FieldStyle:
    """The name of a scalar field in words, and whether its sign means something."""

    label: str
    signed: bool = False


@dataclass(frozen=True)
class Scale:
    """One scale of colours for a field in several pictures.

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


def house_style() -> AbstractContextManager[None]:
    """Draw in the house style, without a display, and leave the user's settings alone."""
    # after a reset, because a matplotlibrc, as in the current folder, could run LaTeX
    return context(STYLE, after_reset=True)


def readable(unit: str, largest: float) -> Unit:
    """Return the prefixed unit in which ``largest`` (SI) has one to three leading digits."""
    size = abs(largest)
    for prefix, factor in (("M", 1e-6), ("k", 1e-3), ("", 1.0), ("m", 1e3)):
        if size * factor >= 1:
            return Unit(prefix + unit, factor)
    return Unit("µ" + unit, 1e6) if size > 0 else Unit(unit, 1.0)


def quantity(value: float, unit: str) -> str:
    """Return a value (SI) as text with three digits in a readable unit, ``535 N``."""
    shown = readable(unit, value)
    number = f"{value * shown.factor:.3g}".replace("-", "\N{MINUS SIGN}")
    return f"{number}\N{NO-BREAK SPACE}{shown.name}"


def seconds(value: float) -> str:
    """Return a time with two digits, long ones without an exponent, ``240 s``."""
    return f"{float(f'{value:.2g}'):g} s"


def millimetres(value: float) -> str:
    """Return a length (m) as text with three digits, ``20 mm``."""
    return f"{value * MILLIMETRE.factor:.3g} {MILLIMETRE.name}"


def sequence(count: int) -> list[tuple[float, ...]]:
    """Return ``count`` colours from light to dark; the last one is the same for any count."""
    ramp = mpl.colormaps["viridis_r"]
    return [
        tuple(ramp(1 - 0.18 - 0.62 * (count - 1 - i) / max(count - 1, 1))) for i in range(count)
    ]


def fill() -> Colormap:
    """Return the colours of fields, pale for zero and never as dark as a yarn."""
    return ListedColormap(mpl.colormaps["YlOrBr"](np.linspace(0.0, 0.74, 256)))


def both_ways() -> Colormap:
    """Return the colours of fields with a sign, white for zero and never as dark as a yarn."""
    return ListedColormap(mpl.colormaps["RdBu_r"](np.linspace(0.14, 0.86, 257)))


def shown_fields(stored: StoredFields) -> list[str]:
    """Return the stored fields that pictures can show, the most informative ones first."""
    return [name for name in FIELD_STYLES if name in stored.units]


def main_field(stored: StoredFields, index: int) -> str | None:
    """Return the first of the shown fields that is not zero at a stored time, if there are any."""
    names = shown_fields(stored)
    sizes = ((name, _size(stored.field(name, index))) for name in names)
    nonzero = (name for name, size in sizes if size > NOTHING[stored.units[name]])
    return next(nonzero, names[0] if names else None)


def scale_of(name: str, unit: str, values: Sequence[Values]) -> Scale:
    """Return the common scale of a field with its SI unit; ``values`` (SI) of each picture."""
    style = FIELD_STYLES[name]
    everything = np.concatenate(values)
    size = _size(everything)
    size = size if size > NOTHING[unit] else 1.0
    shown = _unit(unit, size)
    low, high = float(everything.min()), float(everything.max())
    signed = style.signed or low < -0.2 * size
    first = -size if signed else 0.0
    beyond = (low < first - 1e-9 * size, high > size + 1e-9 * size)
    return Scale(
        label=f"{style.label} ({shown.name})",
        factor=shown.factor,
        ramp=both_ways() if signed else fill(),
        norm=Normalize(first * shown.factor, size * shown.factor),
        extend={(1, 1): "both", (1, 0): "min", (0, 1): "max"}.get(beyond, "neither"),
    )


def colour_bar(
    figure: Figure,
    axes: Any,
    painted: ScalarMappable,
    scale: Scale,
    shrink: float = 0.5,
    aspect: float = 40,
) -> None:
    """Draw the colour bar of a painted field below its axes, one or several."""
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


def zero_line(axes: Axes) -> None:
    """Draw the line of zero."""
    axes.axhline(0, color=QUIET, linewidth=0.7, zorder=1)


def label_sheet(axes: Axes, title: str = "", subtitle: str = "") -> None:
    """Label axes in which a sheet is drawn (mm), with a subtitle below the title."""
    if title or subtitle:
        axes.set_title(title, pad=22)
        style: dict[str, Any] = {"xycoords": "axes fraction", "textcoords": "offset points"}
        axes.annotate(subtitle, (0, 1), xytext=(0, 8), **style)
    axes.set_xlabel(f"x ({MILLIMETRE.name})")
    axes.set_ylabel(f"y ({MILLIMETRE.name})")
    axes.grid(visible=False)


_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def power_of_ten(value: float, _: object = None) -> str:
    """Return the label of a tick at a power of ten, empty for others.

    That of matplotlib is parsed between dollars, which are dollars in the house style.
    """
    exponent = round(log10(value)) if value > 0 else 0
    is_power = isclose(value, 10.0**exponent, rel_tol=1e-9)
    return f"10{str(exponent).translate(_SUPERSCRIPTS)}" if is_power else ""


def save(
    figure: Figure, path: Path, origin: Provenance | None = None, dpi: float | None = None
) -> Path:
    """Write a figure such that equal data give equal files; return ``path``.

    Args:
        figure: The figure.
        path: The file, ``.png`` or ``.svg``.
        origin: Provenance of the data, which the file states; this process if None.
        dpi: Resolution of a PNG; that of the style if None.

    Raises:
        ValueError: Another kind of file.
    """
    origin, data = origin or this_process(), io.BytesIO()
    for axis in (a for axes in figure.axes for a in (axes.xaxis, axes.yaxis)):
        if isinstance(axis.get_major_formatter(), LogFormatter):
            axis.set_major_formatter(FuncFormatter(power_of_ten))
            axis.set_minor_formatter(NullFormatter())
    if path.suffix == ".png":
        figure.savefig(data, format="png", dpi=dpi)
        with Image.open(data) as picture:
            return write_png(picture, path, origin)
    if path.suffix != ".svg":
        raise ValueError(f"pictures are .png or .svg, not {path.suffix}")
    about = {"Creator": MAKER, "Source": origin.command, "Identifier": origin.commit}
    figure.savefig(data, format="svg", metadata={"Date": None, **about})
    write_whole(path, data.getvalue())
    return path


def write_png(picture: Image.Image, path: Path, origin: Provenance) -> Path:
    """Write a picture with 256 colours, a third of its size; return ``path``.

    The provenance stands in the file.
    """
    about, data = PngImagePlugin.PngInfo(), io.BytesIO()
    for name, value in _metadata(origin).items():
        about.add_text(name, value)
    few_colours(picture).save(data, format="png", optimize=True, pnginfo=about)
    write_whole(path, data.getvalue())
    return path


def few_colours(picture: Image.Image) -> Image.Image:
    """Return a picture with 256 colours, also those of thin lines and keys."""
    return picture.convert("RGB").quantize(method=Image.Quantize.MAXCOVERAGE, kmeans=1)


def gif_comment(origin: Provenance) -> bytes:
    """Return the comment with which a GIF states its provenance."""
    return "\n".join(f"{name}: {value}" for name, value in _metadata(origin).items()).encode()


def read_provenance(path: Path) -> Provenance:
    """Return the provenance that a picture (PNG, SVG, GIF) states; empty if none."""
    if path.suffix == ".svg":
        tree = ET.parse(path)
        command, commit = (
            tree.findtext(f".//{_DUBLIN_CORE}{name}") or "" for name in ("source", "identifier")
        )
        return Provenance(command, commit)
    with Image.open(path) as picture:
        about = dict(picture.info)
    if path.suffix == ".gif":
        about = dict(re.findall(r"(\w+): (.*)", bytes(about.get("comment", b"")).decode()))
    return Provenance(about.get("Command", ""), about.get("Commit", ""))


def _metadata(origin: Provenance) -> dict[str, str]:
    return {"Software": MAKER, "Command": origin.command, "Commit": origin.commit}


def _size(values: Values) -> float:
    return float(np.percentile(np.abs(values), SHARE))


def _unit(unit: str, size: float) -> Unit:
    if unit == "rad":
        return DEGREE
    if unit == "1":
        return Unit("%", 1e2) if size >= 1e-3 else Unit("10⁻⁶", 1e6)
    return Unit("1/m", 1.0) if unit == "1/m" else readable(unit, size)
