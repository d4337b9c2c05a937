"""The page of the paper's figures, written from the account of a campaign and nothing else."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from paper.campaign import JUMPING, Campaign, Results
from paper.claims import Claim, digits
from paper.elements import KINDS, Compared, Value
from paper.figures import CYCLE, FIGURES, numbers
from paper.measures import PLACE
from wovenfab.case import Case, CyclesSection
from wovenfab.record.results import Provenance, markdown
from wovenfab.study.sweep import Member

#: Pixels of the page for each inch of a picture, so that all sheets show at one scale.
_PIXELS = 110


def listed(claim: Mapping[str, Any]) -> Iterator[str]:
    """Yield a claim as an item of a numbered list, its measures below it, and the verdict."""
    yield f"{claim['number']}. {claim['sentence']} ({claim['figures']})"
    for measure in claim["measures"]:
        mark = "" if measure["holds"] else " ✗"
        shown = f"**{measure['shown']}**{mark} (asked: {measure['asked']})"
        yield f"   - {measure['what']}: {shown}"
    yield ""
    yield f"   *{claim['verdict']}*"


def image(file: str, width: float, name: str) -> str:
    """Return a picture of the folder ``paper`` that is ``width`` inches wide."""
    return f'<img src="paper/{file}" width="{round(_PIXELS * width)}" alt="{name}">'


Account = Mapping[str, Any]


def account_of(
    campaign: Campaign,
    results: Results,
    measured: Sequence[Claim],
    widths: Mapping[int, float],
    origin: Provenance,
) -> dict[str, Any]:
    """Return the contents of the page: claims and figures, as plain data.

    Args:
        campaign: What was run.
        results: Its results.
        measured: The claims.
        widths: Width (in) of each figure by its number.
        origin: What made all of it.
    """
    return {
        "command": origin.command,
        "commit": origin.commit,
        "chosen": _chosen(campaign),
        "runs": {m.name: _run(m, results) for m in campaign.members},
        "claims": [claim.as_dict() for claim in measured],
        "figures": [
            {
                "number": figure.number,
                "title": figure.title,
                "says": figure.says,
                "kind": figure.kind,
                "file": figure.file,
                "width": widths[figure.number],
                "runs": list(dict.fromkeys(panel.run for panel in figure.panels)),
                "numbers": numbers(figure, results),
            }
            for figure in FIGURES
        ],
    }


def digest(case: Case) -> str:
    """Return a text that differs if what a case says does, defaults apart."""
    text = json.dumps(case.data, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _run(member: Member, results: Results) -> Mapping[str, Any]:
    summary, mesh = results.summary(member.name), member.case.discretisation
    return {
        "case": member.case.path.name if member.case.path else "",
        "overrides": list(member.case.overrides),
        "digest": digest(member.case),
        "title": member.case.title,
        "degree": mesh.degree,
        "mesh_size_m": mesh.mesh_size,
        "steps": summary["steps"],
        "unknowns": summary["unknowns"],
    }


def _chosen(campaign: Campaign) -> Mapping[str, Any]:
    """Return what the programs are."""
    velocity, frequency = (campaign.case(name).program[0] for name in _PROGRAMS)
    assert isinstance(velocity, CyclesSection)
    assert isinstance(frequency, CyclesSection)
    return {
        "amplitudes_m": list(velocity.amplitudes),
        "velocity_m_s": (velocity.max_velocity or ())[0],
        "frequency_Hz": (frequency.frequency or ())[0],
    }


_PROGRAMS = ("velocity-1x3", "frequency-1x3")


_PAPER = (
    "Ciallella, Scerrato, Spagnuolo, Giorgio, *A continuum model based on Rayleigh "
    "dissipation functions to describe a Coulomb-type constitutive law for internal friction in "
    "woven fabrics*, ZAMP 2022 ([doi](https://doi.org/10.1007/s00033-022-01845-2))"
)

#: Width of the animation (in).
_MOTION = 7.0
#: How to read each kind of figure.
_NOTES = {
    "program": "Displacement and velocity of the moved edge.",
    "loops": "Above each run by itself, its cycles from light to dark; below all together.",
    "sheets": "One scale of length in Figures 8 to 13, one of colours for all ratios; colours of "
    "slip and curvature follow the square root, so that small values show. Family 1 black, family "
    "2 blue, dashed at rest.",
}


def page(account: Account) -> str:
    """Return the page in Markdown; pictures are in the folder ``paper`` beside it."""
    parts = (_head, _claims, _figures, _motion, elements)
    return "\n".join(line for part in parts for line in part(account)) + "\n"


def _head(account: Account) -> Iterator[str]:
    yield "<!-- Written by `python3 -m paper`: change that, or the cases, not this page. -->"
    yield "# The paper, figure by figure"
    yield ""
    yield f"{_PAPER}."
    yield (
        "The scan at hand lost the figures. Each is drawn here anew, from the model and the "
        "parameters of the text and Table 1, beside what the paper says of it."
    )
    yield ""
    yield (
        f"**Chosen, not known:** {_choice(account['chosen'])}, and fibres at ±45°. So nothing here "
        "reproduces a curve of the paper; it shows whether the model does what is said of it."
    )
    yield ""
    yield (
        f"Made by `{account['command']}` from commit `{account['commit']}`: "
        f"{len(account['runs'])} runs, {_numerics(account)}. `make paper` makes the page anew."
    )
    yield ""


def _claims(account: Account) -> Iterator[str]:
    yield "## What is claimed, measured"
    yield ""
    yield (
        "Nonlinearity is the rise of the middle of the largest loop over the second half of the "
        "way, over that of the first half: 1 for a straight line. Thresholds are ours."
    )
    yield ""
    for claim in account["claims"]:
        yield from listed(claim)
    yield ""


def _figures(account: Account) -> Iterator[str]:
    for figure in account["figures"]:
        yield f"## Figure {figure['number']}. {figure['title']}"
        yield ""
        yield image(figure["file"], figure["width"], f"Figure {figure['number']}")
        yield ""
        yield f"*{_NOTES[figure['kind']]} Chosen: {_choice(account['chosen'])}.*"
        yield ""
        yield f"The paper: {figure['says'][0].lower()}{figure['says'][1:]}"
        yield ""
        yield markdown(figure["numbers"][0], figure["numbers"][1:])
        yield ""
        cases = (account["runs"][run]["case"] for run in figure["runs"])
        yield "Alone: " + ", ".join(f"`wovenfab run configs/paper/{case}`" for case in cases)
        yield ""


def _motion(account: Account) -> Iterator[str]:
    yield "## One cycle"
    yield ""
    yield image(CYCLE, _MOTION, "The largest cycle in motion")
    yield ""
    yield (
        f"*The largest cycle of the 1:3 sample in motion. Chosen: {_choice(account['chosen'])}.*"
    )
    yield ""
    yield (
        "Of any run: `wovenfab report DIR --animation`; in ParaView: `open_in_paraview.py`, which "
        "`wovenfab report DIR` writes."
    )
    yield ""


def _choice(chosen: Mapping[str, Any]) -> str:
    amplitudes = ", ".join(f"{1e3 * a:g}" for a in chosen["amplitudes_m"])
    return (
        f"amplitudes {amplitudes} mm for all ratios, maximum velocity "
        f"{chosen['velocity_m_s']:g} m/s, frequency {chosen['frequency_Hz']:g} Hz"
    )


def _numerics(account: Account) -> str:
    names = dict.fromkeys(run for figure in account["figures"] for run in figure["runs"])
    runs = [account["runs"][name] for name in names]
    unknowns = [run["unknowns"] for run in runs]
    return (
        f"those of the figures with elements of degree {runs[0]['degree']} and "
        f"{1e3 * runs[0]['mesh_size_m']:g} mm, {_span(unknowns)} unknowns, "
        f"{_span([run['steps'] for run in runs])} steps"
    )


def _span(values: Sequence[int]) -> str:
    """Return the least and the largest of some numbers, or the one that all are."""
    least, most = min(values), max(values)
    return f"{least}" if least == most else f"{least} to {most}"


#: Names of the pictures.
LOOPS, ERRORS, YARNS = "elements-loops.svg", "elements-errors.svg", "elements-yarns.png"


def account_of_elements(
    compared: Compared, claim: Claim, widths: Mapping[str, float]
) -> Mapping[str, Any]:
    """Return the contents of the section, as plain data.

    Args:
        compared: The runs on other elements.
        claim: The finding.
        widths: Width (in) of each picture by its name.
    """
    return {
        "claim": claim.as_dict(),
        "widths": dict(widths),
        "loops": _loops(compared),
        "pulls": _pulls(compared),
        "left": {kind: _left(pulls) for kind, pulls in compared.pulls.items()},
        "jumps_mm": {kind: digits(1e3 * line.jump) for kind, line in compared.profiles.items()},
    }


def elements(account: Mapping[str, Any]) -> Iterator[str]:
    """Yield the section."""
    content = account["elements"]
    jumps, left, widths = (content[name] for name in ("jumps_mm", "left", "widths"))
    yield "## What smooth elements hide"
    yield ""
    yield (
        "The paper interpolates in H²: placements that are continuous and smooth everywhere. The "
        "energy does not ask for that. It differentiates the placement of a family along its own "
        "yarns alone, so that a jump across a yarn costs nothing but what coupling and friction "
        "ask for. Along the yarns through the corners the placements do jump: on one side the grip "
        "holds the yarns, on the other they begin at a free edge. Placements here may jump there "
        "unless the case says otherwise (`discretisation.jumps`). What is lost if they may not, "
        "at about as many unknowns:"
    )
    yield ""
    yield from listed(content["claim"])
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
    yield markdown(content["loops"][0], content["loops"][1:])
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
    yield markdown(content["pulls"][0], content["pulls"][1:])
    yield ""
    yield image(YARNS, widths[YARNS], "Yarns where one through a corner is crossed")
    yield ""
    yield (
        "*The same place in the sheet: yarns of family 1 (black), and lines that lay straight "
        "across them at rest and move with them (blue). Between the two yarns nearest to the "
        f"corner's, {jumps[JUMPING]} mm of sliding appear at once where placements may jump; "
        "others spread them over a cell and more.*"
    )
    yield ""
    yield (
        "Alone: `wovenfab sweep configs/paper/elements.yaml`, "
        "`wovenfab sweep configs/paper/convergence.yaml`"
    )


def _loops(compared: Compared) -> list[list[str]]:
    rows = [["", "unknowns", "peak force (N)", "error", "lost in the largest cycle (J)", "error"]]
    for ratio, best in compared.peak[JUMPING].items():
        for kind, name in KINDS.items():
            peak, lost = compared.peak[kind][ratio], compared.lost[kind][ratio]
            values = (digits(peak.value), _error(peak), digits(lost.value), _error(lost))
            rows.append([f"{ratio}, {name}", str(peak.unknowns), *values])
        reference = (
            digits(best.reference),
            "",
            digits(compared.lost[JUMPING][ratio].reference),
            "",
        )
        rows.append([f"{ratio}, reference", "", *reference])
    return rows


def _pulls(compared: Compared) -> list[list[str]]:
    rows = [["elastic pull of 20 mm", "unknowns", "force (N)", "error"]]
    for kind, name in KINDS.items():
        for pull in compared.pulls[kind]:
            rows.append([name, str(pull.unknowns), f"{pull.value:.3f}", _error(pull)])
    best = compared.pulls[JUMPING][0].reference
    rows.append(["finest of degree 4", "", f"{best:.3f}", ""])
    return rows


def _left(pulls: Sequence[Value]) -> str:
    """Return what is left of the error on the finest mesh, of that on the next coarser one."""
    return f"{digits(100 * pulls[-1].error / pulls[-2].error)} %"


def _error(value: Value) -> str:
    sign = "+" if value.error > 0 else "\N{MINUS SIGN}"
    return f"{sign}{digits(100 * abs(value.error))} %"
