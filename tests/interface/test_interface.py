"""The Python interface: in memory, on disk, step by step, on several ranks."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

import wovenfab
from tests.cli.test_commands import wovenfab as command
from wovenfab.cli.report import export_results, report_results
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
        ROOT / "configs" / "bonded-1x3.yaml",
        ["accuracy=20 %", "discretisation=null", "program={type: ramp, to: 20 mm, steps: 2}",
         "solver.factor=renewed"],
    )  # fmt: skip
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
    np.testing.assert_allclose(columns["force_N"], run.history["force"], rtol=1e-10)
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


OWN = """
import pathlib
pathlib.Path(__file__).with_name("executed").touch()
"""


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the results of a run with an effect of its own and a table."""
    folder = tmp_path_factory.mktemp("own")
    text = (ROOT / "docs" / "examples" / "my_effect.py").read_text()
    (folder / "my_effect.py").write_text(text + OWN)
    (folder / "table.csv").write_text("time_s,displacement_m\n0,0\n1,0.01\n")
    (folder / "case.yaml").write_text(
        "sheet: {length: 0.3 m, width: 0.1 m, fibres: [45 deg, -45 deg]}\n"
        "effects:\n  stretch: {stiffness: 100 kN/m}\n"
        "  my_effect: {file: my_effect.py, stiffness: 50 N/m}\n"
        "boundary: {left: clamp, right: {displacement: [program, 0]}}\n"
        "program: {type: table, file: table.csv, steps: 2}\n"
        "discretisation: {degree: 2, mesh_size: 0.1 m}\noutput: {pictures: false}\n"
    )
    wovenfab.simulate(folder / "case.yaml", folder / "run")
    assert (folder / "executed").exists()
    (folder / "executed").unlink()
    return folder


@pytest.mark.parametrize(
    "gone", [pytest.param((), marks=pytest.mark.slow), ("my_effect.py", "table.csv")]
)
def test_results_are_read_from_data_alone(own: Path, gone: tuple[str, ...], tmp_path: Path) -> None:
    folder = shutil.copytree(own, tmp_path / "moved")
    for name in gone:
        (own / name).rename(tmp_path / name)
    try:
        read = wovenfab.read_results(folder / "run")
        assert read.finished and read.history["force"][-1] > 0 and "finished" in repr(read)
        assert read.fields.field("displacement", -1).max() > 0
        assert report_results([folder / "run"], None) == 0
        assert export_results(folder / "run", None, last=True) == 0
        with pytest.raises(wovenfab.CaseError, match=r"runs .*my_effect\.py"):
            _ = read.case
    finally:
        for name in gone:
            (tmp_path / name).rename(own / name)
    assert not (own / "executed").exists() and not (folder / "executed").exists()
    assert wovenfab.read_case(own / "run" / "case.yaml").effects["my_effect"]
    (own / "executed").unlink()


def test_a_run_goes_on_where_its_files_were_moved_with_it(own: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(own, tmp_path / "moved")
    path = folder / "run" / "case.yaml"
    path.write_text(path.read_text().replace(str(own), str(folder)))
    ended = command("resume", "run", cwd=folder)
    assert ended.returncode == 0, ended.stderr
    (folder / "my_effect.py").write_text((folder / "my_effect.py").read_text() + "\n# other\n")
    ended = command("resume", "run", cwd=folder)
    assert ended.returncode == 2 and "my_effect" in ended.stderr


def test_resume_says_what_it_runs_before_it_does(own: Path) -> None:
    (own / "my_effect.py").write_text("import sys\nsys.exit('it was run')\n")
    ended = command("resume", "run", cwd=own)
    assert ended.returncode == 2
    assert "my_effect.py" in ended.stdout.splitlines()[0] and "it was run" in ended.stderr


def test_the_case_of_results_that_were_read_is_that_which_was_run(
    case: wovenfab.Case, tmp_path: Path
) -> None:
    written = wovenfab.simulate(case, tmp_path / "run")
    assert wovenfab.read_results(tmp_path / "run").case.to_yaml() == case.to_yaml()
    assert written.case == case


def test_damaged_results_are_one_message(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        wovenfab.read_results(tmp_path)
    (tmp_path / "history.csv").write_text("a,b\n1,2\n")
    with pytest.raises(ValueError, match=r"history\.csv:1: "):
        wovenfab.read_results(tmp_path)
