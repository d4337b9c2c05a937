"""An accuracy study of cases whose exact answers are known recovers their true errors."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from dataclasses import replace
from math import sin, sqrt
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad

from benchmarks.accuracy_page import ROOT, STUDIES, Shown
from tests import scenes
from tests.cli.test_commands import rows
from tests.verification.test_closed_forms import SLOPE, SOFT, SPIN, STIFF, bias_pull
from wovenfab.case import CaseError, read_case
from wovenfab.case.fingerprint import fingerprint
from wovenfab.cli.studies import study_accuracy
from wovenfab.record.field_file import newest_checkpoint
from wovenfab.record.results import CHECKPOINT
from wovenfab.study.accuracy.errors import Refinement, best_of, order_of, own_error
from wovenfab.study.accuracy.measure import (
    DISSIPATED,
    PEAK_FORCE,
    Measured,
    RmsBeta,
    StoredRuns,
    measure,
)
from wovenfab.study.accuracy.settings import Setting
from wovenfab.study.accuracy.strategy import Runner, run_study
from wovenfab.study.accuracy.study import TARGETS, Study

#: A strip along its yarns whose stiffness varies: springs in series.
SPRINGS = """
sheet: {length: 1 m, width: 0.5 m, fibres: [0 deg, 90 deg]}
effects:
  stretch: {stiffness: 1e5 N/m * (1 + 0.9*sin(7*x/1 m))}
  shear: {stiffness: 400 N/m}
boundary: {left: clamp, right: {displacement: [program, 0]}}
program: {type: ramp, to: 1 mm, steps: 1}
discretisation: {degree: 2, mesh_size: 250 mm}
"""
#: A homogeneous pull with spin friction: an ordinary differential equation.
PULL = f"""
sheet: {{length: 1 m, width: 1 m, fibres: [45 deg, -45 deg]}}
effects:
  stretch: {{stiffness: {STIFF} N/m}}
  shear: {{stiffness: {SOFT} N/m}}
  spin_friction: {{strength: {SPIN} N/m, slope: {SLOPE} s}}
boundary:
  left: {{displacement: [0, free]}}
  bottom: {{displacement: [free, 0]}}
  right: {{displacement: [program, free]}}
