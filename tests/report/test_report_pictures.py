import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread
from mpi4py import MPI

from tests.report.sample import make
from wovenfab.cli.report import report_results
from wovenfab.record.fields import FieldSeries, StoredFields, read_fields
from wovenfab.record.history import read_history
from wovenfab.report.curves import MOST_CYCLES, loop, losses
from wovenfab.report.pictures import ReportError, draw
from wovenfab.report.run_data import RunData, open_run_data
from wovenfab.report.sheet import MODE_SIZE, DisplacedSheet, deformed, mode, sheet_at
from wovenfab.report.style import house_style, readable, save
from wovenfab.report.yarns import Triangles
from wovenfab.sheet.output_nodes import OutputNodes


def test_all_pictures_are_drawn_from_the_files_alone(two: Path, tmp_path: Path) -> None:
    moved = tmp_path / "elsewhere"
    shutil.copytree(two, moved)
    drawn = draw(moved)
    assert [path.name for path in drawn] == ["loop.png", "loop.svg", "deformed.png"]
    for path in (drawn[0], drawn[2]):
        picture = imread(path)
        assert picture.shape[1] > 1000
        assert len(np.unique(picture.reshape(-1, picture.shape[2]), axis=0)) > 20


@pytest.mark.slow
def test_equal_results_give_equal_files(small: Path) -> None:
    first = [path.read_bytes() for path in draw(small)]
    assert [path.read_bytes() for path in draw(small)] == first


def test_the_loop_shows_every_row_once_in_millimetres(two: Path) -> None:
    history = read_history(two)
    figure = loop(open_run_data(two))
    axes = figure.axes[0]
    curves = [line for line in axes.lines if len(line.get_xdata()) > 2]
    assert len(curves) == 3
    x = np.concatenate([curves[0].get_xdata(), *(line.get_xdata()[1:] for line in curves[1:])])
    np.testing.assert_allclose(x, 1e3 * history["displacement_m"], atol=1e-9)
    assert axes.get_xlabel() == "displacement (mm)"
    assert axes.get_ylabel() == "force (N)"


def test_of_many_cycles_some_are_drawn_one_by_one_above_all(two: Path) -> None:
    """To draw each of thousands of cycles took minutes."""
    source = open_run_data(two)
    many = replace(source, cycles=source.cycles[:1] * 5000 + source.cycles[1:])
    axes = loop(many).axes[0]
    curves = [line for line in axes.lines if len(line.get_xdata()) > 2]
    assert len(curves) == MOST_CYCLES + 1
    np.testing.assert_allclose(curves[0].get_xdata(), 1e3 * source.history["displacement_m"])
    legend = axes.get_legend()
    numbers = [text.get_text().split()[0] for text in legend.get_texts()]
    assert (len(numbers), numbers[0], numbers[-1]) == (MOST_CYCLES, "1", "5002")
    assert "32 of 5002" in legend.get_title().get_text()
    assert len(losses(many).axes[1].patches) == MOST_CYCLES


def test_the_loop_states_the_dissipated_energy_of_the_data(two: Path) -> None:
    legend = loop(open_run_data(two)).axes[0].get_legend()
    lost = read_history(two)["dissipated_J"]
    said = [float(text.get_text().split()[-2]) for text in legend.get_texts()]
    np.testing.assert_allclose(said, np.diff(lost[[0, 80, 160, 240]]), rtol=6e-3)


def test_a_cycle_that_the_run_did_not_finish_is_marked(tmp_path: Path) -> None:
    stopped = make(tmp_path / "stopped", [0.02, 0.03], every=200, stop=100)
    said = [
        text.get_text() for text in loop(open_run_data(stopped)).axes[0].get_legend().get_texts()
    ]
    assert ["not finished" in text for text in said] == [False, True]


