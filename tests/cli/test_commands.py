"""The command line as a user meets it: what it prints, writes and exits with."""

from __future__ import annotations

import csv
import json
import os
import re
import subprocess
import sys
from math import acos, pi
from pathlib import Path

import pytest

from wovenfab.case import read_case
from wovenfab.record.fields import read_fields
from wovenfab.record.summary import read_summary
from wovenfab.study.errors.report import expected_seconds

#: A bonded sheet with spin friction on a coarse mesh: one placement, two cycles, quick.
CASE = """\
title: Small test
sheet: {length: 0.9 m, width: 0.3 m, fibres: [45 deg, -45 deg]}
effects:
  stretch: {stiffness: 1.27e8 N/m}
  shear: {stiffness: 400 N/m}
  bending: {stiffness: 254.1 N*m}
  spin_friction: {strength: 30 N/m, slope: 40 s}
boundary: {left: clamp, right: {displacement: [program, 0]}}
program: {type: cycles, amplitudes: [10 mm, 20 mm], max_velocity: 0.5 m/s}
discretisation: {degree: 2, mesh_size: 150 mm}
time: {steps_per_cycle: 8}
output: {every: 7, pictures: false}
"""
DOCS = Path(__file__).parents[2] / "docs"
CUSTOM_LAW = (DOCS / "examples" / "my_effect.py").read_text().replace("my_effect", "law")
COLUMNS = (
    "step,time_s,displacement_m,force_N,force_transverse_N,energy_J,energy_bending_J,"
    "energy_shear_J,energy_stretch_J,dissipated_J,dissipated_spin_friction_J,work_J,imbalance_J,"
    "newton_iterations,negative_eigenvalues"
)


