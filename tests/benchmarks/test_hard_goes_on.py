"""A hard case that was killed goes on from its checkpoint, with the same figures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from petsc4py import PETSc

from benchmarks.hard import measurement
from benchmarks.hard.measurement import FOLDER, Measurement
from benchmarks.hard.row import Setting
from wovenfab.simulation.simulation import Simulation

SETTING = Setting(
    "bias-1x3",
    (
        "discretisation={degree: 2, mesh_size: 100 mm}",
        "program={type: cycles, amplitudes: [40 mm], max_velocity: 0.5 m/s}",
        *("time.steps_per_cycle=12", "solver.factor=renewed"),
    ),
)
KILLED_AT = 8


class KilledError(Exception):
    """In place of a signal."""


@pytest.mark.slow
def test_a_row_that_was_killed_goes_on_with_the_same_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = Measurement(SETTING).run().figures()
    monkeypatch.setenv(FOLDER, str(tmp_path))
    monkeypatch.setattr(measurement, "EVERY", "3")
    killed = Measurement(SETTING)
    margin, steps = killed.equilibrium.crossing.margin, killed.steps

    def margin_until_killed() -> float:
        if len(steps) > KILLED_AT:
            raise KilledError
        return float(margin())

    monkeypatch.setattr(killed.equilibrium.crossing, "margin", margin_until_killed)
    with pytest.raises((KilledError, PETSc.Error)):
        killed.run()
    resumed: list[int] = []
    resume = Simulation.resume

    def noted(self: Simulation, checkpoint: Any) -> None:
        resumed.append(checkpoint.step)
        resume(self, checkpoint)

    monkeypatch.setattr(Simulation, "resume", noted)
    assert Measurement(SETTING).run().figures() == whole
    assert len(resumed) == 1 and 3 <= resumed[0] <= KILLED_AT
    assert Measurement(SETTING).run().figures() == whole  # from its end
