"""What the paper says of its figures, as measurements of the campaign's runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import combinations, pairwise
from typing import Any

import numpy as np

from paper.campaign import Campaign, Results
from paper.measures import Loop, likeness
from wovenfab.case import Case, Rectangle
from wovenfab.case.specimen import bias_extension_of


@dataclass(frozen=True)
class Measure:
    """One number, or a few that are compared.

    Attributes:
        what: What is measured.
        values: The numbers.
        shown: The numbers with units, as they are printed.
        asked: What the claim asks of them.
        holds: Whether they do that.
    """

    what: str
    values: tuple[float, ...]
    shown: str
    asked: str
    holds: bool


@dataclass(frozen=True)
class Claim:
    """A claim and its measures.

    Attributes:
        number: Its place in the list.
        figures: Where the paper shows it.
        sentence: What it says.
        measures: What was measured; all must hold.
        otherwise: Why it may not hold with what was chosen.
    """

    number: int
    figures: str
    sentence: str
    measures: tuple[Measure, ...]
    otherwise: str

    @property
    def holds(self) -> bool:
        """Whether all measures do what the claim asks."""
        return all(measure.holds for measure in self.measures)

    @property
    def verdict(self) -> str:
        """The verdict in words."""
        return "Holds." if self.holds else f"Does not hold. {self.otherwise}"

    def as_dict(self) -> dict[str, Any]:
        """Return the claim with its measures and verdict as plain data."""
        return asdict(self) | {"verdict": self.verdict}


def above(what: str, value: float, least: float, unit: str = "") -> Measure:
    """Return the measure that asks for more than ``least``; ``%`` shows parts of one."""
    return Measure(what, (value,), _shown(value, unit), f"> {_shown(least, unit)}", value > least)


def below(what: str, value: float, most: float, unit: str = "") -> Measure:
    """Return the measure that asks for less than ``most``."""
    return Measure(what, (value,), _shown(value, unit), f"< {_shown(most, unit)}", value < most)


def between(what: str, value: float, least: float, most: float, unit: str = "") -> Measure:
    """Return the measure that asks for something between two bounds."""
    asked = f"{_shown(least, unit)} to {_shown(most, unit)}"
    return Measure(what, (value,), _shown(value, unit), asked, least < value < most)


def falling(what: str, values: Sequence[float], unit: str = "", factor: float = 1.0) -> Measure:
    """Return the measure that asks that each value is below the one before.

    Args:
        what: What is measured.
        values: The numbers.
        unit: Their unit; ``%`` shows parts of one.
        factor: The last must even be below the first over this.
    """
    falls = all(b < a for a, b in pairwise(values))
    far = values[-1] < values[0] / factor
    asked = "falling" if factor == 1 else f"falling, to less than 1/{factor:g}"
    shown = ", ".join(_shown(value, unit) for value in values)
    return Measure(what, tuple(values), shown, asked, falls and far)


def digits(value: float) -> str:
    """Return a number with three digits, without an exponent."""
    return np.format_float_positional(value, 3, unique=False, fractional=False, trim="-")


def _shown(value: float, unit: str) -> str:
    if unit == "%":
        return f"{digits(100 * value)} %"
    return f"{digits(value)} {unit}".strip()


RATIOS = {"1:2": "velocity-1x2", "1:3": "velocity-1x3", "1:4": "velocity-1x4"}
STIFFNESSES = {"soft": "soft-1x3", "base": "velocity-1x3", "stiff": "stiff-1x3"}
SPIN = {
    "constant maximum velocity": ("velocity-1x3", "spin-velocity-1x3"),
    "constant frequency": ("frequency-1x3", "spin-frequency-1x3"),
}
#: A letter that linters take for a y.
GAMMA = "\N{GREEK SMALL LETTER GAMMA}"
#: What can be said of a measure that fails with no other reason known.
_CHOICE = "Amplitudes, velocity and frequency are chosen; with those of the paper it may."


def claims(campaign: Campaign, results: Results) -> list[Claim]:
    """Return all claims with their measures, in the paper's order."""
    return [
        _ratios(results),
        _programs(campaign, results),
        _stiffnesses(results),
        _spin(results),
        _slip(campaign, results),
        _curvature(results),
        _shear(campaign, results),
    ]


