"""Names and units of measured quantities, in the languages of testing machines."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from math import radians

from scipy.constants import g

from wovenfab.case import units

#: SI units of the quantities of a curve.
SI = {"displacement": "m", "angle": "rad", "force": "N", "shear_force": "N/m", "time": "s"}
#: Words by which their columns are known: English, German, French, Italian, Spanish.
WORDS = {
    "displacement": (
        *("displacement", "extension", "elongation", "crosshead", "stroke", "travel", "position"),
        *("separation", "weg", "verschiebung", "verlängerung", "längenänderung", "hub"),
        *("traverse", "auslenkung", "déplacement", "allongement", "course", "élongation"),
        *("spostamento", "allungamento", "corsa", "traversa", "desplazamiento", "extensión"),
        *("alargamiento", "carrera", "recorrido", "elongación"),
    ),
    "force": (
        *("force", "load", "kraft", "last", "effort", "charge", "forza", "carico", "fuerza"),
        *("carga", "zugkraft"),
    ),
    "angle": ("angle", "winkel", "angolo", "ángulo"),
    "time": ("time", "zeit", "temps", "tempo", "tiempo"),
}
#: Words that, beside one of a force, name a normalised shear force (a force per length).
NORMALISED = (
    *("shear", "scher", "schub", "cisaillement", "taglio", "cizalla", "cizallamiento"),
    *("normalised", "normalized", "normiert", "normalisé", "normalizzat", "normalizad"),
)
#: Symbols that are the whole name of a column.
SYMBOLS = {
    "displacement": ("u", "s", "d", "dl", "δl", "∆l", "x", "disp"),
    "force": ("f", "p", "fx"),
    "angle": ("\u03b3", "gamma"),
    "shear_force": ("fsh", "f_sh"),
    "time": ("t",),
}
#: Words of strains, which are no displacements.
STRAINS = ("strain", "dehnung", "déformation", "deformazione", "deformación", "stauchung")
_WHOLE_UNITS = {
    "m": ("metre", "meter", "metres", "meters"),
    "mm": ("millimetre", "millimeter", "millimetres", "millimeters", "millimètre", "millimètres"),
    "N": ("newton", "newtons"),
    "kN": ("kilonewton", "kilonewtons"),
    "s": ("sec", "secs", "sek", "second", "seconds", "sekunde", "sekunden", "seconde", "secondes"),
    "min": ("minute", "minutes", "minuten"),
    "in": ("inch", "inches", "zoll"),
}
_PREFIXES = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "d": 1e-1, "": 1.0, "k": 1e3}
#: Units that are known at once, with SI unit and factor.
UNITS: dict[str, tuple[str, float]] = {
    **{f"{p}{unit}": (unit, f) for unit in ("m", "N", "s") for p, f in _PREFIXES.items()},
    **{"daN": ("N", 10.0), "MN": ("N", 1e6), "dyn": ("N", 1e-5)},
    **{"in": ("m", 0.0254), "ft": ("m", 0.3048), "mil": ("m", 2.54e-5)},
    **{"min": ("s", 60.0), "h": ("s", 3600.0)},
    **{"gf": ("N", g * 1e-3), "kgf": ("N", g), "kp": ("N", g)},
    **{"lbf": ("N", 4.4482216152605), "ozf": ("N", 4.4482216152605 / 16)},
    **{"rad": ("rad", 1.0), "mrad": ("rad", 1e-3)},
}
UNITS |= dict.fromkeys(
    ("°", "deg", "degree", "degrees", "grad", "degré", "degrés", "gradi", "grados"),
    ("rad", radians(1.0)),
)
UNITS |= {
    f"{force}/{length}": ("N/m", UNITS[force][1] / UNITS[length][1])
    for force in ("N", "mN", "cN", "daN", "kN", "gf", "kgf", "lbf")
    for length in ("m", "cm", "mm", "in")
}
UNITS |= {w: UNITS[unit] for unit, words in _WHOLE_UNITS.items() for w in words}
_BRACKET = re.compile(r"[\[({<]\s*([^\[\](){}<>]*?)\s*[\])}>]")
#: What may be a unit at the end of a title: behind the first slash, "in", a comma or low line, or a
#: blank.
_AFTER = tuple(
    re.compile(rf"{before}\s*$")
    for before in (
        r"/\s*(?P<unit>[^/\s]\S*(?:\s*/\s*\S+)?)",
        r"\s+in\s+(?P<unit>\S+)",
        r"[_,]\s*(?P<unit>[^\W_]+)",
        r"\s(?P<unit>\S+)",
    )
)


@dataclass(frozen=True)
class MeasuredUnit:
    """A unit in a header.

    Attributes:
        text: As it is written.
        si: Its SI unit, one of :data:`SI`; else what it measures in words.
        factor: How many of these it is; 0 where it measures something else.
    """

    text: str
    si: str
    factor: float


def fold(text: str) -> str:
    """Return a text in small letters without accents, and umlauts the same in both spellings."""
    parts = unicodedata.normalize("NFKD", text.casefold())
    letters = "".join(c for c in parts if not unicodedata.combining(c))
    return letters.replace("ae", "a").replace("oe", "o").replace("ue", "u")


def means(title: str, quantity: str) -> bool:
    """Return whether a title names a quantity of a curve."""
    name = name_of(title)
    if name.casefold() in SYMBOLS[quantity]:
        return True
    if quantity == "shear_force":
        return _has_word(name, WORDS["force"]) and _has_word(name, NORMALISED)
    return _has_word(name, WORDS[quantity])


def means_strain(title: str) -> bool:
    """Return whether a title names a strain."""
    return _has_word(name_of(title), STRAINS)


@cache
def name_of(title: str) -> str:
    """Return a title without its unit."""
    text = _BRACKET.sub(" ", title).strip() or title.strip()
    matches = (pattern.search(text) for pattern in _AFTER)
    end = next((m.start() for m in matches if m and unit_of(m["unit"])), len(text))
    return text[:end].strip(" _,/:")


@cache
def unit_of(text: str) -> MeasuredUnit | None:
    """Return the unit that a text is, perhaps in brackets; None if it is none that is known."""
    bare = unicodedata.normalize("NFKC", text).strip().strip("[](){}<> ").strip(".")
    bare = bare.replace("\u03bc", "u")
    if bare in UNITS:
        return MeasuredUnit(bare, *UNITS[bare])
    near = {value for name, value in UNITS.items() if name.casefold() == bare.casefold()}
    return MeasuredUnit(bare, *near.pop()) if len(near) == 1 else None


@cache
def foreign(text: str) -> MeasuredUnit | None:
    """Return a unit that no quantity of a curve has, or an unusual one."""
    bare = unicodedata.normalize("NFKC", text).strip().strip("[](){}<> ").strip()
    bare = bare.replace("\u03bc", "u")
    if bare in ("%", "\u2030", "-", "1") or re.fullmatch(r"m+/m+|%.*", bare):
        return MeasuredUnit(bare, "a ratio", 0.0)
    if bare.casefold() in ("g", "kg", "lb", "lbs", "oz", "gr"):
        return MeasuredUnit(bare, "a mass", 0.0)
    if not re.fullmatch(r"[^\W\d_]{1,6}(\s*[/*·^.]?\s*[^\W\d_]{1,6}[²³]?|\^?-?[23²³])*", bare):
        return None
    try:
        dimension = units.in_si(_plain_unit(bare))[1]
        return MeasuredUnit(bare, units.kind_of(dimension), 0.0)
    except (ValueError, RecursionError):
        return None


def _plain_unit(text: str) -> str:
    return re.sub(r"\b(gf|kgf|lbf|kp)\b", "N", text)


def is_unit(text: str) -> bool:
    """Return whether a whole cell is a unit, of whatever."""
    return (
        unit_of(text) is not None
        or re.fullmatch(
            r"[\[(]?\s*([%\u2030°-]|1|deg|rad|hh:mm:ss.*|N/mm.?|kPa|MPa)\s*[\])]?", text
        )
        is not None
    )


def units_in(title: str, below: tuple[str, ...]) -> Iterator[MeasuredUnit]:
    """Yield what may be the unit of a column: in its title, or in lines of units.

    Args:
        title: Its title.
        below: Its cells in lines of units alone, best first.
    """
    for text in reversed(_BRACKET.findall(title)):
        if unit := unit_of(text) or foreign(text):
            yield unit
    rest = _BRACKET.sub(" ", title)
    for pattern in _AFTER:
        if match := pattern.search(rest):
            text = match["unit"]
            behind_slash = pattern is _AFTER[0]
            if unit := unit_of(text) or (foreign(text) if behind_slash else None):
                yield unit
    for text in below:
        if unit := unit_of(text) or foreign(text):
            yield unit


def _has_word(name: str, words: tuple[str, ...]) -> bool:
    tokens = re.findall(r"[^\W\d_]+", fold(name))
    return any(_is_word(token, fold(word)) for token in tokens for word in words)


def _is_word(token: str, word: str) -> bool:
    """Return whether a token is a word, its plural, or composed with it at its end."""
    return token == word or token.endswith(word) or (len(word) > 4 and token.startswith(word))
