"""Clouds of cameras: other coordinates, moved positions, and names of columns of programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.report import sample
from wovenfab.case import CaseError
from wovenfab.cli.report import export_results
from wovenfab.measured.cloud import MeasuredCloud, read_cloud
from wovenfab.measured.layout import Layout
from wovenfab.record.fields import StoredFields, read_fields
from wovenfab.report.alignment import AlignmentError, Rigid, placed

Array = NDArray[np.float64]
#: Of the run from formulas: a stored time with 60 mm, size of its sheet (m).
INDEX, SIZE = 10, (0.9, 0.3)


def measured(
    stored: StoredFields, count: int, seed: int, low: float = 0.02, high: float = 0.98
) -> MeasuredCloud:
    """Return an exact cloud at rest, of a part of the length."""
    rng = np.random.default_rng(seed)
    points = rng.uniform((low, 0.02), (high, 0.98), (count, 2)) * SIZE
    at = stored.at(points)
    return MeasuredCloud(points, (at("displacement_1", INDEX) + at("displacement_2", INDEX)) / 2)


def seen(cloud: MeasuredCloud, angle: float, origin: tuple[float, float]) -> MeasuredCloud:
    """Return a cloud in the coordinates of a camera that is turned, with another origin."""
    rotation = Rigid(angle).rotation
    return MeasuredCloud((cloud.points - origin) @ rotation, cloud.displacements @ rotation)


@pytest.mark.parametrize(
    ("angle", "low", "high"),
    [
        (2.4, 0.3, 0.9),
        pytest.param(0.03, 0.02, 0.98, marks=pytest.mark.slow),
        pytest.param(-1.7, 0.1, 0.6, marks=pytest.mark.slow),
    ],
)
def test_a_turned_and_moved_camera_is_found_within_its_standard_errors(
    two: Path, angle: float, low: float, high: float
) -> None:
    stored = read_fields(two)
    exact = measured(stored, 400, 3, low, high)
    camera = seen(exact, angle, (0.31, -0.12))
    noise = 5e-5 * np.random.default_rng(4).standard_normal(exact.points.shape)
    noisy = MeasuredCloud(camera.points, camera.displacements + noise)
    on = placed(stored, INDEX, noisy, align=True, positions="rest")
    off = np.linalg.norm(on.cloud.points - exact.points, axis=1)
    assert off.max() < 1e-3
    assert "turned by" in on.notes[-1]
    found = on.cloud.displacements - exact.displacements
    assert np.sqrt((found**2).sum(axis=1).mean()) < 2e-4  # noise of 0.07 mm, and of the angle


def test_a_cloud_without_noise_comes_back_to_its_place(two: Path) -> None:
    stored = read_fields(two)
    exact = measured(stored, 150, 5)
    on = placed(stored, INDEX, seen(exact, 0.8, (0.1, 0.2)), align=True, positions="rest")
    assert np.abs(on.cloud.points - exact.points).max() < 1e-6
    assert np.abs(on.cloud.displacements - exact.displacements).max() < 1e-6


def test_moved_positions_are_told_from_those_at_rest(two: Path) -> None:
    stored = read_fields(two)
    exact = measured(stored, 400, 6)
    assert placed(stored, INDEX, exact).notes == ()
    moved = MeasuredCloud(exact.points + exact.displacements, exact.displacements)
    on = placed(stored, INDEX, moved)
    assert "moved back" in on.notes[0]
    np.testing.assert_allclose(on.cloud.points, exact.points, atol=1e-15)


@pytest.mark.slow
def test_moved_positions_of_a_turned_camera_are_found(two: Path) -> None:
    stored = read_fields(two)
    exact = measured(stored, 200, 7)
    moved = MeasuredCloud(exact.points + exact.displacements, exact.displacements)
    on = placed(stored, INDEX, seen(moved, 1.1, (0.4, 0.1)), align=True)
    assert np.abs(on.cloud.points - exact.points).max() < 1e-6


def test_what_the_edges_do_not_tell_is_said_and_may_be_chosen(two: Path) -> None:
    stored = read_fields(two)
    rng = np.random.default_rng(8)
    points = rng.uniform((0.3, 0.1), (0.6, 0.2), (80, 2))  # far from the edges
    at = stored.at(points)
    u = (at("displacement_1", INDEX) + at("displacement_2", INDEX)) / 2
    moved = MeasuredCloud(points + u, u)
    exact = placed(stored, INDEX, moved)
    assert "moved back" in exact.notes[0]  # by the distances, which are far less so
    np.testing.assert_allclose(exact.cloud.points, points, atol=1e-15)
    off = np.linalg.norm(placed(stored, INDEX, moved, positions="rest").cloud.points - points)
    assert off > 0.01
    at = stored.at(moved.points)
    wrong = (at("displacement_1", INDEX) + at("displacement_2", INDEX)) / 2 - u
    moved = MeasuredCloud(points + u, u + 0.4 * wrong)  # a model with an error of that size
    auto = placed(stored, INDEX, moved)
    assert "do not tell" in auto.notes[0] and "--positions moved" in auto.notes[0]
    np.testing.assert_array_equal(auto.cloud.points, moved.points)
    chosen = placed(stored, INDEX, moved, positions="moved")
    np.testing.assert_allclose(chosen.cloud.points, points - 0.4 * wrong, atol=1e-15)


def test_a_uniform_displacement_does_not_tell_the_camera(two: Path) -> None:
    stored = read_fields(two)
    points = np.random.default_rng(9).uniform((0.4, 0.1), (0.5, 0.2), (60, 2))
    with pytest.raises(AlignmentError, match="cannot be found"):
        placed(stored, 0, MeasuredCloud(points, 0 * points), align=True, positions="rest")


@pytest.mark.slow
def test_a_cloud_of_the_back_is_recognised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = sample.placement
    monkeypatch.setattr(  # a sheet that moves more at one of its sides
        sample, "placement", lambda points, turn: plain(points, turn) + turn * points[:, 1:] ** 2
    )
    stored = read_fields(sample.make(tmp_path / "run", [0.06], placements=1, every=40))
    points = np.random.default_rng(10).uniform((0.02, 0.02), (0.88, 0.28), (150, 2))
    u = stored.at(points)("displacement", 1)
    front = MeasuredCloud(points, u)
    back = MeasuredCloud(points * [1, -1], u * [1, -1])
    for cloud, count in ((front, 0), (back, 1)):
        notes = placed(stored, 1, cloud, align=True, positions="rest").notes
        assert sum("y=-1 mm" in note for note in notes) == count


def write(path: Path, header: str, rows: Array, separator: str = ",") -> Path:
    lines = [separator.join(f"{v:.12g}" for v in row) for row in rows]
    path.write_text("\n".join([header, *lines]) + "\n")
    return path


HEADERS = {
    "dice": (
        "***\n*** Digital Image Correlation Engine (DICe)\n*** Step size: x 10 y 10\n***\n"
        "SUBSET_ID,COORDINATE_X,COORDINATE_Y,DISPLACEMENT_X,DISPLACEMENT_Y,SIGMA,GAMMA",
        lambda p, u, k: [k, *p, *u, 1e-2, 1e-3],
        ",",
    ),
    "dice of two cameras": (
        "SUBSET_ID,COORDINATE_X,COORDINATE_Y,DISPLACEMENT_X,DISPLACEMENT_Y,MODEL_COORDINATES_X,"
        "MODEL_COORDINATES_Y,MODEL_DISPLACEMENT_X,MODEL_DISPLACEMENT_Y,SIGMA",
        lambda p, u, k: [k, 7, 8, 9, 10, *p, *u, 1e-2],
        ",",
    ),
    "aramis": (
        "# Process data:\n# specimen : A\n#####\n#        ID;   x_undef [mm];   y_undef [mm];"
        "   z_undef [mm];   u [mm];   v [mm];   w [mm];   epsx [%]",
        lambda p, u, k: [k, *p, 0.1, *u, 0.2, 0.3],
        ";",
    ),
    "vic-3d": (
        '"X [mm]","Y [mm]","Z [mm]","U [mm]","V [mm]","W [mm]","x [pixel]","y [pixel]",'
        '"u [pixel]","v [pixel]","sigma [pixel]"',
        lambda p, u, k: [*p, 900, *u, 0.1, 5, 6, 7, 8, 1e-2],
        ",",
    ),
    "vic-3d without units": (
        '"X","Y","Z","U","V","W","x","y","u","v","sigma"',
        lambda p, u, k: [*p, 900, *u, 0.1, 5, 6, 7, 8, 1e-2],
        ",",
    ),
    "vic-2d": ("x,y,u,v,exx,sigma", lambda p, u, k: [*p, *u, 0.1, 1e-2], ","),
}  # fmt: skip


@pytest.mark.parametrize("program", HEADERS)
def test_tables_of_programs_are_read_and_lost_points_left_out(program: str, tmp_path: Path) -> None:
    header, row, separator = HEADERS[program]
    points = np.array([[10.0, 20.0], [30.0, 40.0], [50.0, 65.0]])
    moved = np.array([[0.1, 0.2], [0.3, 0.4], [0.5, 0.7]])
    rows = np.array([row(p, u, k) for k, (p, u) in enumerate(zip(points, moved, strict=True))])
    if "sigma" in header.casefold():
        lost = rows[:1].copy()
        lost[
            0,
            [
                t.casefold().startswith(("sigma", '"sigma'))
                for t in header.splitlines()[-1].split(separator)
            ],
        ] = -1
        rows = np.vstack([rows, lost])
    path = write(tmp_path / "dic.csv", header, rows, separator)
    layout = Layout() if "[mm]" in header else Layout(units={"x": "mm"})
    found = read_cloud(path, layout)
    np.testing.assert_allclose(found.points, 1e-3 * points)
    np.testing.assert_allclose(found.displacements, 1e-3 * moved)
    assert found.lost == len(rows) - 3


@pytest.mark.parametrize(
    "header", ["SUBSET_ID,COORDINATE_X,COORDINATE_Y,DISPLACEMENT_X,DISPLACEMENT_Y",
               "k,x [pixel],y [pixel],u [pixel],v [pixel]", "k,x (px),y (px),u (px),v (px)"],
)  # fmt: skip
def test_pixels_need_their_length_and_rows_may_count_downwards(header: str, tmp_path: Path) -> None:
    path = write(tmp_path / "dic.csv", header, np.array([[0, 100.0, 200, 2, 4], [1, 3, 4, 5, 6]]))
    with pytest.raises(CaseError, match=r"pixels.*--units x=0\.05mm"):
        read_cloud(path)
    found = read_cloud(path, Layout(units={"x": "0.05mm", "y": "-0.05 mm"}))
    np.testing.assert_allclose(found.points[0], [5e-3, -10e-3])
    np.testing.assert_allclose(found.displacements[0], [1e-4, 2e-4])


def test_the_command_aligns_a_cloud_and_says_how(
    two: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stored = read_fields(two)
    exact = measured(stored, 200, 11)
    camera = seen(exact, np.radians(30.0), (0.2, 0.1))
    rows = 1e3 * np.column_stack([camera.points, camera.displacements])
    path = write(tmp_path / "dic.csv", "x (mm),y (mm),u (mm),v (mm)", rows)
    assert export_results(two, tmp_path / "out", cloud=path) == 2
    assert "--align" in capsys.readouterr().err
    options = {"cloud": path, "align": True, "positions": "rest"}
    assert export_results(two, tmp_path / "out", **options) == 0
    assert "turned by 30.000" in capsys.readouterr().out
    table = np.genfromtxt(tmp_path / "out" / "step-000200-distance.csv", delimiter=",", names=True)
    assert len(table) == 200 and table["distance_m"].max() < 1e-6
    assert export_results(two, tmp_path / "out", align=True) == 2
    assert export_results(two, tmp_path / "out", cloud=path, positions="x") == 2
