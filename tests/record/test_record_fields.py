import resource
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np
import pytest
from mpi4py import MPI

from tests.record.light_reader import BrokenFileError, read
from tests.report.sample import on_lattices
from wovenfab.record.fields import FieldSeries, read_fields
from wovenfab.sheet.output_nodes import OutputNodes

UNITS = {"displacement_1": "m", "beta": "m", "shear_angle": "rad"}
LATTICE = OutputNodes(3)
CELLS = 7


def corners(cells: np.ndarray) -> np.ndarray:
    """A strip of triangles, corners of shape (cells, 3, 2)."""
    return np.array([[[c, c % 2], [c + 2, c % 2], [c + 1, 1 - c % 2]] for c in cells]).reshape(
        -1, 3, 2
    ) * np.array([0.1, 0.3])


def points(cells: np.ndarray) -> np.ndarray:
    return on_lattices(LATTICE, corners(cells))


def data(cells: np.ndarray, time: float) -> dict[str, np.ndarray]:
    x = points(cells)
    jump = np.repeat(cells, len(LATTICE.points))
    return {
        "displacement_1": time * x + jump[:, None],
        "beta": np.hypot(*x.T) * time,
        "shear_angle": np.sin(x[:, 0]) + jump,
    }


def write(directory: Path, comm: MPI.Comm, cells: np.ndarray, times: list[float]) -> FieldSeries:
    series = FieldSeries(directory, comm, LATTICE, points(cells), cells, UNITS)
    for step, time in enumerate(times):
        series.write(step, time, data(cells, time))
    return series


def serial(directory: Path, times: list[float] = [0.0, 0.5]) -> FieldSeries:  # noqa: B006
    return write(directory, MPI.COMM_SELF, np.arange(CELLS), times)


def test_fields_come_back_to_the_last_bit(tmp_path: Path) -> None:
    serial(tmp_path)
    stored, cells = read_fields(tmp_path), np.arange(CELLS)
    assert stored.times.tolist() == [0.0, 0.5]
    assert stored.steps.tolist() == [0, 1]
    assert stored.units == UNITS
    np.testing.assert_array_equal(stored.points(), points(cells))
    np.testing.assert_array_equal(stored.triangles(), LATTICE.connectivity(CELLS))
    for name, values in data(cells, 0.5).items():
        np.testing.assert_array_equal(stored.field(name, 1), values)
    with h5py.File(tmp_path / "fields.h5") as file:
        assert {n: d.attrs["unit"] for n, d in file["steps/000001"].items()} == UNITS


def test_each_time_names_mesh_and_all_fields_itself(tmp_path: Path) -> None:
    serial(tmp_path)
    frames = read(tmp_path / "fields.xdmf")
    assert [float(frame["time"]) for frame in frames] == [0.0, 0.5]
    for frame in frames:
        assert set(frame) == {"time", "points", "triangles", *UNITS}
        expected = data(np.arange(CELLS), float(frame["time"]))
        np.testing.assert_array_equal(frame["points"][:, :2], points(np.arange(CELLS)))
        np.testing.assert_array_equal(frame["displacement_1"][:, :2], expected["displacement_1"])
        np.testing.assert_array_equal(frame["displacement_1"][:, 2], 0)
        np.testing.assert_array_equal(frame["beta"], expected["beta"])


BREAKS = {
    "a dataset is gone": lambda h5, xml: (h5.__delitem__("steps/000001/beta"), xml)[1],
    "other dimensions": lambda h5, xml: xml.replace('Dimensions="70"', 'Dimensions="71"'),
    "other precision": lambda h5, xml: xml.replace('Precision="8"', 'Precision="4"'),
    "no geometry": lambda h5, xml: xml.replace("Geometry", "Geography"),
    "not temporal": lambda h5, xml: xml.replace("Temporal", "Spatial"),
    "nan": lambda h5, xml: (h5["steps/000000/beta"].__setitem__(3, np.nan), xml)[1],
}


@pytest.mark.parametrize("name", BREAKS)
def test_the_reader_of_these_tests_sees_a_broken_file(tmp_path: Path, name: str) -> None:
    serial(tmp_path)
    path = tmp_path / "fields.xdmf"
    with h5py.File(tmp_path / "fields.h5", "r+") as file:
        path.write_text(BREAKS[name](file, path.read_text()))
    with pytest.raises(BrokenFileError):
        read(path)


def test_a_run_that_is_killed_leaves_all_written_times(tmp_path: Path) -> None:
    program = (
        "import os, sys; from pathlib import Path; sys.path.insert(0, sys.argv[1])\n"
        "from tests.record.test_record_fields import serial\n"
        "series = serial(Path(sys.argv[2]), [0.0, 1.0, 2.0]); os.kill(os.getpid(), 9)"
    )
    project = str(Path(__file__).parents[2])
    ended = subprocess.run([sys.executable, "-c", program, project, str(tmp_path)], check=False)
    assert ended.returncode == -9
    assert len(read(tmp_path / "fields.xdmf")) == 3
    assert read_fields(tmp_path).times.tolist() == [0.0, 1.0, 2.0]


