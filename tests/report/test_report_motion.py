"""Yarns over time, one cycle in motion, and the script that shows a run in ParaView."""

import ast
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from PIL import Image

from tests.report.sample import FIBRES, LENGTH, WIDTH, make
from wovenfab.cli.report import report_results
from wovenfab.record.field_file import polylines
from wovenfab.record.fields import read_fields
from wovenfab.record.results import Provenance
from wovenfab.report.pictures import PIXELS, animate
from wovenfab.report.run_data import open_run_data
from wovenfab.report.style import house_style, read_provenance
from wovenfab.report.yarns import SCRIPT, write_viewer, write_yarns

ORIGIN = Provenance("wovenfab run a.yaml", "0123456789ab")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return two short cycles with six stored times in each."""
    return make(tmp_path_factory.mktemp("motion") / "run", [0.02, 0.04], every=14)


@pytest.fixture(scope="module")
def series(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a copy of the run with its yarns."""
    directory = tmp_path_factory.mktemp("yarns") / "run"
    shutil.copytree(run, directory)
    written = write_yarns(open_run_data(directory), read_fields(directory))
    assert [path.name for path in written] == ["yarns.xdmf", "yarns.h5"]
    return directory


def pieces(file: h5py.File) -> list[np.ndarray]:
    """Return the points of each polyline as XDMF has them: 2, size, points."""
    lines, at, found = file["mesh/lines"][()], 0, []
    while at < len(lines):
        assert lines[at] == 2
        found.append(lines[at + 2 : at + 2 + lines[at + 1]])
        at += 2 + lines[at + 1]
    return found


def test_yarns_keep_their_length_and_are_there_at_every_time(series: Path) -> None:
    """The made-up sheet is inextensible but for a slip of some tenths of a millimetre."""
    stored = read_fields(series)
    with h5py.File(series / "yarns.h5") as file:
        lines = pieces(file)
        assert sum(map(len, lines)) == len(file["mesh/points"])
        assert len(file["steps"]) == len(stored.times)
        rest = file["mesh/points"][()]
        for step in file["steps"].values():
            moved = step["points"][()]
            for line in lines:
                before, now = (
                    np.hypot(*np.diff(p[line, :2], axis=0).T).sum() for p in (rest, moved)
                )
                assert now == pytest.approx(before, abs=2e-3)
        np.testing.assert_allclose(file["steps/000000/points"][()], rest, atol=1e-6)
        peak = file["steps/000112/points"][()]
    assert peak[:, 0].max() > LENGTH + 0.03


def test_a_yarn_lies_along_its_family_from_edge_to_edge(series: Path) -> None:
    with h5py.File(series / "yarns.h5") as file:
        rest, lines = file["mesh/points"][:, :2], pieces(file)
        family = file["steps/000000/family"][()]
        numbers = file["steps/000000/yarn"][()]
    assert {1.0, 2.0} == set(family)
    for line in lines:
        own = int(family[line[0]])
        assert (family[line] == own).all()
        assert len(set(numbers[line])) == 1
        along = FIBRES[own - 1]
        across = rest[line] @ [-along[1], along[0]]
        np.testing.assert_allclose(across, across[0], atol=1e-12)
        assert (np.diff(rest[line] @ along) > 0).all()
        for end in rest[line[[0, -1]]]:
            borders = np.abs(np.concatenate([end, end - [LENGTH, WIDTH]]))
            assert borders.min() < 1e-12


def test_a_yarn_has_the_fields_of_its_own_family(series: Path) -> None:
    stored = read_fields(series)
    with h5py.File(series / "yarns.h5") as file:
        step = file["steps/000112"]
        assert set(step) == {
            "points", "family", "yarn", "beta", "curvature", "shear_angle", "stretch",
        }  # fmt: skip
        family = step["family"][()]
        for number in (1, 2):
            whole = stored.field(f"curvature_{number}", stored.steps.tolist().index(112))
            on_yarns = step["curvature"][family == number]
            assert 0.7 * whole.max() < on_yarns.max() <= whole.max()


def test_polylines_are_told_one_after_the_other() -> None:
    cells = polylines([3, 2])
    assert cells.connectivity.tolist() == [2, 3, 0, 1, 2, 2, 2, 3, 4]
    assert cells.count == 2


@pytest.mark.slow
def test_the_last_cycle_moves_at_the_pace_of_its_times(run: Path, tmp_path: Path) -> None:
    source, stored = open_run_data(run), read_fields(run)
    with house_style():
        path = animate(source, stored, tmp_path / "a.gif", ORIGIN)
    assert read_provenance(path) == ORIGIN
    times = stored.times[(stored.steps >= 80) & (stored.steps <= 160)]
    with Image.open(path) as picture:
        assert picture.width == PIXELS
        assert picture.n_frames == len(times) - 1
        lasting = []
        for frame in range(picture.n_frames):
            picture.seek(frame)
            lasting.append(picture.info["duration"])
        still = [np.asarray(picture.convert("RGB"))]
        picture.seek(len(times) // 2)
        still.append(np.asarray(picture.convert("RGB")))
    cycle = source.cycles[-1]
    np.testing.assert_allclose(lasting, 5e3 * np.diff(times) / (cycle.end - cycle.start), atol=10)
    assert (still[0] != still[1]).any()
    assert (still[0][2, 2] == 255).all()  # white paper stays white


def test_a_run_of_one_stored_time_is_a_still(tmp_path: Path) -> None:
    stopped = make(tmp_path / "run", [0.03], placements=1, every=40, stop=1)
    with house_style():
        path = animate(open_run_data(stopped), read_fields(stopped), tmp_path / "a.gif", ORIGIN)
    with Image.open(path) as picture:
        assert picture.n_frames == 1


def test_the_script_for_paraview_knows_where_the_results_are(tmp_path: Path) -> None:
    directory = tmp_path / 'it\'s a "run"'
    directory.mkdir()
    tree = ast.parse(write_viewer(directory).read_text())
    told = [
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "RESULTS"
    ]
    assert told == [str(directory)]


@pytest.mark.slow
def test_a_report_has_all_of_it(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert report_results([small], None, animation=True) == 0
    said = [Path(line).name for line in capsys.readouterr().out.splitlines()]
    assert said == [
        "loop.png", "loop.svg", "deformed.png", "report.html",
        "yarns.xdmf", "yarns.h5", SCRIPT, "animation.gif",
    ]  # fmt: skip


def test_what_cannot_be_animated_is_told(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (small / "fields.h5").unlink()
    assert report_results([small], None, animation=True) == 1
    assert "no animation: the run wrote no fields" in capsys.readouterr().err
    assert report_results([small, small], None, animation=True) == 2
    assert "name one directory" in capsys.readouterr().err