def _largest(results: Results, runs: Sequence[str]) -> list[Loop]:
    return [results.loops(run)[-1] for run in runs]


def _ratios(results: Results) -> Claim:
    loops = _largest(results, list(RATIOS.values()))
    at = f"{1e3 * loops[0].amplitude:.3g} mm"
    two, three, four = (loop.peak for loop in loops)
    return Claim(
        1,
        "Figure 3",
        "At the same displacement a shorter sample needs a much larger force, and its response "
        "is more nonlinear.",
        (
            above(f"peak force at {at}, 1:2 over 1:3", two / three, 1.5),
            above("the same, 1:3 over 1:4", three / four, 1.5),
            falling("nonlinearity, 1:2, 1:3, 1:4", [loop.nonlinearity for loop in loops]),
        ),
        _CHOICE,
    )


def _programs(campaign: Campaign, results: Results) -> Claim:
    base = _distance(results, "velocity-1x3", "frequency-1x3")
    steep = [_distance(results, s.velocity, s.frequency) for s in campaign.steep]
    slopes = ", ".join(s.slope for s in campaign.steep)
    own = str(campaign.case("velocity-1x3").effects["slip_friction"]["slope"]).removesuffix(".0")
    return Claim(
        2,
        "Figure 5",
        "At constant frequency the loops differ from those at constant maximum velocity, as part "
        "of the friction is viscous; with a steeper law the difference vanishes.",
        (
            above("largest difference in force, in parts of the cycle's peak", base, 0.05, "%"),
            falling(f"the same for slopes of {own} s/m, {slopes}", [base, *steep], "%", factor=3),
        ),
        "While yarns stick they creep by about the period over the slope, which must be small "
        "against the slip.",
    )


def _distance(results: Results, one: str, other: str) -> float:
    """Return the largest distance of the loops of equal amplitude of two runs."""
    pairs = zip(results.loops(one), results.loops(other), strict=True)
    return max(a.distance(b) for a, b in pairs)


def _stiffnesses(results: Results) -> Claim:
    soft, base, stiff = _largest(results, list(STIFFNESSES.values()))
    lost = [loop.dissipated for loop in (stiff, base, soft)]
    bent = [loop.nonlinearity for loop in (soft, base, stiff)]
    return Claim(
        3,
        "Figure 6",
        "A soft sample is more nonlinear and dissipates little, a stiff one is more linear and "
        "dissipates more.",
        (
            falling("energy lost in the largest cycle, stiff, base, soft", lost, "J", factor=2),
            falling("nonlinearity, soft, base, stiff", bent),
        ),
        _CHOICE,
    )


def _spin(results: Results) -> Claim:
    measures: list[Measure] = []
    for name, (without, spun) in SPIN.items():
        one, other = _largest(results, [without, spun])
        added = other.dissipated / one.dissipated - 1
        wider = [other.width(share) / one.width(share) - 1 for share in (0.95, 0.5)]
        measures += [
            above(f"energy lost in the largest cycle, added at {name}", added, 0.05, "%"),
            falling("its loop wider, 5 % before the reversal and half way", wider, "%", factor=1.5),
        ]
    return Claim(
        4,
        "Figure 7",
        "Spin friction adds dissipation and changes the loop near the reversals.",
        tuple(measures),
        _CHOICE,
    )


