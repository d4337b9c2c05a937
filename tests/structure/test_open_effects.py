"""A new effect is one new file: it is then everywhere without another edit."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from tests.structure.test_installed import CASE as SMALL
from wovenfab import forms
from wovenfab.case import CaseError, json_schema, read_case
from wovenfab.case.objects import sheet_of, simulation_of
from wovenfab.cli.check import describe, effects_page
from wovenfab.forms import effects
from wovenfab.record.fields import read_fields
from wovenfab.record.history import read_history
from wovenfab.record.results import open_results
from wovenfab.simulation.progress import Stopwatch
from wovenfab.simulation.run import run

ROOT = Path(__file__).parents[2]
CASE = f"{SMALL}output: {{pictures: false}}\n"


@pytest.fixture
def lattice(tmp_path: Path) -> Iterator[None]:
    """Add the file of shear under another name, as if it lay in forms/."""
    folder = tmp_path / "more"
    folder.mkdir()
    source = (ROOT / "forms" / "shear.py").read_text().replace('name="shear"', 'name="lattice"')
    (folder / "lattice.py").write_text(source)
    forms.__path__.append(str(folder))
    effects.cache_clear()
    yield
    forms.__path__.remove(str(folder))
    sys.modules.pop("wovenfab.forms.lattice", None)
    effects.cache_clear()


def results(name: str, text: str, folder: Path) -> Path:
    """Return the results of a case."""
    path = folder / f"{name}.yaml"
    path.write_text(text)
    case = read_case(path)
    with simulation_of(case, sheet_of(case, MPI.COMM_SELF)) as simulation:
        directory = open_results(folder / name, comm=MPI.COMM_SELF)
        assert run(simulation, directory, lambda _: None, Stopwatch())[0].failure is None
    return directory


@pytest.mark.usefixtures("lattice")
def test_it_is_in_schema_checks_and_docs(tmp_path: Path) -> None:
    properties = json_schema()["$defs"]["Effects"]["properties"]
    assert properties.keys() == effects().keys() and "lattice" in properties
    assert "| `lattice` | Shear with a barrier" in effects_page()
    path = tmp_path / "case.yaml"
    path.write_text(CASE)
    told = describe(read_case(path), 1)
    assert "adding crimp, lattice or power_shear would bring its own terms only" in told
    path.write_text(CASE.replace("shear: {stiffness: 400 N/m}", "lattice: {stiffness: 400 m}"))
    with pytest.raises(CaseError, match=r"effects\.lattice\.stiffness: expected a .*per length"):
        read_case(path)


def test_it_is_in_history_and_results_and_acts_like_any_other(
    lattice: Path, tmp_path: Path
) -> None:
    here, there = (
        results(name, CASE.replace("shear", name), tmp_path) for name in ("shear", "lattice")
    )
    shear, lattice = read_history(here), read_history(there)
    assert lattice["energy_lattice_J"][-1] > 0
    assert lattice["energy_lattice_J"] == pytest.approx(shear["energy_shear_J"], rel=1e-10)
    assert lattice["force_N"] == pytest.approx(shear["force_N"], rel=1e-8)
    assert "lattice:" in (there / "case.yaml").read_text()
    assert json.loads((there / "summary.json").read_text())["outcome"] == "finished"
    angles = [read_fields(directory).field("shear_angle", -1) for directory in (here, there)]
    assert np.abs(angles[0]).max() > 0.05
    assert angles[1] == pytest.approx(angles[0], abs=1e-10)


def test_the_page_of_effects_is_the_one_in_the_docs() -> None:
    written = (ROOT / "docs" / "parameters.md").read_text(encoding="utf-8")
    assert written == effects_page(), "write it anew: make docs"
