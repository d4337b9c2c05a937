"""The page of the paper's figures, written from the account of a campaign and nothing else."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from paper.account import Account
from paper.elements_page import elements
from paper.figures import CYCLE
from paper.markdown import image, listed, table

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
        yield from table(figure["numbers"])
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
