"""The section of the page about what smooth elements hide."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from paper.across import PLACE
from paper.campaign import JUMPING
from paper.claim import Claim, digits
from paper.elements import KINDS, Compared, Found
from paper.markdown import image, listed, table

#: Names of the pictures.
LOOPS, ERRORS, YARNS = "elements-loops.svg", "elements-errors.svg", "elements-yarns.png"


def account_of_elements(
    found: Compared, claim: Claim, widths: Mapping[str, float]
) -> Mapping[str, Any]:
    """Return everything that the section tells, as plain data.

    Args:
        found: What the runs gave.
        claim: The finding.
        widths: Width (in) of each picture by its name.
    """
    return {
        "claim": claim.as_dict(),
        "widths": dict(widths),
        "loops": _loops(found),
        "pulls": _pulls(found),
        "left": {kind: _left(pulls) for kind, pulls in found.pulls.items()},
        "jumps_mm": {kind: digits(1e3 * line.jump) for kind, line in found.profiles.items()},
    }


def elements(account: Mapping[str, Any]) -> Iterator[str]:
    """Yield the section."""
    found = account["elements"]
    jumps, left, widths = (found[name] for name in ("jumps_mm", "left", "widths"))
    yield "## What smooth elements hide"
    yield ""
    yield (
        "The paper interpolates in H²: placements that are continuous and smooth everywhere. The "
        "energy does not ask for that. It differentiates the placement of a family along its own "
        "yarns alone, so that a jump across a yarn costs nothing but what coupling and friction "
        "ask for. Along the yarns through the corners the placements do jump: on one side the grip "
        "holds the yarns, on the other they begin at a free edge. Placements here may jump there "
        "unless told otherwise (`discretisation.jumps`). What is lost if they may not, at about as "
        "many unknowns:"
    )
    yield ""
    yield from listed(found["claim"])
    yield ""
    yield (
        "*What this does not say:* elements such as the paper's are not at hand, and its mesh is "
        "not known; a convergence analysis chose it. Those of degree 3 here are continuous with "
        "kinks, which bind less than smooth ones. So no number here is the error of a curve of the "
        "paper. But such an analysis shows this error slowly: when cells are halved, the error of "
        f"the elastic force is still {left['continuous']} of what it was with continuous elements "
        f"along the yarns, {left['unstructured']} on any mesh, and {left[JUMPING]} where "
        "placements may jump."
    )
    yield ""
    yield image(LOOPS, widths[LOOPS], "Loops of Figure 3 with other elements")
    yield ""
    yield "*The largest cycle of Figure 3 with other elements, and (wide, grey) the reference.*"
    yield ""
    yield from table(found["loops"])
    yield ""
    yield (
        "Errors are those of elements against the reference, which may jump, has degree 4 and is "
        "run with the same steps in time."
    )
    yield ""
    yield image(ERRORS, widths[ERRORS], "Errors and the jump")
    yield ""
    yield (
        "*Left: errors of the force of an elastic pull (no friction), against the finest mesh of "
        "degree 4; dotted: how far that is from the next coarser one, below which errors mean "
        f"nothing. Right: how far yarns of family 1 have slid along themselves, on the line "
        f"across the one through a corner, {1e3 * PLACE:g} mm from that corner, at the largest "
        "displacement of the 1:3 sample.*"
    )
    yield ""
    yield from table(found["pulls"])
    yield ""
    yield image(YARNS, widths[YARNS], "Yarns where one through a corner is crossed")
    yield ""
    yield (
        "*The same place in the sheet: yarns of family 1 (black), and lines that lay straight "
        "across them at rest and move with them (blue). Between the two yarns nearest to the "
        f"corner's, {jumps[JUMPING]} mm of sliding are found at once where placements may jump; "
        "others spread them over a cell and more.*"
    )
    yield ""
    yield (
        "Alone: `wovenfab sweep configs/paper/elements.yaml`, "
        "`wovenfab sweep configs/paper/convergence.yaml`"
    )


def _loops(found: Compared) -> list[list[str]]:
    rows = [["", "unknowns", "peak force (N)", "error", "lost in the largest cycle (J)", "error"]]
    for ratio, best in found.peak[JUMPING].items():
        for kind, name in KINDS.items():
            peak, lost = found.peak[kind][ratio], found.lost[kind][ratio]
            told = (digits(peak.value), _error(peak), digits(lost.value), _error(lost))
            rows.append([f"{ratio}, {name}", str(peak.unknowns), *told])
        reference = (digits(best.reference), "", digits(found.lost[JUMPING][ratio].reference), "")
        rows.append([f"{ratio}, reference", "", *reference])
    return rows


def _pulls(found: Compared) -> list[list[str]]:
    rows = [["elastic pull of 20 mm", "unknowns", "force (N)", "error"]]
    for kind, name in KINDS.items():
        for pull in found.pulls[kind]:
            rows.append([name, str(pull.unknowns), f"{pull.value:.3f}", _error(pull)])
    best = found.pulls[JUMPING][0].reference
    rows.append(["finest of degree 4", "", f"{best:.3f}", ""])
    return rows


def _left(pulls: Sequence[Found]) -> str:
    """Return what is left of the error on the finest mesh, of that on the next coarser one."""
    return f"{digits(100 * pulls[-1].error / pulls[-2].error)} %"


def _error(found: Found) -> str:
    sign = "+" if found.error > 0 else "\N{MINUS SIGN}"
    return f"{sign}{digits(100 * abs(found.error))} %"
