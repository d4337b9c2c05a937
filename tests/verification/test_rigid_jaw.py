"""KES shear with a dead load, against uniform shear and against a jaw that stays straight."""

from __future__ import annotations

from math import asin, cos, tan
from pathlib import Path

import numpy as np
import pytest

import wovenfab
from wovenfab.case import Case, read_case
from wovenfab.record.history import REACTIONS, read_history

CONFIGS = Path(__file__).parents[2] / "configs"
FABRIC = CONFIGS / "fabrics" / "glass-plain.yaml"
#: Values of the fabric, N/m, and of the test: sides (m) and tension (N/m).
SHEAR, STRENGTH, LENGTH, WIDTH, TENSION = 4.6, 4.8, 0.05, 0.2, 9.80665
COARSE = {
    "figures": [],
    "discretisation": {"degree": 2, "mesh_size": 0.025},
    "output.pictures": False,
}
STEPS, END = 8, 7e-3


def _case(changes: dict[str, object]) -> Case:
    return read_case(CONFIGS / "tests" / "kes-shear.yaml", {**COARSE, **changes}, FABRIC)


def _pulled() -> Case:
    ramp = {"type": "ramp", "to": END, "duration": 16.0, "steps": STEPS}
    return _case({"program": ramp})


def test_the_force_of_the_shear_test_is_that_of_uniform_shear() -> None:
    """Yarns keep their length, and the tension is lifted by the jaw that comes nearer."""
    history = wovenfab.simulate(_pulled()).history
    angles = [asin(u / LENGTH) for u in history["displacement_m"][1:]]
    uniform = [
        WIDTH * ((SHEAR * tan(g) / cos(g) ** 2 + STRENGTH) / cos(g) + TENSION * tan(g))
        for g in angles
    ]
    assert history["force_N"][1:] == pytest.approx(uniform, rel=2e-3)


@pytest.mark.slow
def test_a_jaw_that_stays_straight_needs_the_same_force(tmp_path: Path) -> None:
    """A rigid jaw under a constant force: the program is that force, the second one the shear."""
    changes = {
        "boundary.right": {"displacement": ["program", "second_program"]},
        "program": [
            {"type": "ramp", "to": f"{TENSION * WIDTH} N", "duration": 1.0, "steps": 1},
            {"type": "hold", "duration": 16.0, "steps": STEPS},
        ],
        "second_program": [
            {"type": "hold", "duration": 1.0, "steps": 1},
            {"type": "ramp", "to": END, "duration": 16.0, "steps": STEPS},
        ],
    }
    free = wovenfab.simulate(_pulled(), tmp_path / "free").history["force_N"]
    wovenfab.simulate(_case(changes), tmp_path / "straight")
    straight = read_history(tmp_path / "straight", REACTIONS)["right_y_N"]
    assert np.abs(straight[-STEPS:] - free[-STEPS:]) == pytest.approx(0, abs=1e-3 * free[-1])
