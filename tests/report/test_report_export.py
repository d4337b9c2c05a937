"""Exported fields are the stored ones; distances from a cloud of points are those of its points."""

import sys
from pathlib import Path

import numpy as np
import pytest
import pyvista as pv

from wovenfab.case import CaseError
from wovenfab.cli.report import export_results
from wovenfab.lacking import LackingError
from wovenfab.measured.cloud import read_cloud
from wovenfab.measured.layout import Layout
from wovenfab.record.fields import StoredFields, read_fields
from wovenfab.report.export import chosen_times, compare
from wovenfab.report.run_data import open_run_data


def table(path: Path) -> np.ndarray:
    return np.genfromtxt(path, delimiter=",", names=True)


def cloud(path: Path, points: np.ndarray, moved: np.ndarray) -> Path:
    rows = 1e3 * np.column_stack([points, moved])
    np.savetxt(path, rows, fmt="%.17g", delimiter=",", header="x,y,u,v\nmm,mm,mm,mm", comments="")
    return path


def mean(stored: StoredFields, points: np.ndarray, index: int) -> np.ndarray:
    at = stored.at(points)
    return (at("displacement_1", index) + at("displacement_2", index)) / 2


def test_exported_fields_are_read_back_as_they_were_stored(two: Path, tmp_path: Path) -> None:
    assert export_results(two, tmp_path, at="60 mm", last=True) == 0
    stored = read_fields(two)
    source = open_run_data(two)
    for index in chosen_times(source, stored, ["60 mm"], last=True):
        name = f"step-{stored.steps[index]:06d}"
        grid, columns = pv.read(tmp_path / f"{name}.vtu"), table(tmp_path / f"{name}.csv")
        np.testing.assert_array_equal(grid.points[:, :2], stored.points())
        np.testing.assert_array_equal(grid.cells_dict[pv.CellType.TRIANGLE], stored.triangles())
        assert grid.field_data["TimeValue"][0] == stored.times[index]
        assert {*grid.point_data} == {*stored.units}
        np.testing.assert_array_equal(columns["x_m"], stored.points()[:, 0])
        for field, unit in stored.units.items():
            values = stored.field(field, index)
            flat, end = values.ndim == 1, {"1": "", "1/m": "_per_m"}.get(unit, f"_{unit}")
            np.testing.assert_array_equal(grid[field] if flat else grid[field][:, :2], values)
            parts = {"": values} if flat else {"_x": values[:, 0], "_y": values[:, 1]}
            for part, column in parts.items():
                np.testing.assert_array_equal(columns[f"{field}{part}{end}"], column)


def test_a_run_that_is_exported_without_pyvista_asks_for_it(
    two: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(LackingError, match="pip install pyvista"):
        export_results(two, tmp_path, last=True)


def test_times_are_chosen_by_time_displacement_and_number(two: Path) -> None:
    source, stored = open_run_data(two), read_fields(two)
    assert stored.steps.tolist() == list(range(0, 241, 20))
    assert chosen_times(source, stored) == list(range(13))
    assert chosen_times(source, stored, every=5) == [0, 5, 10]
    assert chosen_times(source, stored, last=True) == [12]
    assert chosen_times(source, stored, ["40 mm"]) == [6]
    assert chosen_times(source, stored, ["20 mm", f"{stored.times[7]}", "0 ms"]) == [0, 2, 7]
    with pytest.raises(ValueError, match=r"1 m is not among what was stored, 0 m to 0\.06 m"):
        chosen_times(source, stored, ["1 m"])
    with pytest.raises(ValueError, match="a time or displacement"):
        chosen_times(source, stored, ["3 kg"])


def test_the_distance_from_an_exact_cloud_is_zero(
    two: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stored, rng = read_fields(two), np.random.default_rng(0)
    points = rng.uniform((0, 0), (0.9, 0.3), (500, 2))
    path = cloud(tmp_path / "dic.csv", points, mean(stored, points, 10))
    assert export_results(two, tmp_path, cloud=path) == 0
    assert "60 mm: distance of displacements: root mean square" in capsys.readouterr().out
    columns = table(tmp_path / "step-000200-distance.csv")
    assert len(columns) == 500 and columns["distance_m"].max() < 1e-15
    assert (tmp_path / "step-000200-distance.png").stat().st_size > 10_000


def test_root_mean_square_and_largest_distance_are_those_of_the_points_on_the_sheet(
    two: Path,
) -> None:
    stored = read_fields(two)
    points = np.array([[0.1, 0.1], [0.2, 0.2], [0.3, 0.1], [0.3, 0.4]])
    measured = np.vstack([mean(stored, points[:3], 4), [[0, 0]]])
    measured += np.array([[0, 0], [3e-4, 4e-4], [0, 1e-4], [0, 0]])
    found = compare(stored, 4, points, measured)
    np.testing.assert_allclose(found.sizes, [0, 5e-4, 1e-4], atol=1e-15)
    assert "root mean square 294 µm" in str(found)
    assert "largest 500 µm at x = 200 mm, y = 200 mm; 3 points, 1 not on the sheet" in str(found)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x (mm),y (mm),ux (mm)\n1,2,3\n", "no column 'uy'"),
        ("x,y,ux,uy\n1,2,3,4\n", "no unit of the x"),
        ("x (mm),y (mm),ux (mm),uy (mm)\n1,2,NaN,4\n", "no row with a position"),
        ("x (mm),y (mm),ux (mm),uy (mm)\n1,2,3,4\n1,2,3,oil\n", "dic.csv:3: uy"),
        ("nothing\n", "no row with two numbers"),
    ],
)
def test_a_cloud_that_cannot_be_read_is_told_in_words(
    text: str, message: str, tmp_path: Path
) -> None:
    (tmp_path / "dic.csv").write_text(text)
    with pytest.raises(CaseError, match=message):
        read_cloud(tmp_path / "dic.csv")


