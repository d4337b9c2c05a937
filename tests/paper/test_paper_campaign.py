"""The whole campaign on a coarse mesh: its claims, figures and page."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from wovenfab.paper.campaign import Results, campaign_of
from wovenfab.paper.claim import Claim
from wovenfab.paper.claims import claims
from wovenfab.paper.figures import FIGURES
from wovenfab.paper.page import page
from wovenfab.report.stamp import read_stamp
from wovenfab.study.fingerprint import fingerprint
from wovenfab.study.sweep import sweep

PAPER = Path(__file__).parents[2] / "configs" / "paper"
#: Two cycles of 12 steps with some 300 to 600 unknowns.
COARSE = (
    "discretisation.degree=2",
    "discretisation.mesh_size=150mm",
    "program.amplitudes=[40 mm, 80 mm]",
    "time.steps_per_cycle=12",
    "output.every=6",
)


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Return the folder of a campaign and what it said."""
    folder = tmp_path_factory.mktemp("paper")
    settings = [word for text in COARSE for word in ("--set", text)]
    ended = subprocess.run(
        [sys.executable, "-m", "wovenfab", "paper", str(PAPER), "-o", "out", *settings],
        cwd=folder, text=True, capture_output=True, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    return folder / "out", ended.stdout


@pytest.fixture(scope="module")
def found(first: tuple[Path, str]) -> list[Claim]:
    return claims(campaign_of(PAPER, COARSE), Results(first[0]))


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_the_claims_hold_on_a_coarse_mesh_already(number: int, found: list[Claim]) -> None:
    claim = found[number - 1]
    assert claim.number == number
    assert claim.holds, claim


def test_the_claims_that_need_a_fine_mesh_have_plausible_measures(found: list[Claim]) -> None:
    ratios, sizes, stiffnesses, stiffer = found[4].measures
    assert min(ratios.values + stiffnesses.values) > 0.6
    assert sizes.holds
    assert stiffer.holds
    *shares, bending = (measure.values[0] for measure in found[5].measures)
    assert all(0.2 < share < 0.8 for share in shares)
    assert bending > 0.5
    assert all(0.1 < measure.values[0] < 0.5 for measure in found[6].measures)


def test_each_claim_is_told_with_its_measures_and_verdict(
    first: tuple[Path, str], found: list[Claim]
) -> None:
    for claim in found:
        assert f"{claim.number}. {claim.sentence}" in first[1]
        assert claim.verdict in first[1]
        for measure in claim.measures:
            assert f"{measure.what}: {measure.shown} (asked: {measure.asked})" in first[1]


def test_the_two_programs_are_what_the_figures_show(first: tuple[Path, str]) -> None:
    results = Results(first[0])
    for run, same in (("velocity-1x3", "velocity"), ("frequency-1x3", "period")):
        cycles = results.summary(run)["cycles"]
        durations = np.array([c["end_s"] - c["start_s"] for c in cycles])
        amplitudes = np.array([c["peak_displacement_m"] for c in cycles])
        constant = np.pi * amplitudes / durations if same == "velocity" else durations
        assert constant == pytest.approx(np.full(2, 0.5))


def test_all_figures_are_drawn_and_say_where_they_are_from(first: tuple[Path, str]) -> None:
    account = json.loads((first[0] / "paper" / "account.json").read_text())
    assert [figure.number for figure in FIGURES] == list(range(2, 14))
    for figure in FIGURES:
        told = read_stamp(first[0] / "paper" / figure.file)
        assert (told.command, told.commit) == (account["command"], account["commit"])
        assert told.command.startswith("wovenfab paper ")


def test_the_page_is_written_from_its_account(first: tuple[Path, str]) -> None:
    account = json.loads((first[0] / "paper" / "account.json").read_text())
    written = (first[0] / "paper.md").read_text()
    assert written == page(account)
    for figure in FIGURES:
        assert f"paper/{figure.file}" in written
    assert written.count("Chosen: amplitudes 40, 80 mm for all ratios") == len(FIGURES)


def test_a_second_time_nothing_is_computed(first: tuple[Path, str]) -> None:
    runs = sweep(campaign_of(PAPER, COARSE).members, first[0], 1, lambda *_: None)
    assert [run.state for run in runs] == ["kept"] * 12
    other = campaign_of(PAPER, [*COARSE, "effects.shear.stiffness=401"]).members[0]
    assert fingerprint(other.case) not in (first[0] / other.name / ".fingerprint").read_text()
