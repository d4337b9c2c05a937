"""The denims of the project give the KES-FB figures back from which they were made."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

import wovenfab
from wovenfab.case import read_case
from wovenfab.record.figures import LABORATORY

CONFIGS = Path(__file__).parents[2] / "configs"


def _measured(denim: str) -> dict[str, float]:
    """Return the figures of a denim in the units of laboratories."""
    lines = (CONFIGS / "lab" / "kes-denim.csv").read_text().splitlines()
    rows = csv.DictReader(line for line in lines if not line.startswith("#"))
    return {row["quantity"]: float(row[denim.upper()]) for row in rows}


def _computed(test: str, denim: str) -> dict[str, float]:
    path = CONFIGS / "tests" / f"{test}.yaml"
    case = read_case(path, {"output.pictures": False}, CONFIGS / "fabrics" / f"denim-{denim}.yaml")
    return dict(wovenfab.simulate(case).figures[test])


@pytest.mark.slow
@pytest.mark.parametrize("denim", ["a", "b", "c"])
def test_a_denim_has_the_figures_of_its_shear_test(denim: str) -> None:
    found, measured = _computed("kes-shear", denim), _measured(denim)
    for name, unit in {"G": "N/(m·rad)", "2HG": "N/m", "2HG5": "N/m"}.items():
        assert found[name] / LABORATORY[unit][1] == pytest.approx(measured[name], rel=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize("denim", ["a", "b", "c"])
def test_a_denim_has_the_figures_of_its_tension_test(denim: str) -> None:
    found, measured = _computed("kes-tension", denim), _measured(denim)
    assert 100 * found["EMT"] == pytest.approx(measured["EMT"], rel=1e-2)
    assert found["LT"] == pytest.approx(measured["LT"], rel=1e-2)
    # The WT of C in the source, 8.975, is not that of its own LT and EMT, to 500 gf/cm.
    work = measured["LT"] * measured["EMT"] / 100 * 500 / 2
    assert found["WT"] / LABORATORY["J/m^2"][1] == pytest.approx(work, rel=1e-2)