def _slip(campaign: Campaign, results: Results) -> Claim:
    beta = {run: results.field(run, "beta") for run in (*RATIOS.values(), *STIFFNESSES.values())}
    shortest = _sheet(campaign.case(RATIOS["1:2"]))
    part = (shortest.length / 2, shortest.width)
    like = [likeness(beta[a], beta[b], *part) for a, b in combinations(RATIOS.values(), 2)]
    soft, stiff = beta[STIFFNESSES["soft"]], beta[STIFFNESSES["stiff"]]
    whole = _sheet(campaign.case(STIFFNESSES["soft"]))
    sizes = [1e3 * beta[run].size() for run in RATIOS.values()]
    return Claim(
        5,
        "Figures 8, 9",
        "The slip has the same pattern for all ratios, and its size follows the amplitude against "
        "the sample; soft and stiff samples slip in the same regions, by different amounts.",
        (
            above("least correlation of β between two ratios, next to the grip", min(like), 0.8),
            falling("β that 99.5 % of the sheet stay below, 1:2, 1:3, 1:4", sizes, "mm"),
            above(
                "correlation of β between soft and stiff",
                likeness(soft, stiff, whole.length, whole.width),
                0.8,
            ),
            above("β of the stiff sample over the soft one's", stiff.size() / soft.size(), 1.2),
        ),
        _CHOICE,
    )


def _curvature(results: Results) -> Claim:
    measures = []
    for ratio, run in RATIOS.items():
        shares = [results.field(run, f"curvature_{i}").share_with_most(0.9) for i in (1, 2)]
        what = f"share of the {ratio} sheet that has 90 % of κ²"
        measures.append(between(what, float(np.mean(shares)), 0.1, 0.6, "%"))
    history = results.history(RATIOS["1:3"])
    turn = int(history["displacement_m"].argmax())
    stored = float(history["energy_bending_J"][turn] / history["energy_J"][turn])
    return Claim(
        6,
        "Figures 10, 11, 12",
        "The yarns bend in regions that are comparable with the sample, so that the energy of "
        "bending is not negligible.",
        (*measures, above("part of bending in the stored energy, 1:3", stored, 0.1, "%")),
        "A coarse mesh smears the curvature; on a fine one it is the amplitude that decides.",
    )


def _shear(campaign: Campaign, results: Results) -> Claim:
    measures, wider = [], []
    for ratio in ("1:3", "1:4"):
        angle = results.field(RATIOS[ratio], "shear_angle")
        half = sheared_zone(_sheet(campaign.case(RATIOS[ratio]))) / 2
        what = f"share of the {ratio} sheet where {GAMMA} is within 10 % of its value in the centre"
        measures.append(above(what, angle.share_near_centre(0.1), half, "%"))
        wider.append(f"{digits(100 * angle.share_near_centre(0.2))} %")
    given, limp = (
        f"{digits(100 * evenness(campaign, results, campaign.limp[yarns]))} %"
        for yarns in ("given", "limp")
    )
    return Claim(
        7,
        "Figure 13",
        "The shear angle is nearly uniform over a large central zone (asked: half of the zone "
        "that inextensible yarns would shear uniformly).",
        tuple(measures),
        f"{GAMMA} rises up to the centre; within 20 % of its value there it is in {wider[0]} and "
        f"{wider[1]} of the sheets. Bending is why: it joins what is sheared "
        "differently over about √(K_b/K_s), with Table 1 0.8 m, more than the width. In an elastic "
        f"pull of a 1:3 sheet {given} of the zone are within 10 % of its mean, with yarns a "
        f"thousand times easier to bend {limp}.",
    )


def evenness(campaign: Campaign, results: Results, run: str) -> float:
    """Return the share of the central zone where the shear angle is within 10 % of its mean."""
    specimen, angle = bias_extension_of(campaign.case(run)), results.field(run, "shear_angle")
    assert specimen is not None
    return angle.share_near_mean(0.1, specimen.in_centre(angle.centres))


def sheared_zone(sheet: Rectangle) -> float:
    """Return the share of a sheet that inextensible yarns at 45° shear uniformly.

    At each grip a triangle stays as it is and two others are sheared by half: together
    3/2 of the square of the width.
    """
    return 1 - 1.5 * sheet.width / sheet.length


def _sheet(case: Case) -> Rectangle:
    assert isinstance(case.sheet, Rectangle)
    return case.sheet
