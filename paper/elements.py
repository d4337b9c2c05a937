"""What smooth elements hide: how far continuous elements are from those that may jump."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from paper.across import Profile, profile
from paper.campaign import JUMPING, REFERENCE, Campaign, Results
from paper.claim import Claim, above, below, falling
from paper.claims import RATIOS
from wovenfab.case import Rectangle

#: What readers see of the kinds of elements, from the stiffest on.
KINDS = {
    "unstructured": "continuous, any mesh",
    "continuous": "continuous, mesh along yarns",
    JUMPING: "may jump, mesh along yarns",
}


@dataclass(frozen=True)
class Found:
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
    """All that was found.

    Attributes:
        peak: Peak force (N) by kind of elements and ratio.
        lost: Energy lost in the largest cycle (J), likewise.
        pulls: Force of the elastic pull (N) by kind of elements, the finest mesh last.
        doubt: How far the reference of the pulls is from the one on the next coarser mesh,
            in parts of it.
        profiles: Across the yarn through a corner of the 1:3 sample, by kind of elements.
    """

    peak: Mapping[str, Mapping[str, Found]]
    lost: Mapping[str, Mapping[str, Found]]
    pulls: Mapping[str, Sequence[Found]]
    doubt: float
    profiles: Mapping[str, Profile]


def compare(campaign: Campaign, results: Results) -> Compared:
    """Return what the runs on other elements gave."""
    loops, pulls = campaign.elements.loops, campaign.elements.pulls
    peak, lost = (
        {
            kind: {
                ratio: _found(results, loops[kind][run], loops[REFERENCE][run], value)
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
        pulls={k: [_found(results, run, best, _force) for run in pulls[k]] for k in KINDS},
        doubt=abs(_found(results, pulls[REFERENCE][-2], best, _force).error),
        profiles={
            kind: profile(results.directory / loops[kind][RATIOS["1:3"]], sheet) for kind in KINDS
        },
    )


def finding(found: Compared) -> Claim:
    """Return the finding with its measures."""
    peaks = [max(abs(f.error) for f in found.peak[kind].values()) for kind in KINDS]
    finest = [abs(found.pulls[kind][-1].error) for kind in KINDS]
    names = "; ".join(KINDS.values())
    stiffer = [
        f.error for kind in ("unstructured", "continuous") for f in found.peak[kind].values()
    ]
    return Claim(
        8,
        "Figure 3 with other elements",
        "The placement of a family jumps across its yarns through the corners. Elements that "
        "cannot jump are too stiff, most of all where their cells do not follow the yarns.",
        (
            above("jump along the yarn, 1:3", 1e3 * found.profiles[JUMPING].jump, 0.5, "mm"),
            above("least error of the peak force with continuous elements", min(stiffer), 0, "%"),
            falling(f"largest error of the peak force ({names})", peaks, "%", factor=10),
            falling("error of the elastic force on the finest mesh (same order)", finest, "%", 10),
            below("what that force's reference may be wrong by", found.doubt, finest[1] / 10, "%"),
        ),
        "With so coarse a mesh the elements may be too coarse for other reasons, too.",
    )


def _found(
    results: Results, run: str, reference: str, value: Callable[[Results, str], float]
) -> Found:
    unknowns = int(results.summary(run)["unknowns"])
    return Found(unknowns, value(results, run), value(results, reference))


def _peak(results: Results, run: str) -> float:
    return results.loops(run)[-1].peak


def _lost(results: Results, run: str) -> float:
    return results.loops(run)[-1].dissipated


def _force(results: Results, run: str) -> float:
    return float(results.history(run)["force_N"][-1])
