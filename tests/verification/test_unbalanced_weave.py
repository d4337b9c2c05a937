"""An unbalanced weave takes the shape of an S in bias extension, a balanced one does not."""

from __future__ import annotations

from pathlib import Path

import pytest

import wovenfab
from wovenfab.case import Rectangle, read_case

CONFIGS = Path(__file__).parents[2] / "configs"
PROGRAM = {"type": "ramp", "to": "60 mm", "duration": "1 s", "steps": 10}


def _across(*changes: str) -> list[float]:
    """Return the displacement (m) across at a quarter, half and three quarters of the axis."""
    test, fabric = CONFIGS / "tests", CONFIGS / "fabrics"
    case = read_case(
        test / "bias-extension-held.yaml",
        ["accuracy=null", "discretisation={degree: 3, mesh_size: 45 mm}", *changes],
        fabric / "unbalanced.yaml",
    )
    assert isinstance(case.sheet, Rectangle)
    length, width = case.sheet.length, case.sheet.width
    places = {"quarter": 0.25, "half": 0.5, "three_quarters": 0.75}
    probes = {n: {"type": "point", "at": [a * length, width / 2]} for n, a in places.items()}
    run = wovenfab.simulate(case.changed({"program": PROGRAM, "output.probes": probes}))
    assert run.finished
    return [float(run.history[f"{name}_displacement_y_m"][-1]) for name in places]


@pytest.mark.slow
def test_the_axis_of_an_unbalanced_weave_takes_the_shape_of_an_s() -> None:
    first, middle, last = _across()
    assert first > 1e-3
    assert last == pytest.approx(-first, rel=0.01)
    assert abs(middle) < 0.01 * first
    assert max(map(abs, _across("effects.bending.stiffness=0.1 N*m"))) < 0.01 * first