def test_an_elastic_loop_speaks_of_no_dissipation(small: Path) -> None:
    path = small / "history.csv"
    header, *rows = path.read_text().split()
    at = header.split(",").index("dissipated_J")
    cut = [row.split(",") for row in rows]
    path.write_text(
        "\n".join([header, *(",".join([*r[:at], "0.0", *r[at + 1 :]]) for r in cut), ""])
    )
    legend = loop(open_run_data(small)).axes[0].get_legend()
    assert [text.get_text() for text in legend.get_texts()] == ["1 (30 mm)"]


def test_the_loop_needs_no_summary_and_no_case(small: Path) -> None:
    (small / "summary.json").unlink()
    (small / "case.yaml").unlink()
    axes = loop(open_run_data(small)).axes[0]
    assert axes.get_title() == "small"
    assert max(len(line.get_xdata()) for line in axes.lines) == 81
    lost = read_history(small)["dissipated_J"][-1]
    assert axes.get_legend().get_texts()[0].get_text() == f"energy dissipated: {lost:.3g} J"


def test_the_sheet_is_shown_at_the_largest_displacement_stored(two: Path) -> None:
    figure = deformed(open_run_data(two), read_fields(two))
    axes, bar = figure.axes
    assert any("at 60 mm" in text.get_text() for text in axes.texts)
    right = max(c.get_datalim(axes.transData).x1 for c in axes.collections)
    assert right == pytest.approx(960, abs=2)
    assert bar.get_xlabel() == "slip between the families β (mm)"


def test_the_yarns_are_those_of_both_families(two: Path) -> None:
    axes = deformed(open_run_data(two), read_fields(two)).axes[0]
    yarns = [c for c in axes.collections if str(c.get_label()).startswith("family")]
    assert len(yarns) == 2
    for family in yarns:
        assert 20 <= len(family.get_segments()) <= 30


@pytest.mark.parametrize("is_upright", [False, True])
def test_the_legend_leaves_the_subtitle_free(
    is_upright: bool, two: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def upright(source: RunData, stored: StoredFields, index: int) -> DisplacedSheet:
        lying = sheet_at(source, stored, index)
        mesh = Triangles(lying.mesh.points[:, ::-1], lying.mesh.triangles)
        return DisplacedSheet(mesh, tuple(u[:, ::-1] for u in lying.families), lying.fibres)

    if is_upright:
        monkeypatch.setattr("wovenfab.report.sheet.sheet_at", upright)
    with house_style():
        figure = deformed(open_run_data(two), read_fields(two))
        FigureCanvasAgg(figure).draw()
    axes = figure.axes[0]
    (subtitle,) = [text for text in axes.texts if "at 60 mm" in text.get_text()]
    legend = axes.get_legend().get_window_extent()
    assert not legend.overlaps(subtitle.get_window_extent())
    assert not legend.overlaps(axes.get_window_extent().padded(-2))


def test_one_placement_is_coloured_by_the_shear_angle(small: Path) -> None:
    bar = deformed(open_run_data(small), read_fields(small)).axes[1]
    assert bar.get_xlabel() == "shear angle \N{GREEK SMALL LETTER GAMMA} (°)"


def test_a_run_without_fields_has_a_loop(small: Path) -> None:
    for name in ("fields.h5", "fields.xdmf"):
        (small / name).unlink()
    assert [path.name for path in draw(small)] == ["loop.png", "loop.svg"]


@pytest.mark.parametrize(
    "rows", [1, pytest.param(2, marks=pytest.mark.slow), pytest.param(30, marks=pytest.mark.slow)]
)
def test_a_run_that_stopped_early_has_its_pictures(tmp_path: Path, rows: int) -> None:
    assert len(draw(make(tmp_path / "stopped", [0.03], every=10, stop=rows))) == 3


def test_a_broken_picture_does_not_cost_the_others(small: Path) -> None:
    (small / "fields.h5").write_bytes(b"no HDF5")
    with pytest.raises(ReportError, match="no picture of deformed") as caught:
        draw(small)
    assert [path.name for path in caught.value.drawn] == ["loop.png", "loop.svg"]


def test_fibres_are_understood_in_degrees_and_in_radians(small: Path) -> None:
    fibres = open_run_data(small).fibres
    np.testing.assert_allclose(fibres, np.array([[1, 1], [1, -1]]) / np.sqrt(2), rtol=1e-12)


def test_an_angle_that_is_none_is_told_at_once(small: Path) -> None:
    case = small / "case.yaml"
    case.write_text(case.read_text().replace("45 deg", "9**9**9**9 deg"))
    command = "import sys; from wovenfab.report.run_data import open_run_data as o; o(sys.argv[1])"
    ended = subprocess.run(
        [sys.executable, "-c", command, small],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert "UnreadableResultsError" in ended.stderr and "9**9**9**9 deg" in ended.stderr


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0 N"),
        (2e-5, "20 µN"),
        (0.02, "20 mN"),
        (999, "999 N"),
        (-1500, "-1.5 kN"),
        (3e6, "3 MN"),
    ],
)
def test_units_keep_numbers_short(value: float, text: str) -> None:
    unit = readable("N", value)
    assert f"{value * unit.factor:.3g} {unit.name}" == text