def wovenfab(*arguments: object, cwd: Path, ranks: int = 1) -> subprocess.CompletedProcess[str]:
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    own = {k: v for k, v in os.environ.items() if not k.startswith(("OMPI_COMM", "PMIX"))}
    command = [*launcher, sys.executable, "-m", "wovenfab", *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, env=own, text=True, capture_output=True, check=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the case and the results of its run."""
    path = tmp_path_factory.mktemp("commands")
    (path / "small.yaml").write_text(CASE)
    ended = wovenfab("run", "small.yaml", cwd=path)
    assert ended.returncode == 0, ended.stderr
    return path


@pytest.fixture(scope="module")
def results(folder: Path) -> Path:
    """Return the directory of the results."""
    return folder / "results" / "small"


def rows(path: Path, name: str = "history") -> list[dict[str, str]]:
    with (path / f"{name}.csv").open() as stream:
        return list(csv.DictReader(stream))


def test_a_run_writes_all_its_files_into_results_by_name(results: Path) -> None:
    tables = {"history.csv", "reactions.csv", "cycles.csv"}
    others = {"case.yaml", "summary.json", "fields.xdmf", "fields.h5", "fields", "checkpoint.h5"}
    assert {p.name for p in results.iterdir() if p.name[0] != "."} == tables | others


def test_history_has_the_promised_columns_and_one_row_a_step(results: Path) -> None:
    table = rows(results)
    assert ",".join(table[0]) == COLUMNS
    page = (DOCS / "results.md").read_text()
    for column in table[0]:
        general = re.sub("_(bending|shear|stretch|spin_friction)_", "_<effect>_", column)
        assert f"`{general}`" in page
    assert [int(r["step"]) for r in table] == list(range(17))
    assert [float(table[i]["displacement_m"]) for i in (4, 8, 12, 16)] == [0.01, 0.0, 0.02, 0.0]


def test_the_case_as_resolved_reads_as_the_same_case(folder: Path, results: Path) -> None:
    again = read_case(results / "case.yaml")
    assert again.model_dump() == read_case(folder / "small.yaml").model_dump()


def test_summary_has_peak_force_cycles_and_phases(results: Path) -> None:
    summary = read_summary(results)
    assert summary["outcome"] == "finished"
    assert summary["peak_force_N"] == max(float(r["force_N"]) for r in rows(results))
    assert len(summary["cycles"]) == 2
    assert {"import", "mesh", "compile", "steps"} <= set(summary["wall_time_s"])


def test_cycles_have_the_figures_of_a_laboratory(results: Path) -> None:
    for row, figures in zip(rows(results, "cycles"), read_summary(results)["cycles"], strict=True):
        del figures["complete"]
        assert {name: float(row[name]) for name in figures} == pytest.approx(figures)
        span, d = 0.6, float(row["peak_displacement_m"])
        angle = pi / 2 - 2 * acos((span + d) / (2**0.5 * span))
        assert float(row["shear_angle_kinematic_rad"]) == pytest.approx(angle)
        # not the same: yarns that bend carry the turn from zone to zone
        assert float(row["shear_angle_field_rad"]) == pytest.approx(angle, rel=0.2)
        assert float(row["normalised_shear_force_N_per_m"]) > 0


def test_fields_are_stored_at_reversals_too(results: Path) -> None:
    assert read_fields(results).steps.tolist() == [0, 4, 7, 8, 12, 14, 16]


def test_existing_results_are_never_overwritten_silently(folder: Path, results: Path) -> None:
    before = (results / "history.csv").read_bytes()
    ended = wovenfab("run", "small.yaml", cwd=folder)
    assert ended.returncode == 2
    assert "already holds results" in ended.stderr
    assert "--overwrite" in ended.stderr
    assert (results / "history.csv").read_bytes() == before


def test_a_bad_case_ends_with_2_one_line_a_problem_and_nothing_written(tmp_path: Path) -> None:
    (tmp_path / "bad.yaml").write_text(CASE.replace("stretch: {stiffness", "stretch: {stifness"))
    ended = wovenfab("run", "bad.yaml", cwd=tmp_path)
    assert ended.returncode == 2
    assert ended.stderr.startswith("bad.yaml:4: effects.stretch.stifness: unknown key.")
    assert "Did you mean 'stiffness'?" in ended.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["bad.yaml"]


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [1, 2])
def test_a_custom_effect_that_cannot_be_compiled_ends_with_2_and_nothing_written(
    tmp_path: Path, ranks: int
) -> None:
    law = CUSTOM_LAW.replace("gamma**2", 'float("nan") * gamma**2')
    assert law != CUSTOM_LAW
    (tmp_path / "law.py").write_text(law)
    custom = "law: {file: law.py, stiffness: 400 N/m}"
    (tmp_path / "case.yaml").write_text(CASE.replace("shear: {stiffness: 400 N/m}", custom))
    ended = wovenfab("run", "case.yaml", cwd=tmp_path, ranks=ranks)
    assert ended.returncode == 2
    assert ended.stderr.count("wovenfab: law.py: the effect cannot be compiled: ") == 1
    assert "Its functions return one number in J/m^2" in ended.stderr
    assert "Traceback" not in ended.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["case.yaml", "law.py"]


def test_an_edge_that_the_geometry_lacks_is_named_with_its_line(tmp_path: Path) -> None:
    geometry = Path(__file__).parents[2] / "meshes" / "rectangle.geo"
    file = f"file: {os.path.relpath(geometry, tmp_path)}"
    text = CASE.replace("length: 0.9 m, width: 0.3 m", file)
    (tmp_path / "case.yaml").write_text(text.replace("left: clamp", "lefft: clamp"))
    ended = wovenfab("run", "case.yaml", cwd=tmp_path)
    assert ended.returncode == 2
    assert "case.yaml:8: boundary.lefft: the sheet has no edge 'lefft'" in ended.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["case.yaml"]


def test_a_step_that_cannot_be_made_ends_with_3_and_keeps_the_others(folder: Path) -> None:
    ended = wovenfab(
        "run", "small.yaml", "-o", "failed",
        "--set", "program={type: ramp, to: -1.2 m, steps: 12, velocity: 0.5 m/s}",
        "--set", "time.smallest_step=0.25", "--set", "effects.spin_friction=null", cwd=folder,
    )  # fmt: skip
    assert ended.returncode == 3, ended.stderr
    assert "no equilibrium at t = " in ended.stderr
    assert "Traceback" not in ended.stderr
    table, summary = rows(folder / "failed"), read_summary(folder / "failed")
    assert 1 < len(table) < 11
    assert all("nan" not in value for row in table for value in row.values())
    assert summary["outcome"].startswith("no equilibrium")
    assert summary["cut_backs"] > 0


#: What makes the small case buckle: yarns along the axis, and a push.
PUSH = (
    "--set", "sheet.fibres=[0 deg, 90 deg]", "--set", "effects.spin_friction=null",
    "--set", "program={type: ramp, to: -2 mm, steps: 2}",
)  # fmt: skip


def test_a_sheet_that_buckles_ends_with_3_its_critical_load_and_its_mode(folder: Path) -> None:
    ended = wovenfab("run", "small.yaml", "-o", "buckled", *PUSH, cwd=folder)
    assert ended.returncode == 3, ended.stderr
    assert "loses its stability at t = " in ended.stderr
    assert "solver.stability=follow goes on along the branch" in ended.stderr
    (loss,) = read_summary(folder / "buckled")["losses_of_stability"]
    table = rows(folder / "buckled")
    for name in ("displacement_m", "force_N"):
        assert loss[name] == float(table[-1][name])
    assert all(row["negative_eigenvalues"] == "0" for row in table)
    modes = read_fields(folder / "buckled", "mode")
    assert modes.times.tolist() == [loss["time_s"]]
    mode = modes.field("mode", 0)
    assert abs(mode).max() == pytest.approx(1.0, rel=1e-6)
    assert abs(mode[:, 1]).max() == abs(mode).max()  # across the yarns


@pytest.mark.slow
def test_a_branch_is_followed_and_a_saddle_told(folder: Path) -> None:
    said, energies = [], []
    for way in ("follow", "ignore"):
        options = *PUSH, "--set", f"solver.stability={way}"
        ended = wovenfab("run", "small.yaml", "-o", way, *options, cwd=folder)
        assert ended.returncode == 0
        said.append(ended.stdout)
        energies.append(float(rows(folder / way)[-1]["energy_J"]))
    assert "branch followed" in said[0] and "warning" not in said[0]
    assert "warning: 2 of 2 states are saddles" in said[1]
    assert energies[0] < 0.2 * energies[1]
    assert read_summary(folder / "follow")["saddles"] == 0


@pytest.mark.slow
def test_petsc_options_are_reachable_from_the_case_and_the_command_line(folder: Path) -> None:
    short = "program={type: ramp, to: 1 mm, steps: 1, velocity: 0.5 m/s}"
    by_case = wovenfab(
        "run", "small.yaml", "-o", "petsc1", "--set", short,
        "--set", "solver.petsc={snes_monitor: ''}", cwd=folder,
    )  # fmt: skip
    by_command = wovenfab(
        "run", "small.yaml", "-o", "petsc2", "--set", short, "--", "-snes_view", cwd=folder
    )
    assert "SNES Function norm" in by_case.stdout, by_case.stderr
    assert "type: cholesky" in by_command.stdout, by_command.stderr
    assert "package used to perform factorization: mumps" in by_command.stdout


def test_check_says_what_would_be_built_and_writes_nothing(
    folder: Path, results: Path, tmp_path: Path
) -> None:
    ended = wovenfab("check", folder / "small.yaml", cwd=tmp_path)
    assert ended.returncode == 0
    assert "one placement, facet integrals (bending), rates by bdf2" in ended.stdout
    grouped = f"{read_summary(results)['unknowns']:,}".replace(",", " ")
    assert f": {grouped} unknowns, 16 load steps" in ended.stdout
    assert not list(tmp_path.iterdir())


def test_check_refuses_a_mesh_that_is_too_large_by_its_head(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "sheet.msh").write_text(
        "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n9 900000000 1 900000000\n"
    )
    sheet = f"sheet={{file: {tmp_path / 'sheet.msh'}, fibres: [45 deg, -45 deg]}}"
    asked = "--set", sheet, "--set", "discretisation.mesh_size=null"
    ended = wovenfab("check", folder / "small.yaml", *asked, cwd=tmp_path)
    assert ended.returncode == 2
    assert "about 7.2e+09 unknowns need about" in ended.stderr


@pytest.mark.slow
def test_check_says_what_an_effect_would_bring_and_which_does_nothing(folder: Path) -> None:
    told = wovenfab(
        "check", "small.yaml", "--set", "effects.spin_friction.strength=0", cwd=folder
    ).stdout
    assert "spin_friction has a value of zero and changes nothing: leave it out" in told
    second = "would bring a second placement"
    assert f"adding coupling, slip_friction or viscous_slip {second}\n" in told
    without = wovenfab("check", "small.yaml", "--set", "effects.spin_friction=null", cwd=folder)
    assert "one placement, facet integrals (bending), rate-independent:" in without.stdout
    assert "adding spin_friction would bring rates, so that speed matters" in without.stdout
    assert f"adding coupling {second}\n" in without.stdout
    assert f"adding slip_friction or viscous_slip {second} and rates" in without.stdout


def test_check_says_how_long_an_accuracy_takes_and_more_for_a_smaller_one(folder: Path) -> None:
    def wanted(accuracy: str) -> list[str]:
        return [f"accuracy={accuracy}", "discretisation=null", "time=null"]

    overrides = [word for text in wanted("1 %") for word in ("--set", text)]
    told = wovenfab("check", "small.yaml", *overrides, cwd=folder).stdout
    assert re.search(r"^1 % takes about [1-9]\d* (s|min) on two processors", told, re.MULTILINE)
    cases = [read_case(folder / "small.yaml", wanted(text)) for text in ("1 %", "0.3 %")]
    at_once, slower = map(expected_seconds, cases)
    assert at_once < slower


def test_check_prints_the_case_as_resolved_and_nothing_else(folder: Path, tmp_path: Path) -> None:
    text = f"from: {os.path.relpath(folder / 'small.yaml', tmp_path)}\ntitle: Other"
    (tmp_path / "other.yaml").write_text(text)
    told = wovenfab("check", "other.yaml", "--resolved", cwd=tmp_path).stdout
    (tmp_path / "whole.yaml").write_text(told)
    read = read_case(tmp_path / "whole.yaml")
    assert read.model_dump() == read_case(tmp_path / "other.yaml").model_dump()
    assert read.title == "Other"


def test_schema_is_json(tmp_path: Path) -> None:
    schema = json.loads(wovenfab("schema", cwd=tmp_path).stdout)
    assert "stretch" in json.dumps(schema)


@pytest.mark.slow
def test_two_ranks_speak_with_one_voice_and_find_the_same_forces(folder: Path) -> None:
    """The ranks must agree to 1e-8 of the largest, and each line must be printed once."""
    ended = wovenfab("run", "small.yaml", "-o", "two", cwd=folder, ranks=2)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.count("done: 16 steps") == 1
    one, two = (rows(run) for run in (folder / "results" / "small", folder / "two"))
    for column in ("force_N", "energy_J", "dissipated_J"):
        alone, together = ([float(row[column]) for row in table] for table in (one, two))
        assert together == pytest.approx(alone, rel=0, abs=1e-8 * max(map(abs, alone)))
    iterations = [[row["newton_iterations"] for row in table] for table in (one, two)]
    assert iterations[0] == iterations[1]


@pytest.mark.slow
def test_code_in_the_current_folder_is_never_run(tmp_path: Path) -> None:
    """Also not when that folder is another clone: its code would bear this one's name."""
    (tmp_path / "small.yaml").write_text(CASE)
    names = "json.py", "random.py", "yaml.py", "forms/__init__.py", "wovenfab/__init__.py"
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("open('ran', 'w').close()\nraise SystemExit('ran')\n")
    command = [DOCS.parent / "env" / "bin" / "wovenfab", "check", "small.yaml"]
    ended = subprocess.run(command, cwd=tmp_path, text=True, capture_output=True, check=False)
    assert ended.returncode == 0 and "the case is valid" in ended.stdout, ended.stderr
    (tmp_path / "wovenfab" / "__init__.py").unlink()
    (tmp_path / "wovenfab").rmdir()
    assert wovenfab("check", "small.yaml", cwd=tmp_path).returncode == 0
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    "words",
    [
        ("again.yaml",),
        pytest.param(("-v", "2"), marks=pytest.mark.slow),
        pytest.param(("--", "-malloc_debug", "nope"), marks=pytest.mark.slow),
    ],
)
def test_a_word_too_many_and_what_petsc_cannot_start_with_are_bad_input(
    words: tuple[str, ...], tmp_path: Path
) -> None:
    (tmp_path / "small.yaml").write_text(CASE)
    ended = wovenfab("run", "small.yaml", *words, cwd=tmp_path)
    assert ended.returncode == 2 and "Traceback" not in ended.stderr
    assert words[-1] in ended.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["small.yaml"]


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ("-pc_type python -pc_python_type x.Y", "No module named 'x'"),
        *(
            pytest.param(*option, marks=pytest.mark.slow)
            for option in (
                ("-pc_type nope", "PC type nope"),
                ("-pc_factor_mat_solver_type nope", "solver type nope"),
                ("-mat_mumps_icntl_14 abc", "no integer value"),
                ("-mat_type nope", "Unknown type"),
            )
        ),
    ],
)
def test_a_petsc_option_that_cannot_be_used_is_bad_input(
    options: str, word: str, tmp_path: Path
) -> None:
    (tmp_path / "small.yaml").write_text(CASE)
    (tmp_path / "x.py").write_text("class Y: pass\n")
    ended = wovenfab("run", "small.yaml", "--", *options.split(), cwd=tmp_path)
    assert ended.returncode == 2 and "Traceback" not in ended.stderr
    assert word in ended.stderr and "solver.petsc: PETSc does not take" in ended.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["small.yaml", "x.py"]