def test_lost_points_of_a_cloud_are_left_out(tmp_path: Path) -> None:
    rows = "1;2;0,1;0,2\n3;4;;\n5;6;NaN;0\n7;8;0;0\n"
    (tmp_path / "dic.csv").write_text(f"X [mm];Y [mm];U [µm];V [µm]\n{rows}")
    found = read_cloud(tmp_path / "dic.csv")
    assert found.lost == 2
    np.testing.assert_allclose(found.points, [[1e-3, 2e-3], [7e-3, 8e-3]])
    np.testing.assert_allclose(found.displacements, [[1e-7, 2e-7], [0, 0]])


def test_what_cannot_be_exported_ends_with_a_message(
    two: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = cloud(tmp_path / "dic.csv", np.array([[1.0, 1.0]]), np.zeros((1, 2)))
    for options, message in (
        ({"at": "1 m"}, "not among what was stored"),
        ({"cloud": path}, "no point of the cloud lie"),
        ({"cloud": path, "every": 2}, "a cloud is of one time"),
    ):
        assert export_results(two, tmp_path / "out", **options) == 2
        assert message in capsys.readouterr().err
    assert export_results(tmp_path, None) == 2 and not (tmp_path / "out").exists()


def test_a_cloud_in_other_words_has_the_same_distances(
    two: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stored, rng = read_fields(two), np.random.default_rng(1)
    points = rng.uniform((0, 0), (0.9, 0.3), (40, 2))
    rows = 1e3 * np.column_stack([points, mean(stored, points, 10)])
    lines = [";".join(f"{v:.9f}".replace(".", ",") for v in row) for row in rows]
    (tmp_path / "dic.csv").write_text("\n".join(["a;b;c;d", *lines]) + "\n")
    layout = Layout(
        {"x": 1, "y": "b", "ux": 3, "uy": 4}, dict.fromkeys(("x", "y", "ux", "uy"), "mm")
    )
    options = {"at": "60 mm", "cloud": tmp_path / "dic.csv"}
    assert export_results(two, tmp_path, **options, layout=layout) == 0
    assert "40 points" in capsys.readouterr().out
    assert table(tmp_path / "step-000200-distance.csv")["distance_m"].max() < 1e-11
    with pytest.raises(CaseError, match="no column 'x'"):
        export_results(two, tmp_path, **options)


def test_a_cloud_with_another_origin_is_refused_with_both_ranges(
    two: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stored, rng = read_fields(two), np.random.default_rng(2)
    points = rng.uniform((0, 0), (0.9, 0.3), (200, 2))
    path = cloud(tmp_path / "dic.csv", points - [0.45, 0.15], mean(stored, points, 10))
    assert export_results(two, tmp_path / "out", cloud=path) == 2
    said = capsys.readouterr().err
    assert "of 200 points" in said and "x from 0 to 900 mm" in said and "x from -4" in said
    assert not (tmp_path / "out").exists()


def test_an_export_does_not_follow_links_out_of_the_results(small: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    precious = outside / "precious"
    precious.write_text("mine")
    (small / "export").symlink_to(outside)
    assert export_results(small, None, last=True) == 2
    (small / "export").unlink()
    (small / "export").mkdir()
    step = f"step-{read_fields(small).steps[-1]:06d}"
    for kind in ("vtu", "csv"):
        (small / "export" / f"{step}.{kind}").symlink_to(precious)
    assert export_results(small, None, last=True) == 0
    assert [*outside.iterdir()] == [precious] and precious.read_text() == "mine"
