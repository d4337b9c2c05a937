"""All 64 combinations of the six effects of the paper: which make a sheet, and why not."""

from __future__ import annotations

from inspect import signature
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from ruamel.yaml import YAML

from tests import scenes
from tests.case.reading import WriteCase
from wovenfab.case import Case, CaseError, read_case
from wovenfab.case.checks import COMBINATIONS
from wovenfab.case.objects import model_of, sheet_of
from wovenfab.solver.problem import Problem

VERDICTS = YAML(typ="safe").load(Path(__file__).with_name("combinations.yaml"))
RUNS = VERDICTS["runs"]
REFUSED = [(names, reason) for reason in VERDICTS if reason != "runs" for names in VERDICTS[reason]]

EFFECTS = {
    "stretch": "{stiffness: 1.27e8 N/m}",
    "shear": "{stiffness: 400 N/m}",
    "bending": "{stiffness: 254.1 N*m}",
    "coupling": "{stiffness: 6.0e7 N/m^3}",
    "slip_friction": "{strength: 199.2 kN/m^2, slope: 70 s/m}",
    "spin_friction": "{strength: 30 N/m, slope: 40 s}",
}


def case_of(names: list[str]) -> str:
    lines = [f"  {name}: {EFFECTS[name]}" for name in names]
    return "\n".join(
        [
            "sheet: {length: 0.9 m, width: 0.3 m, fibres: [45 deg, -45 deg]}",
            "effects:" if lines else "effects: {}",
            *lines,
            "boundary: {left: clamp, right: {displacement: [program, 0]}}",
            "program: {type: ramp, to: 40 mm, steps: 4, velocity: 0.5 m/s}",
            "discretisation: {degree: 2, mesh_size: 150 mm}",
        ]
    )


def name_of(names: object) -> str | None:
    return "+".join(names) or "nothing" if isinstance(names, list) else None


def test_the_table_has_every_combination_once() -> None:
    listed = [frozenset(names) for group in VERDICTS.values() for names in group]
    every = {frozenset(c) for n in range(7) for c in combinations(EFFECTS, n)}
    assert len(listed) == len(every) == 64
    assert set(listed) == every


@pytest.mark.parametrize("names", RUNS, ids=name_of)
def test_a_combination_that_makes_a_sheet_is_taken(names: list[str], write_case: WriteCase) -> None:
    assert set(read_case(write_case(case_of(names))).effects) == set(names)


@pytest.mark.parametrize(("names", "reason"), REFUSED, ids=name_of)
def test_a_combination_that_makes_none_is_refused_with_the_reason(
    names: list[str], reason: str, write_case: WriteCase
) -> None:
    with pytest.raises(CaseError) as caught:
        read_case(write_case(case_of(names)))
    (problem,) = caught.value.problems
    assert (problem.key, problem.message) == ("effects", reason)
    assert problem.remedy.startswith("That takes ")


@pytest.mark.slow
@pytest.mark.parametrize("names", RUNS, ids=name_of)
def test_a_combination_that_is_taken_is_stable_at_rest(
    names: list[str], write_case: WriteCase
) -> None:
    """The tangent of a first step, scaled to a unit diagonal, is positive definite."""
    case = read_case(write_case(case_of(names)))
    model = model_of(case, sheet_of(case, MPI.COMM_SELF))
    for weight, value in zip(model.rate_weights, (100.0, -100.0, 0.0), strict=False):
        weight.value = value
    matrix = scenes.tangent(model, Problem(model).constraints.bcs)
    dense = matrix.convert("dense").getDenseArray()
    scale = np.sqrt(np.diag(dense))
    least = np.linalg.eigvalsh((dense + dense.T) / 2 / np.outer(scale, scale))[0]
    matrix.destroy()
    assert least > 1e-8


def test_each_check_of_a_combination_gets_the_sections_that_it_names() -> None:
    for rule, names in COMBINATIONS:
        assert (*signature(rule).parameters,) == names
        assert {*names} <= Case.model_fields.keys()


CRIMP = "crimp: {stiffness: [2e5, 1e5], crimp: [0.08, 0.04], resistance: 50 N/m}"
#: R/(4 ((1 + c)^2 - 1)) of both families, N/m.
NEEDED = [50 / (4 * ((1 + c) ** 2 - 1)) for c in (0.08, 0.04)]


@pytest.mark.parametrize(
    ("stretch", "told"),
    [
        (f"{{stiffness: {NEEDED[1] * 1.001} N/m}}", False),
        (f"{{stiffness: {NEEDED[1] * 0.999} N/m}}", True),
        (f"{{stiffness: [{NEEDED[0] * 1.001}, {NEEDED[1] * 1.001}]}}", False),
        (f"{{stiffness: [{NEEDED[0] * 0.999}, {NEEDED[1] * 1.001}]}}", True),
        ("{stiffness: 200 N/m * (1 - x/1 m)}", True),  # 20 N/m at the right edge
        ("{stiffness: 200 N/m * (1 - x/10 m)}", False),
        ("{law: table, table: {strain: [0.01, 0.02], force: [2 N/m, 4 N/m]}}", False),
        ("{law: table, scale: 0.5, table: {strain: [0.01, 0.02], force: [2 N/m, 4 N/m]}}", True),
        ("{law: table, table: {strain: [0.01, 0.02], force: [2 N/m, 3 N/m]}}", True),
    ],
)
def test_a_stiffness_too_small_for_crimp_in_compression_is_told_with_the_least(
    stretch: str, told: bool, write_case: WriteCase
) -> None:
    text = case_of(["stretch", "shear"]).replace(EFFECTS["stretch"], stretch + "\n  " + CRIMP)
    case = read_case(write_case(text))
    lines = case.remarks()
    assert len(lines) == told
    for line in lines:
        assert line.startswith("warning: case.yaml:4: effects.crimp: ") and "154 N/m" in line
        least = "effects.stretch={law: linear, stiffness: 154 N/m}"
        assert not case.changed("effects.stretch=null", least).remarks()
