"""What the page is written from: all numbers of a campaign, and what they were made with."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Any

from paper.campaign import Campaign, Results
from paper.claim import Claim
from paper.figures import FIGURES
from paper.numbers import numbers
from wovenfab.case import Case, Cycles
from wovenfab.record.results import Provenance
from wovenfab.study.sweep import Member

Account = Mapping[str, Any]


def account_of(
    campaign: Campaign,
    results: Results,
    found: Sequence[Claim],
    widths: Mapping[int, float],
    origin: Provenance,
) -> dict[str, Any]:
    """Return what the page tells of claims and figures, as plain data.

    Args:
        campaign: What was run.
        results: Its results.
        found: The claims.
        widths: Width (in) of each figure by its number.
        origin: What made all of it.
    """
    return {
        "command": origin.command,
        "commit": origin.commit,
        "chosen": _chosen(campaign),
        "runs": {m.name: _run(m, results) for m in campaign.members},
        "claims": [claim.as_dict() for claim in found],
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
    assert isinstance(velocity, Cycles)
    assert isinstance(frequency, Cycles)
    return {
        "amplitudes_m": list(velocity.amplitudes),
        "velocity_m_s": velocity.max_velocity,
        "frequency_Hz": frequency.frequency,
    }


_PROGRAMS = ("velocity-1x3", "frequency-1x3")