program: {{type: cycles, amplitudes: 300 mm, frequency: 0.5 Hz}}
discretisation: {{degree: 2, mesh_size: 0.5 m}}
time: {{steps_per_cycle: 80}}
"""


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "case.yaml"
    path.write_text(text)
    return path


def counted(path: Path) -> Runner:
    """Return a runner in this process whose times are counts, the same on every machine."""

    def run(setting: Setting) -> Measured:
        measured = measure(read_case(path, setting.overrides))
        return replace(measured, setup=0.0, stepping=1e-4 * measured.unknowns * measured.steps)

    return run


def studied(path: Path, budget: float) -> Study:
    return run_study(read_case(path), counted(path), budget, lambda *_: None)


@pytest.mark.slow  # what a study finds depends on the time it has
def test_errors_in_space_are_the_true_ones(tmp_path: Path) -> None:
    study = studied(written(tmp_path, SPRINGS), 12.0)
    compliance = quad(lambda x: 1 / (1e5 * (1 + 0.9 * sin(7 * x))), 0, 1, epsabs=1e-16, limit=200)
    exact = 0.5 * 1e-3 / compliance[0]
    best = study.best["space"][PEAK_FORCE]
    true = abs(best.value - exact)
    print(f"\nbest {best.value:.8g} N ± {best.error:.1e}, exact {exact:.8g}, off {true:.1e}")
    assert true <= 3 * best.error
    assert best.relative < 1e-3
    compared = 0
    for run in study.space:
        wrong = abs(run.measured.values[PEAK_FORCE] - exact)
        if wrong > 3 * best.error:
            compared += 1
            assert study.errors(run)[PEAK_FORCE] * exact == pytest.approx(wrong, rel=0.35)
    assert compared > 3
    for target, run in study.chosen.items():
        if run is not None:
            assert abs(run.measured.values[PEAK_FORCE] / exact - 1) <= target
    assert study.chosen[0.01] is not None


@pytest.mark.slow  # what a study finds depends on the time it has
def test_errors_in_time_and_together_are_the_true_ones(tmp_path: Path) -> None:
    study = studied(written(tmp_path, PULL), 60.0)
    times = np.linspace(0, 2, 4001)
    y, force = bias_pull(0.3, 2.0, times)
    x = 1 + 0.15 * (1 - np.cos(np.pi * times))
    size, skew = sqrt((x[-1] ** 2 + y[-1] ** 2) / 2), (x[-1] / y[-1] - y[-1] / x[-1]) / 2
    stored = STIFF * (size - 1) ** 2 + SOFT * skew**2 / 2
    exact = {
        PEAK_FORCE: force[np.abs(force).argmax()],
        DISSIPATED: float(np.trapezoid(force, x)) - stored,
    }
    compared = 0
    for name, true in exact.items():
        best = study.best["both"][name]
        off = abs(best.value - true)
        print(
            f"\n{name}: best {best.value:.7g} ± {best.error:.1e}, exact {true:.7g}, off {off:.1e}"
        )
        assert off <= 2 * best.error
        assert best.relative < 1e-3
        for run in (*study.time, *study.both):
            wrong = abs(run.measured.values[name] - true)
            if wrong > 3 * best.error:
                compared += 1
                estimated = study.errors(run)[name] * abs(true)
                assert estimated == pytest.approx(wrong, rel=0.35)
    assert compared > 10
    for target in TARGETS[:2]:
        run = study.chosen[target]
        assert run is not None
        for name, true in exact.items():
            assert abs(run.measured.values[name] / true - 1) <= target


@pytest.mark.parametrize("order", [1.0, 2.0, 3.5])
def test_the_order_from_sizes_of_any_ratio(order: float) -> None:
    sizes = (1.0, 0.7, 0.2)
    values = tuple(5 - 2 * h**order for h in sizes)
    assert order_of(sizes, values) == pytest.approx(order)
    assert own_error(Refinement("a", sizes, values, 4)) == pytest.approx(2 * 0.2**order)


def test_a_higher_order_than_in_theory_is_taken_for_chance() -> None:
    ladder = Refinement("a", (4, 2, 1), (1.0, 1.8, 1.801), 2)
    assert own_error(ladder) == pytest.approx(0.8 / 4 / 3)


def test_without_an_order_nothing_is_extrapolated() -> None:
    assert order_of((4, 2, 1), (1.0, 2.0, 1.5)) is None
    assert own_error(Refinement("a", (4, 2, 1), (1.0, 2.0, 1.5), 2)) == 1.0
    assert own_error(Refinement("a", (1,), (1.0,), 2)) == np.inf


def test_where_refinement_is_irregular_no_order_is_believed() -> None:
    ladder = Refinement("adaptive", (4, 2, 1), (2.0, 1.2, 1.19), 2, regular=False)
    assert own_error(ladder) == pytest.approx(0.8)


def test_a_method_that_converges_to_something_else_is_not_believed() -> None:
    wrong = Refinement("wrong", (4, 2, 1), (2.16, 2.04, 2.01), 2)
    right = Refinement("right", (4, 2, 1), (1.4, 1.2, 1.1), 2)
    best = best_of([right, wrong])
    assert best.method == "wrong"
    assert best.error == pytest.approx(0.91), "right goes the other way"
    upwards = Refinement("right", (4, 2, 1), (2.4, 2.6, 2.7), 2)
    assert best_of([upwards, wrong]).error == pytest.approx(0.69)
    unclear = Refinement("right", (4, 2, 1), (2.5, 2.8, 2.7), 2)
    assert best_of([unclear, wrong]).error == pytest.approx(0.69 - 0.3)


def test_a_method_that_is_on_its_way_to_the_best_answer_supports_it() -> None:
    near = Refinement("near", (4, 2, 1), (2.16, 2.04, 2.01), 2)
    behind = Refinement("behind", (4, 2, 1), (2.32, 2.16, 2.08), 2)
    assert best_of([behind, near]).error == own_error(near) == pytest.approx(0.01)


def test_rms_beta_is_that_of_the_field() -> None:
    numerics = replace(scenes.PROTOTYPE, history=0)
    model = scenes.model(scenes.sheet(0.9, 0.3, 0.15), scenes.COUPLED, numerics)
    rms = RmsBeta(model)
    model.field.interpolate(lambda x: np.stack([0 * x[0], 0 * x[0], 3e-3 * x[0], 4e-3 * x[0]]))
    assert rms() == pytest.approx(5e-3 * 0.9 / sqrt(3), rel=1e-12)
    bonded = scenes.model(scenes.sheet(0.9, 0.3, 0.15), scenes.BONDED, numerics)
    assert not RmsBeta(bonded).is_defined


def test_the_command_stores_its_runs_and_prints_what_is_cheapest(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path, output = written(tmp_path, SPRINGS), tmp_path / "study"
    assert study_accuracy(path, output, (), 1e-3) == 0
    printed = capfd.readouterr().out
    assert "left" in printed and "cheapest setting" in printed
    runs = rows(output, "accuracy")
    assert runs and all(int(row["peak_memory_B"]) > 50e6 for row in runs)
    assert all(float(row["peak_force_interpolated_N"]) > 0 for row in runs)
    assert (output / "accuracy-space.png").stat().st_size > 10_000
    assert study_accuracy(path, output, (), 1e-3) == 0
    assert f"{len(runs)} of {len(runs)} runs were there already" in capfd.readouterr().out
    assert rows(output, "accuracy") == runs


def test_an_interrupted_run_leaves_nothing_and_a_failed_one_its_reason(tmp_path: Path) -> None:
    path = written(tmp_path, SPRINGS)

    def interrupt(_: float) -> None:
        raise KeyboardInterrupt

    setting = Setting("space", "any", 2, "any", ("discretisation.mesh_size=4 mm",), ())
    with pytest.raises(KeyboardInterrupt):
        StoredRuns(read_case(path), tmp_path / "runs", interrupt)(setting)
    assert not (tmp_path / "runs").exists()
    hopeless = Setting("space", "any", 2, "any", (), ("program.to=-2 m", "program.steps=1"))
    measured = StoredRuns(read_case(path), tmp_path / "runs")(hopeless)
    assert "no equilibrium" in measured.failure


def test_a_case_without_a_mesh_size_is_refused_with_its_line(tmp_path: Path) -> None:
    text = (ROOT / "configs" / "dogbone.yaml").read_text().replace("../meshes/", f"{ROOT}/meshes/")
    path = written(tmp_path, re.sub("mesh_size: .*", "", text))
    with pytest.raises(CaseError, match=r"case\.yaml:\d+.*mesh size"):
        study_accuracy(path, tmp_path / "study", (), 1.0)
    assert not (tmp_path / "study").exists()


@pytest.mark.parametrize("shown", STUDIES, ids=lambda s: s.name)
def test_the_cases_of_the_page_can_be_read(shown: Shown) -> None:
    assert read_case(ROOT / shown.case, shown.settings).needs.placements == (
        1 if "bonded" in shown.name else 2
    )


def test_a_run_that_was_killed_goes_on_from_its_checkpoint(tmp_path: Path) -> None:
    case = read_case(written(tmp_path, PULL), ("time.steps_per_cycle=400", "output.checkpoint=10"))
    runs, setting = StoredRuns(case, tmp_path / "store"), Setting("both", "P2", 2.0, "", (), ())
    changed = case.changed(*setting.overrides)
    whole = measure(changed)
    folder = tmp_path / "store" / fingerprint(changed, Path(measure.__code__.co_filename))
    module = ["-m", "wovenfab.study.accuracy.measure", str(case.path), str(folder)]
    with subprocess.Popen([sys.executable, *module, *changed.overrides]) as running:
        while running.poll() is None and not (folder / CHECKPOINT).exists():
            time.sleep(0.01)
        running.kill()
    before = newest_checkpoint(folder).step
    again = runs(setting)
    assert 0 < before < again.steps
    assert (again.values, again.steps, again.iterations) == (
        whole.values,
        whole.steps,
        whole.iterations,
    )
    assert list((tmp_path / "store").iterdir()) == [folder.with_suffix(".json")]