def test_more_times_can_be_read_than_files_be_open(tmp_path: Path) -> None:
    serial(tmp_path, list(range(90)))
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (80, limits[1]))
    try:
        stored = read_fields(tmp_path)
        assert [stored.field("beta", i)[0] for i in (0, 89)] == [
            0.0,
            data(np.arange(1), 89)["beta"][0],
        ]
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    assert stored.times.tolist() == list(range(90))


def test_writing_goes_on_while_somebody_reads(tmp_path: Path) -> None:
    series = serial(tmp_path)
    program = "import h5py, sys; f = h5py.File(sys.argv[1]); print('open', flush=True); input()"
    path = str(tmp_path / "fields.h5")
    with subprocess.Popen(
        [sys.executable, "-c", program, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as reader:
        assert reader.stdout is not None
        assert reader.stdout.readline() == b"open\n"
        series.write(2, 1.0, data(np.arange(CELLS), 1.0))
        reader.communicate(b"\n")
    assert len(read(tmp_path / "fields.xdmf")) == 3


@pytest.mark.parametrize(
    ("change", "time", "message"),
    [
        (lambda d: d["beta"].__setitem__(5, np.nan), 1.0, "not finite"),
        (lambda d: d.pop("beta"), 1.0, "announced"),
        (lambda d: d.update(gamma=d["beta"]), 1.0, "announced"),
        (lambda d: d.update(beta=d["beta"][1:]), 1.0, "shape"),
        (lambda d: d.update(beta=d["displacement_1"]), 1.0, "shapes of the series"),
        (lambda d: None, 0.5, "comes after"),
    ],
)
def test_bad_data_are_refused_and_the_files_stay_good(
    tmp_path: Path, change, time: float, message: str
) -> None:
    series = serial(tmp_path)
    bad = data(np.arange(CELLS), time)
    change(bad)
    with pytest.raises(ValueError, match=message):
        series.write(2, time, bad)
    assert len(read(tmp_path / "fields.xdmf")) == 2
    series.write(2, 1.0, data(np.arange(CELLS), 1.0))
    assert len(read(tmp_path / "fields.xdmf")) == 3


@pytest.mark.parametrize(
    ("bad", "message"), [(points(np.arange(3)), "shape"), (np.full((20, 2), np.nan), "not finite")]
)
def test_points_that_are_not_those_of_the_cells_are_refused(
    tmp_path: Path, bad: np.ndarray, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        FieldSeries(tmp_path, MPI.COMM_SELF, LATTICE, bad, np.arange(2), UNITS)


def test_a_run_without_fields_says_so(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no fields"):
        read_fields(tmp_path)


def shuffled(rank: int, size: int) -> np.ndarray:
    """Cells of a rank: all ranks together have them all, in no order, in unequal shares."""
    order = np.random.default_rng(7).permutation(CELLS)
    bounds = [0, *np.linspace(2, CELLS, size).round().astype(int)] if size > 1 else [0, CELLS]
    return [order[a:b] for a, b in pairwise(bounds)][rank]


@pytest.mark.mpi
def test_the_files_do_not_depend_on_the_ranks(shared_path: Path) -> None:
    comm = MPI.COMM_WORLD
    write(shared_path, comm, shuffled(comm.rank, comm.size), [0.0, 0.5])
    comm.Barrier()
    alone = shared_path / f"alone{comm.rank}"
    alone.mkdir()
    serial(alone)
    for name in ("fields.h5", "fields.xdmf"):
        assert (shared_path / name).read_bytes() == (alone / name).read_bytes()


@pytest.mark.mpi
def test_a_rank_may_have_no_cells(shared_path: Path) -> None:
    comm = MPI.COMM_WORLD
    mine = np.arange(CELLS if comm.rank == comm.size - 1 else 0)
    write(shared_path, comm, mine, [0.0])
    comm.Barrier()
    assert len(read(shared_path / "fields.xdmf")) == 1
    np.testing.assert_array_equal(read_fields(shared_path).points(), points(np.arange(CELLS)))


@pytest.mark.mpi
def test_all_ranks_refuse_what_is_not_finite_on_one(shared_path: Path) -> None:
    comm = MPI.COMM_WORLD
    cells = shuffled(comm.rank, comm.size)
    series = write(shared_path, comm, cells, [0.0])
    bad = data(cells, 1.0)
    if comm.rank == comm.size - 1:
        bad["beta"][0] = np.inf
    with pytest.raises(ValueError, match="beta of step 1"):
        series.write(1, 1.0, bad)
    assert comm.allreduce(1) == comm.size


@pytest.mark.mpi
def test_all_ranks_refuse_a_cell_that_two_hold(shared_path: Path) -> None:
    comm = MPI.COMM_WORLD
    cells = np.array([0, comm.rank + 1]) if comm.size > 1 else np.array([0, 0])
    with pytest.raises(ValueError, match="owned cells only"):
        write(shared_path, comm, cells, [])
