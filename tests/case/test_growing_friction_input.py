"""Friction that grows with the shear angle, written wrongly: each is one problem at its line."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from tests.case.reading import WriteCase
from wovenfab.case import CaseError, read_case

#: A key on each line, so that the line tells the key.
CASE = """\
sheet: {length: 300 mm, width: 100 mm, fibres: [45 deg, -45 deg]}
effects:
  stretch: {stiffness: 1e6 N/m}
  shear: {stiffness: 40 N/m}
  bending: {stiffness: 0.1 N*m}
  coupling: {stiffness: 6e7 N/m^3}
  slip_friction: {law: coulomb, strength: 20 kN/m^2 * (1 + (gamma/20 deg)^2)}
  spin_friction: {law: coulomb, strength: 3 N/m * (1 + (gamma/20 deg)^2)}
boundary:
  left: clamp
  right: {displacement: [program, 0]}
program: {type: cycles, amplitudes: [20 mm], max_velocity: 10 mm/s}
time: {scheme: bdf2}
"""
LINES = {
    line.partition(":")[0].strip(): number for number, line in enumerate(CASE.splitlines(), start=1)
}
SPIN = "spin_friction"
BAD = YAML(typ="safe").load(Path(__file__).with_name("bad_growing_friction.yaml"))


@pytest.mark.parametrize("bad", BAD, ids=[bad["name"] for bad in BAD])
def test_one_wrong_input_is_one_problem_at_its_line_that_names_the_part(
    bad: Mapping[str, str], write_case: WriteCase
) -> None:
    lines, line = CASE.splitlines(), bad["line"]
    number = LINES[line]
    value = bad["value"].replace("<long>", "+".join(["gamma"] * 90))
    lines[number - 1] = f"{lines[number - 1].partition(line)[0]}{line}: {value}"
    with pytest.raises(CaseError) as caught:
        read_case(write_case("\n".join(lines)))
    (problem,) = caught.value.problems
    assert (problem.file, problem.line) == ("case.yaml", number)
    assert problem.key.endswith(f"{line}.{bad['key']}")
    assert bad.get("names", "") in problem.message


def test_they_are_many_and_what_they_are_changed_from_is_right(write_case: WriteCase) -> None:
    assert len({(bad["line"], bad["value"]) for bad in BAD}) == len(BAD) > 40
    assert not read_case(write_case(CASE)).remarks()


def test_elastic_friction_needs_equilibrium_at_the_end_of_a_step(write_case: WriteCase) -> None:
    elastic = CASE.replace(
        "{law: coulomb, strength: 3 N/m", "{law: elastic, stiffness: 9 N/m, strength: 3 N/m"
    ).replace("bdf2", "midpoint")
    with pytest.raises(CaseError) as caught:
        read_case(write_case(elastic))
    (problem,) = caught.value.problems
    assert (problem.line, problem.key) == (LINES["time"], "time.scheme")
    assert SPIN in problem.message


@pytest.mark.parametrize("growth", ["(gamma/20)^2", "gamma/1e4 deg * gamma", "0*gamma"])
def test_an_angle_on_which_hardly_anything_depends_is_asked_back(
    growth: str, write_case: WriteCase
) -> None:
    text = CASE.replace("3 N/m * (1 + (gamma/20 deg)^2)", f"3 N/m * (1 + {growth})")
    (line,) = read_case(write_case(text)).remarks()
    number = LINES[SPIN]
    assert line.startswith(f"warning: case.yaml:{number}: effects.{SPIN}.strength: ")
