"""The Python interface: in memory, on disk, step by step, on several ranks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

import wovenfab
from wovenfab.record.results import ResultsExistError
from wovenfab.study import effects
from wovenfab.study.effects import Cost, parameters_of, sensitivities, study

ROOT = Path(__file__).parents[2]
SMALL = {
    "program": {"type": "ramp", "to": "10 mm", "steps": 3, "velocity": "0.1 m/s"},
    "discretisation.mesh_size": "150 mm",
    "discretisation.degree": 2,
    "output.pictures": False,
}


@pytest.fixture(scope="module")
def case() -> wovenfab.Case:
    return wovenfab.read_case(ROOT / "configs" / "bias-1x3.yaml", SMALL)


@pytest.fixture(scope="module")
def run(case: wovenfab.Case) -> wovenfab.Run:
    return wovenfab.simulate(case)


def test_a_run_in_memory_has_the_history_and_summary_of_one_on_disk(
    case: wovenfab.Case, run: wovenfab.Run, tmp_path: Path
) -> None:
    written = wovenfab.simulate(case, tmp_path / "run")
    read = wovenfab.read_results(tmp_path / "run")
    assert list(run.history) == list(written.history) == list(read.history)
    for name in run.history:
        np.testing.assert_array_equal(run.history[name], read.history[name])
    same = ("outcome", "steps", "peak_force_N", "dissipated_J", "cycles")
    assert [run.summary[k] for k in same] == [read.summary[k] for k in same]
    assert run.finished and read.finished and run.directory is None
    assert read.fields.field("beta", -1).max() > 0
    with pytest.raises(ResultsExistError):
        wovenfab.simulate(case, tmp_path / "run")


def test_columns_are_found_with_and_without_their_unit(run: wovenfab.Run) -> None:
    assert run.history["force"] is run.history["force_N"]
    assert run.history["energy_stretch"].shape == run.history["step"].shape == (4,)
    with pytest.raises(KeyError, match="no column 'forces'; it has step, time_s"):
        run.history["forces"]


def test_a_run_in_memory_writes_nothing_and_says_so(
    case: wovenfab.Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run = wovenfab.simulate(case)
    assert not list(tmp_path.iterdir())
    with pytest.raises(FileNotFoundError, match="a run in memory stores no fields"):
        _ = run.fields


def test_what_is_printed_of_objects_tells_what_they_are(run: wovenfab.Run) -> None:
    assert repr(run).startswith("Run(bias-1x3: finished, 3 steps, peak force ")
    assert repr(run.history).startswith("History(4 rows of step, time_s, displacement_m")


def test_steps_come_with_their_fields(case: wovenfab.Case, run: wovenfab.Run) -> None:
    forces, slips = [], []
    for step in wovenfab.steps(case):
        forces.append(step.force)
        slips.append(float(np.max(step.field("beta").x.array)))
        first, second = step.displacements
        assert first.x.array is second.x.array or first.x.array.size == second.x.array.size
    np.testing.assert_array_equal(forces, run.history["force"])
    assert slips[0] == 0 and np.all(np.diff(slips) > 0)
    with pytest.raises(KeyError, match="no field 'slip', but displacement_1"):
        step.field("slip")


def test_a_step_that_is_over_has_no_fields(case: wovenfab.Case) -> None:
    before = None
    for step in wovenfab.steps(case):
        if before is not None:
            told = f"step {before.number} is over: the fields are those of step {step.number}"
            with pytest.raises(wovenfab.StepOverError, match=told):
                before.field("beta")
            with pytest.raises(wovenfab.StepOverError, match=told):
                _ = before.displacements
        before = step
    assert before is not None and before.field("beta").x.array.max() > 0


def test_an_accuracy_is_obeyed_by_whatever_makes_steps(tmp_path: Path) -> None:
    """The same elements and steps for a run, for a loop, for derivatives and for effects."""
    case = wovenfab.read_case(
        ROOT / "configs" / "elastic-1x3.yaml",
        ["accuracy=5 %", "discretisation=null", "program={type: ramp, to: 20 mm, steps: 2}"],
    )
    run = wovenfab.simulate(case)
    unknowns = run.summary["unknowns"]
    assert "accuracy" in run.summary
    forces = []
    for step in wovenfab.steps(case):
        forces.append(step.force)
        assert step.simulation.model.unknowns == unknowns
    np.testing.assert_array_equal(forces, run.history["force"])
    told: list[str] = []
    targets = parameters_of(case)[:1]
    columns = sensitivities(case, targets, MPI.COMM_SELF, lambda _: None, told.append)
    np.testing.assert_array_equal(columns["force_N"], run.history["force"])
    assert told[0].startswith("chosen: degree ")
    with monkeypatched_measure() as measured:
        study(case, MPI.COMM_SELF, lambda _: None)
    assert {m.accuracy for m in measured} == {None}
    assert {m.discretisation for m in measured} == {run.case.discretisation}

    again = run.case.changed("output.every=3")
    assert again.accuracy is None and again.output.every == 3
    assert again.discretisation == run.case.discretisation and again.time == run.case.time


@contextmanager
def monkeypatched_measure() -> Iterator[list[wovenfab.Case]]:
    """Note the cases of a study of effects instead of running them."""
    measured: list[wovenfab.Case] = []
    with pytest.MonkeyPatch.context() as patch:
        cost = Cost(*[0] * len(fields(Cost)))
        patch.setattr(effects, "measure", lambda case, _: (measured.append(case), cost)[1])
        yield measured


def test_a_field_as_a_function_has_the_values_of_the_results(
    case: wovenfab.Case, tmp_path: Path
) -> None:
    stored = wovenfab.simulate(case, tmp_path / "run").fields
    *_, last = wovenfab.steps(case)
    for name in ("shear_angle", "curvature_1", "relative_displacement"):
        values = last.field(name).x.array
        expected = stored.field(name, -1)
        assert np.max(values) == pytest.approx(np.max(expected), rel=1e-6)
        assert np.min(values) == pytest.approx(np.min(expected), rel=1e-6)


def test_a_failed_run_keeps_its_history_and_says_why(case: wovenfab.Case) -> None:
    hard = case.changed("solver.max_iterations=1", "time.smallest_step=0.5")
    run = wovenfab.simulate(hard)
    assert not run.finished and "no equilibrium at t = " in run.summary["outcome"]
    assert len(run.history["step"]) >= 1


@pytest.mark.mpi
def test_all_ranks_get_the_history_of_one(case: wovenfab.Case) -> None:
    together = wovenfab.simulate(case)
    alone = wovenfab.simulate(case, comm=MPI.COMM_SELF)
    for name in ("force", "dissipated", "energy"):
        scale = np.abs(alone.history[name]).max()
        assert together.history[name] == pytest.approx(alone.history[name], abs=1e-8 * scale)
