"""A run that was stopped goes on as if it never had been.

To the last bit on the same ranks where each tangent is factorised. A factor that is kept is formed
anew, and the histories agree to 1e-8.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from mpi4py import MPI

from wovenfab.case import Case, CaseError, read_case
from wovenfab.cli.check import check_case
from wovenfab.interface import Execution, execute
from wovenfab.record.field_file import newest_checkpoint, write_checkpoint
from wovenfab.record.fields import read_fields
from wovenfab.record.results import CHECKPOINT, EARLIER_CHECKPOINT, NothingToResumeError

CONFIGS = Path(__file__).parents[2] / "configs"
COMM, ALONE = MPI.COMM_WORLD, MPI.COMM_SELF
#: Some cycles of a coarse sheet: 20 steps each.
SMALL = (
    *("output.pictures=false", "discretisation.mesh_size=150mm", "discretisation.degree=2"),
    *("program={type: cycles, amplitudes: [10 mm, 20 mm], max_velocity: 0.5 m/s}",),
    *("time.steps_per_cycle=20", "solver.factor=renewed"),
)
SPIN = "effects.spin_friction={strength: 30 N/m, slope: 40 s}"
CASES = {
    "slip and spin friction, adaptive": ("bias-1x3", SPIN, "time.tolerance=1e-2"),
    "midpoint": ("bias-1x3", "time.scheme=midpoint"),
    "backward Euler": ("bias-1x3", "time.scheme=backward-euler", "time.steps_per_cycle=20"),
    "stress at points": ("coulomb",),
    "stress at points of one end": (
        "coulomb",
        "effects.slip_friction.strength=2e5 N/m^3 * (x - 0.7 m + abs(x - 0.7 m))",
    ),
    "internal variables": ("../docs/examples/wear",),
    "force control": (
        *("bias-1x3", "discretisation.mesh_size=150mm"),
        "program={type: cycles, amplitudes: [50 N, 100 N], frequency: 10 Hz}",
    ),
    "two programs": (
        *("biaxial", "discretisation.mesh_size=100 mm", "time.tolerance=1e-2"),
        "boundary.top={displacement: [0, second_program]}",
        "program={type: ramp, to: 1 mm, velocity: 20 mm/s, steps: 5}",
        "second_program=[{type: cycles, amplitudes: 2 mm, frequency: 15 Hz}]",
    ),
    "probes": (
        "bias-1x3",
        "output.probes={a: {type: point, at: [0.2, 0.1]}, c: {type: zone, centre: [0.45, 0.15], "
        "radius: 0.1}, b: {type: line, ends: [[0, 0], [0.9, 0.3]]}}",
    ),
    "kept factor": (
        *("bias-1x3", "discretisation.mesh_size=30mm", "discretisation.degree=3"),
        *("program.amplitudes=10 mm", "time.steps_per_cycle=12", "solver.factor=kept"),
    ),
    "a branch": (
        *("compression", "discretisation.mesh_size=75mm", "discretisation.degree=2"),
        *("program={type: ramp, to: -30 mm, steps: 24, duration: 1 s}",),
    ),
}
#: In the middle of the first cycle, not on a planned time of adaptive steps.
PAUSE = {"a branch": 0.55, "kept factor": 0.021}


def small(name: str, *overrides: str) -> Case:
    return read_case(CONFIGS / f"{name}.yaml", (*SMALL, *overrides))


def run(case: Case, directory: Path, comm: MPI.Comm = ALONE, **options: object) -> Execution:
    return execute(case, directory, comm=comm, **options)  # type: ignore[arg-type]


def assert_same(one: Execution, other: Execution, tolerance: float) -> None:
    """Compare all columns, over the largest value of each kind of them."""
    force = np.abs(other.columns["force_N"]).max()
    work = np.abs(other.columns["work_J"]).max()
    assert list(one.columns) == list(other.columns)
    for name, values in other.columns.items():
        if name == "newton_iterations" and tolerance:
            continue
        scale = {"N": force, "J": work}.get(name.rsplit("_", 1)[-1], np.abs(values).max())
        assert np.abs(one.columns[name] - values).max() <= tolerance * scale, name


#: Those that `make test` runs; `make test-all` runs all of them.
QUICK = ("internal variables",)


@pytest.mark.parametrize(
    "name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in CASES]
)
def test_the_rows_are_those_of_a_run_that_never_stopped(name: str, tmp_path: Path) -> None:
    case = small(*CASES[name])
    whole = run(case, tmp_path / "whole")
    until = PAUSE.get(name, 0.041)
    part = run(case, tmp_path / "parts", until=until)
    assert part.outcome.paused and until <= part.columns["time_s"][-1] < until + 0.05
    resumed = run(case, tmp_path / "parts", resume=True)
    if name == "kept factor":
        assert_same(resumed, whole, 1e-8)
        return
    assert_same(resumed, whole, 0.0)
    for file in ("history.csv", "reactions.csv", "cycles.csv", "lines.csv", "fields.xdmf"):
        if (tmp_path / "whole" / file).exists():
            texts = [(tmp_path / d / file).read_text().split("\n") for d in ("whole", "parts")]
            assert sorted(texts[0]) == sorted(texts[1]), file
    fields = [read_fields(tmp_path / d) for d in ("whole", "parts")]
    assert list(fields[0].times) == list(fields[1].times)
    for one, other in zip(fields[0].units, fields[1].units, strict=True):
        assert (fields[0].field(one, -1) == fields[1].field(other, -1)).all()
    parts = resumed.summary["parts"]
    assert [p["first_step"] for p in parts] == [0, part.outcome.steps]
    total = sum(p["wall_time_s"]["steps"] for p in parts)
    assert resumed.summary["wall_time_s"]["steps"] == pytest.approx(total)


def on_some_ranks(ranks: int, case: Case, directory: Path, **options: object) -> Execution | None:
    """Run on the first ranks; the others sleep, so that they leave the cores alone."""
    part = COMM.Split(int(COMM.rank < ranks))
    done = run(case, directory, part, **options) if COMM.rank < ranks else None
    others = COMM.Ibarrier()
    while not others.Test():
        time.sleep(0.01)
    part.Free()
    return done


@pytest.mark.mpi
@pytest.mark.mpi4
@pytest.mark.parametrize(
    ("name", "pairs"),
    [
        ("stress at points of one end", [(2, 1)]),
        pytest.param("internal variables", [(1, 2)], marks=pytest.mark.slow),
        *(
            pytest.param(name, list(product(range(1, 5), repeat=2)), marks=pytest.mark.slow)
            for name in ("slip and spin friction, adaptive", "stress at points")
        ),
    ],
)
def test_any_number_of_ranks_goes_on_for_any_other(
    name: str, pairs: list[tuple[int, int]], shared_path: Path
) -> None:
    """Three ranks own nodes that are in none of their cells; those came back as zeros once."""
    case = small(*CASES[name])
    whole = on_some_ranks(1, case, shared_path / "whole")
    for first, second in (pair for pair in pairs if max(pair) <= COMM.size):
        place = shared_path / f"{first}-{second}"
        on_some_ranks(first, case, place, until=0.041)
        resumed = on_some_ranks(second, case, place, resume=True)
        if whole is not None:
            assert resumed is not None
            assert_same(resumed, whole, 1e-8)


def test_a_finished_run_goes_on_with_a_longer_program(tmp_path: Path) -> None:
    case = small("bias-1x3")
    longer = case.changed(
        "program=[{type: cycles, amplitudes: [10 mm, 20 mm], max_velocity: 0.5 m/s}, "
        "{type: cycles, amplitudes: 15 mm, max_velocity: 0.2 m/s}]"
    )
    whole = run(longer, tmp_path / "whole")
    run(case, tmp_path / "parts")
    assert_same(run(longer, tmp_path / "parts", resume=True), whole, 0.0)


@pytest.mark.slow
def test_a_finished_run_goes_on_with_a_longer_second_program(tmp_path: Path) -> None:
    name, *overrides = CASES["two programs"]
    case = small(name, *overrides)
    longer, other = (
        case.changed(f"second_program=[{{type: cycles, amplitudes: {a} mm, frequency: 15 Hz}}, "
                     "{type: ramp, to: 1 mm, velocity: 20 mm/s, steps: 3}]")
        for a in (2, 3)
    )  # fmt: skip
    whole = run(longer, tmp_path / "whole")
    run(case, tmp_path / "parts")
    with pytest.raises(NothingToResumeError, match="program before t = "):
        run(other, tmp_path / "parts", resume=True)
    assert_same(run(longer, tmp_path / "parts", resume=True), whole, 0.0)


@pytest.mark.parametrize(
    ("override", "differs"),
    [
        ("effects.shear.stiffness=401 N/m", "effects differs"),
        pytest.param("sheet.length=0.8 m", "sheet differs", marks=pytest.mark.slow),
        pytest.param(
            "discretisation.mesh_size=60 mm", "discretisation differs", marks=pytest.mark.slow
        ),
        pytest.param("boundary.left=clamp_x", "boundary differs", marks=pytest.mark.slow),
        ("program.amplitudes=[12 mm, 20 mm]", "program before t = "),
        ("output.probes={a: {type: point, at: [0, 0]}}", "other columns than this run would"),
    ],
)
def test_another_case_is_refused_in_words(
    override: str, differs: str, paused: Path, tmp_path: Path
) -> None:
    case = small("bias-1x3", "output.checkpoint=2")
    shutil.copytree(paused, tmp_path / "run")
    before = {p: p.read_bytes() for p in (tmp_path / "run").rglob("*.*") if p.is_file()}
    other = override.replace("clamp_x", "{displacement: [0, free]}")
    with pytest.raises(NothingToResumeError, match=differs):
        run(case.changed(other), tmp_path / "run", resume=True)
    assert before == {p: p.read_bytes() for p in before}


@pytest.mark.slow
def test_steps_solver_and_output_may_differ(tmp_path: Path) -> None:
    case = small("bias-1x3")
    run(case, tmp_path / "run", until=0.041)
    other = case.changed("time.steps_per_cycle=40", "solver.tolerance=1e-10", "output.every=3")
    resumed = run(other, tmp_path / "run", resume=True)
    assert resumed.outcome.failure is None
    assert resumed.columns["time_s"][-1] == pytest.approx(0.06 * np.pi)


def test_nothing_to_go_on_from_is_told(tmp_path: Path) -> None:
    case = small("bias-1x3", "output.checkpoint=false")
    with pytest.raises(NothingToResumeError, match="does not exist"):
        run(case, tmp_path / "none", resume=True)
    run(case, tmp_path / "run", until=0.02)
    with pytest.raises(NothingToResumeError, match="holds no checkpoint"):
        run(case, tmp_path / "run", resume=True)
    run(case.changed("output.checkpoint=5"), tmp_path / "old", until=0.02)
    with h5py.File(tmp_path / "old" / CHECKPOINT, "r+") as file:
        file.attrs["version"] = 0
    with pytest.raises(NothingToResumeError, match="another version of wovenfab"):
        run(case, tmp_path / "old", resume=True)


@pytest.mark.slow
def test_a_run_for_an_accuracy_goes_on_with_what_was_chosen_for_it(tmp_path: Path) -> None:
    """The trials are not made again, and the errors are those of the choice."""
    ramp = "{type: ramp, to: 20 mm, steps: 4, duration: 1 s}"
    case = read_case(
        CONFIGS / "bonded-1x3.yaml",
        (
            "accuracy=5 %",
            "discretisation=null",
            f"program={ramp}",
            "output.pictures=false",
            "solver.factor=renewed",
        ),
    )
    whole = run(case, tmp_path / "whole")
    run(case, tmp_path / "parts", until=0.3)
    resumed = run(case, tmp_path / "parts", resume=True)
    assert_same(resumed, whole, 0.0)
    assert "pilot" not in resumed.summary["parts"][1]["wall_time_s"]
    assert resumed.summary["accuracy"] == whole.summary["accuracy"]
    for file in ("error.csv", "error.xdmf"):
        texts = [(tmp_path / d / file).read_text() for d in ("whole", "parts")]
        assert texts[0] == texts[1]
    with pytest.raises(NothingToResumeError, match=r"an accuracy of 0\.05, not 0\.1"):
        run(case.changed("accuracy=10 %"), tmp_path / "parts", resume=True)


def test_a_case_starts_from_the_state_of_another_run(tmp_path: Path) -> None:
    """Pre-tension, then cycles about it: an elastic sheet cannot tell that from one program."""
    coarse = (
        "output.pictures=false",
        "discretisation={degree: 2, mesh_size: 75mm}",
        "solver.factor=renewed",
    )
    first, then = "{type: ramp, to: 8 mm, steps: 4}", "{type: ramp, to: -3 mm, steps: 3}"
    case = read_case(CONFIGS / "elastic-1x3.yaml", (*coarse, f"program={first}"))
    run(case, tmp_path / "tension")
    turn = "{type: ramp, to: 5 mm, steps: 3}"
    whole = run(case.changed(f"program=[{first}, {turn}]"), tmp_path / "whole").columns
    origin = {"from_state": str(tmp_path / "tension")}
    part = case.changed(f"program={then}", origin)
    after = run(part, tmp_path / "after").columns
    scale = np.abs(whole["force_N"]).max()
    assert np.abs(after["force_N"] - whole["force_N"][4:]).max() < 1e-6 * scale
    assert np.abs(after["energy_J"] - whole["energy_J"][4:]).max() < 1e-6 * scale * 8e-3
    assert after["work_J"][0] == 0 and after["displacement_m"][-1] == pytest.approx(-3e-3)
    assert np.abs(after["imbalance_J"]).max() < 1e-3 * np.abs(after["work_J"]).max()
    run(part, tmp_path / "parts", until=0.4)
    assert_same(run(part, tmp_path / "parts", resume=True), run(part, tmp_path / "again"), 0.0)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("from_state=nowhere", "there is no folder 'nowhere'"),
        ("from_state=.", "holds no checkpoint"),
        ("discretisation.degree=3", "has another sheet: discretisation differ"),
        ("accuracy=1 %", "from_state: brings its own elements"),
    ],
)
def test_a_state_that_cannot_be_used_is_refused_before_and_by_a_run(
    override: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    case = small("elastic-1x3", "program={type: ramp, to: 8 mm, steps: 4}")
    run(case, tmp_path / "tension")
    changes = {"from_state": str(tmp_path / "tension")}, override
    with pytest.raises(CaseError, match=message):
        run(case.changed(*changes), tmp_path / "run")
    assert not (tmp_path / "run").exists()
    Path("case.yaml").write_text(case.to_yaml())
    with pytest.raises(CaseError, match=message):
        check_case(Path("case.yaml"), [f"from_state={tmp_path / 'tension'}", override])


CRAFTED: list[Callable[[Any], Any]] = [
    lambda kept: replace(kept, arrays={"program": kept.arrays["program"]}),
    lambda kept: replace(kept, arrays={n: a[:-1] for n, a in kept.arrays.items()} | _program(kept)),
    lambda kept: replace(kept, arrays={n: a.ravel() for n, a in kept.arrays.items()}),
    lambda kept: replace(kept, arrays={n: np.float64(1) for n in kept.arrays} | _program(kept)),
    *(
        lambda kept, name=name, value=value: replace(kept, values=kept.values | {name: value})
        for name in ("case", "stepper", "edges")
        for value in (None, [], {}, "x", {"state": {"states": [1.0]}})
    ),
    lambda kept: replace(kept, values={n: v for n, v in kept.values.items() if n != "edges"}),
]


def _program(kept: Any) -> dict[str, Any]:
    return {"program": kept.arrays["program"]}


@pytest.fixture(scope="module")
def tension(tmp_path_factory: pytest.TempPathFactory) -> tuple[Case, Path]:
    case = small("elastic-1x3", "program={type: ramp, to: 8 mm, steps: 4, duration: 1 s}")
    folder = tmp_path_factory.mktemp("tension") / "run"
    run(case, folder, until=0.5)
    return case, folder


@pytest.mark.parametrize("craft", CRAFTED)
def test_a_checkpoint_that_another_program_wrote_is_refused_in_words(
    craft: Callable[[Any], Any], tension: tuple[Case, Path], tmp_path: Path
) -> None:
    case, origin = tension
    folder = tmp_path / "run"
    shutil.copytree(origin, folder)
    crafted = craft(newest_checkpoint(origin))
    for name in (CHECKPOINT, EARLIER_CHECKPOINT):
        (folder / name).unlink(missing_ok=True)
    write_checkpoint(folder, crafted)
    with pytest.raises(CaseError, match=r"from_state: .*(checkpoint|has another sheet)"):
        run(case.changed({"from_state": str(folder)}), tmp_path / "other")
    with pytest.raises(NothingToResumeError, match=r"checkpoint|cannot go on"):
        run(case, folder, resume=True)


PLATE = """
DefineConstant[ w = 0.1 ];
Include "size.geo";
Point(1) = {0, 0, 0}; Point(2) = {l, 0, 0}; Point(3) = {l, w, 0}; Point(4) = {0, w, 0};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Curve Loop(1) = {1:4}; Plane Surface(1) = {1};
Physical Surface("sheet") = {1}; Physical Curve("left") = {4}; Physical Curve("right") = {2};
"""


def plate(folder: Path, *overrides: str) -> Case:
    """Return a case of a rectangle whose length is in a file that its geometry includes."""
    if not (folder / "plate.geo").exists():
        (folder / "plate.geo").write_text(PLATE)
        (folder / "size.geo").write_text("l = 0.3;\n")
    return read_case(
        CONFIGS / "elastic-1x3.yaml",
        ("sheet=null", f"sheet={{file: {folder}/plate.geo, fibres: [45 deg, -45 deg]}}",
         "discretisation={degree: 2, mesh_size: 50 mm}", "output.pictures=false",
         "program={type: ramp, to: 8 mm, steps: 4, duration: 1 s}", *overrides),
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("mesh", "length"), [("fibres", 0.4), ("unstructured", 0.300001)])
def test_another_mesh_by_an_included_file_is_refused(
    mesh: str, length: float, tmp_path: Path
) -> None:
    """Also one with as many cells."""
    case = plate(tmp_path, f"discretisation.mesh={mesh}")
    run(case, tmp_path / "run", until=0.3)
    text = (tmp_path / "plate.geo").read_text()
    (tmp_path / "plate.geo").write_text(f"// the same sheet\n{text}")
    before = {p: p.read_bytes() for p in (tmp_path / "run").rglob("*.*") if p.is_file()}
    (tmp_path / "size.geo").write_text(f"l = {length};\n")
    with pytest.raises(NothingToResumeError, match="now gives another mesh"):
        run(plate(tmp_path, f"discretisation.mesh={mesh}"), tmp_path / "run", resume=True)
    assert before == {p: p.read_bytes() for p in before}
    start = {"from_state": str(tmp_path / "run")}
    with pytest.raises(CaseError, match=r"from_state: .* has another sheet"):
        run(plate(tmp_path, f"discretisation.mesh={mesh}").changed(start), tmp_path / "other")
    (tmp_path / "size.geo").write_text("l = 0.3;\n")
    assert run(plate(tmp_path, f"discretisation.mesh={mesh}"), tmp_path / "run", resume=True)


def test_the_same_mesh_with_other_edges_is_refused(tmp_path: Path) -> None:
    case = plate(tmp_path, "discretisation.mesh=unstructured")
    run(case, tmp_path / "run", until=0.3)
    text = (tmp_path / "plate.geo").read_text()
    (tmp_path / "plate.geo").write_text(text.replace('("left") = {4}', '("left") = {4, 3}'))
    with pytest.raises(NothingToResumeError, match="now gives another mesh"):
        run(case, tmp_path / "run", resume=True)


@pytest.mark.mpi
def test_a_mesh_is_known_again_on_other_ranks(tmp_path: Path) -> None:
    place = COMM.bcast(tmp_path)
    if COMM.rank == 0:
        plate(place)
    COMM.barrier()
    run(plate(place), place / "run", COMM, until=0.3)
    if COMM.rank == 0:
        assert run(plate(place), place / "run", ALONE, resume=True).outcome.failure is None
        (place / "size.geo").write_text("l = 0.3001;\n")
    COMM.barrier()
    with pytest.raises(NothingToResumeError, match="now gives another mesh"):
        run(plate(place), place / "run", COMM, resume=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("before", "after"),
    [("bdf2", "backward-euler"), ("backward-euler", "bdf2"), ("midpoint", "bdf2")],
)
def test_a_run_goes_on_with_another_time_scheme_though_a_factor_was_kept(
    before: str, after: str, tmp_path: Path
) -> None:
    case = small("bias-1x3", f"time.scheme={before}", "output.every=100", "solver.factor=kept")
    run(case, tmp_path / "run", until=0.041)
    gone = run(case.changed(f"time.scheme={after}"), tmp_path / "run", resume=True)
    whole = run(case.changed(f"time.scheme={after}"), tmp_path / "whole")
    assert gone.outcome.failure is None
    force = np.abs(whole.columns["force_N"]).max()
    assert abs(gone.columns["force_N"][-1] - whole.columns["force_N"][-1]) < 0.05 * force


@pytest.fixture(scope="module")
def paused(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("paused") / "run"
    run(small("bias-1x3", "output.checkpoint=2"), directory, until=0.041)
    return directory


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _of_other_times(path: Path) -> None:
    head, *rows = path.read_text().splitlines()
    cells = [row.split(",") for row in rows]
    moved = [",".join([c[0], repr(2 * float(c[1])), *c[2:]]) for c in cells]
    path.write_text("\n".join([head, *moved, ""]))


def _contents(directory: Path) -> dict[str, bytes]:
    return {str(p): p.read_bytes() for p in sorted(directory.rglob("*")) if p.is_file()}


@pytest.mark.parametrize(
    ("name", "damage"),
    [
        ("history.csv", _cut),
        ("history.csv", _of_other_times),
        ("history.csv", Path.unlink),
        ("reactions.csv", _cut),
        ("reactions.csv", lambda path: path.write_bytes(b"\xff\xfe")),
        ("fields/000000.h5", _cut),
    ],
)
def test_a_run_that_cannot_go_on_is_refused_with_the_file_and_nothing_is_changed(
    name: str, damage: Callable[[Path], object], paused: Path, tmp_path: Path
) -> None:
    directory = shutil.copytree(paused, tmp_path / "run")
    damage(directory / name)
    before = _contents(directory)
    case = small("bias-1x3", "output.checkpoint=2")
    with pytest.raises(NothingToResumeError, match=Path(name).name):
        run(case, directory, resume=True)
    assert _contents(directory) == before


def test_rows_after_the_checkpoint_may_be_damaged(paused: Path, tmp_path: Path) -> None:
    directory = shutil.copytree(paused, tmp_path / "run")
    with (directory / "history.csv").open("ab") as file:
        file.write(b"\x00" * 64 + b"\n\xff")
    case = small("bias-1x3", "output.checkpoint=2")
    assert run(case, directory, resume=True).outcome.failure is None