@pytest.mark.slow
def test_the_mode_is_drawn_with_its_load_at_a_size_that_shows(small: Path) -> None:
    history, stored = read_history(small), read_fields(small)
    points, row = stored.points(), 3
    wave = np.sin(np.pi * points[:, 0] / np.ptp(points[:, 0]))
    parts = np.column_stack([np.zeros_like(wave), wave])
    cells = np.arange(len(points) // 10)
    units = {"displacement": "m", "mode": "1"}
    series = FieldSeries(small, MPI.COMM_SELF, OutputNodes(3), points, cells, units, "mode")
    series.write(0, history["time_s"][row], {"displacement": 0 * parts, "mode": parts})
    drawn = draw(small)
    assert [path.name for path in drawn][-1] == "mode.png"
    axes = mode(open_run_data(small), read_fields(small, "mode")).axes[0]
    said = " ".join(text.get_text() for text in axes.texts)
    assert f"{1e3 * history['displacement_m'][row]:.4g} mm" in said
    assert f"{history['force_N'][row]:.4g} N" in said
    triangulation = axes.collections[0].get_datalim(axes.transData)
    width = 1e3 * np.ptp(points[:, 1])
    assert triangulation.height == pytest.approx(width + 1e3 * MODE_SIZE * 0.9, rel=0.05)


def test_a_users_text_is_no_formula_and_controls_nothing(tmp_path: Path) -> None:
    title = r"5 $ and \frac{$ or $x^{2$ [b] <i> & tab"
    results = make(tmp_path / "run[b]", [0.03], placements=1, every=80)
    case = results / "case.yaml"
    text = case.read_text()
    first = text.splitlines()[0]
    case.write_text(text.replace(first, f"title: {json.dumps(title + chr(27) + ']0;x' + chr(7))}"))
    assert report_results([results], None) == 0
    texts = [t.strip() for t in ET.parse(results / "loop.svg").getroot().itertext()]
    assert any(r"5 $ and \frac{$ or $x^{2$" in t for t in texts)
    page = (results / "report.html").read_text()
    assert "could not be drawn" not in page and r"\x1b]0;x\x07" in page
    assert not {"\x1b", "\x07"} & {*page, *(results / "loop.svg").read_text()}


def test_ticks_of_a_logarithmic_axis_are_powers_of_ten_without_dollars(tmp_path: Path) -> None:
    with house_style():
        figure = Figure(figsize=(3, 2))
        axes = figure.subplots()
        axes.loglog([1e-3, 1e4], [1, 100])
        save(figure, tmp_path / "log.png")
        labels = [tick.get_text() for tick in axes.get_xticklabels()]
    assert len({*labels} & {f"10{power}" for power in "⁰¹²³⁴"}) >= 2
    assert not [label for label in labels if "$" in label]
