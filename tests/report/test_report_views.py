"""Which times, scales and cells the pictures of a page show."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

from tests.report.sample import make, mesh, on_lattices
from wovenfab.record.fields import FieldSeries, StoredFields, read_fields
from wovenfab.report.curves import cycle_figures, energies, loops, losses, parts, solver
from wovenfab.report.run_data import key_times, largest, open_run_data
from wovenfab.report.style import house_style, main_field, scale_of, seconds
from wovenfab.sheet.output_nodes import OutputNodes


def test_the_reversal_and_the_end_of_each_cycle_are_found(two: Path) -> None:
    source, stored = open_run_data(two), read_fields(two)
    found = key_times(source, stored)
    assert [turn.displacement for turn, _ in found] == pytest.approx([0.02, 0.04, 0.06])
    assert [end.displacement for _, end in found] == pytest.approx([0, 0, 0], abs=1e-12)
    assert stored.steps[[end.index for _, end in found]].tolist() == [80, 160, 240]
    assert [turn.words for turn, _ in found] == [
        "cycle 1, 20 mm", "cycle 2, 40 mm", "cycle 3, 60 mm",
    ]  # fmt: skip
    assert largest(source, stored).displacement == pytest.approx(0.06)


def test_of_many_cycles_the_first_the_last_and_some_between_are_shown(two: Path) -> None:
    found = key_times(open_run_data(two), read_fields(two), most=2)
    assert [turn.words[:7] for turn, _ in found] == ["cycle 1", "cycle 3"]


def test_a_run_without_cycles_is_one_way(small: Path) -> None:
    (small / "summary.json").unlink()
    ((turn, end),) = key_times(open_run_data(small), read_fields(small))
    assert (turn.words, end.words) == ("run, 30 mm", "end of run")


def test_a_cycle_that_goes_on_ends_where_it_is(tmp_path: Path) -> None:
    stopped = make(tmp_path / "s", [0.03], placements=1, every=10, stop=31)
    ((turn, end),) = key_times(open_run_data(stopped), read_fields(stopped))
    assert turn.index == end.index == 3


def test_one_scale_serves_several_pictures() -> None:
    small, large = np.linspace(0, 1e-3, 101), np.linspace(0, 4e-3, 101)
    scale = scale_of("beta", "m", [small, large])
    assert scale.label == "slip between the families β (mm)"
    assert (scale.norm.vmin, scale.norm.vmax) == (0, pytest.approx(4, rel=0.02))
    np.testing.assert_allclose(scale(large), 1e3 * large)


def test_a_few_peaks_do_not_dim_the_rest_and_are_told() -> None:
    values = np.concatenate([np.linspace(0, 1, 1000), [50.0]])
    scale = scale_of("curvature_1", "1/m", [values])
    assert scale.norm.vmax == pytest.approx(1, rel=0.01)
    assert scale.extend == "max"


def test_signs_that_matter_have_a_scale_with_zero_in_the_middle() -> None:
    strain = scale_of("stretch_1", "1", [np.linspace(-1e-4, 5e-4, 1001)])
    assert strain.norm.vmin == -strain.norm.vmax
    assert strain.label == "strain of family 1 (10⁻⁶)"
    back = scale_of("shear_angle", "rad", [np.linspace(-0.3, 0.3, 101)])
    assert back.norm.vmin == -back.norm.vmax == pytest.approx(np.degrees(-0.3), rel=0.01)
    dips = scale_of("shear_angle", "rad", [np.linspace(-0.01, 0.3, 101)])
    assert (dips.norm.vmin, dips.extend) == (0, "both")


@pytest.mark.parametrize("size", [0.0, 1e-15], ids=["zeros", "round-off"])
def test_a_field_of_zeros_or_round_off_has_a_scale_that_shows_none(size: float) -> None:
    scale = scale_of("shear_angle", "rad", [np.linspace(-size, size, 5)])
    assert (scale.norm.vmin, scale.extend) == (0, "neither")
    assert scale.norm.vmax > 1


@dataclass(frozen=True)
class Stub(StoredFields):
    """Fields of which each has one value everywhere."""

    values: dict[str, float] = field(default_factory=dict)

    def field(self, name: str, index: int) -> NDArray[np.float64]:
        """Return the value of a field at some points."""
        return np.full(5, self.values[name])


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"shear_angle": 0.2, "stretch_1": 1e-3}, "shear_angle"),
        ({"shear_angle": 1e-15, "stretch_1": 1e-3}, "stretch_1"),
        ({"shear_angle": 0.0, "stretch_1": 0.0}, "shear_angle"),
        ({"shear_angle": 1e-9, "beta": 1e-9}, "beta"),  # of a sheet of a millimetre
        ({"displacement": 0.1}, None),
    ],
)
def test_a_picture_is_coloured_by_the_first_field_that_is_not_zero(
    values: dict[str, float], told: str | None
) -> None:
    none = np.zeros(0)
    units = {name: "m" if name == "beta" else "1" for name in values}
    stub = Stub(Path(), none.astype(np.int64), none, units, values)
    assert main_field(stub, 0) == told


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5])
def test_the_cells_are_those_of_the_mesh(degree: int, tmp_path: Path) -> None:
    cells, lattice = mesh(0.15), OutputNodes(degree)
    points, numbers = on_lattices(lattice, cells), np.arange(len(cells))
    FieldSeries(tmp_path, MPI.COMM_SELF, lattice, points, numbers, {})
    stored = read_fields(tmp_path)
    assert stored.lattice == lattice
    np.testing.assert_allclose(stored.corners(), cells)


def test_effects_without_energy_are_left_out() -> None:
    history = {
        "energy_J": np.ones(2),
        "energy_shear_J": np.ones(2),
        "energy_bending_J": np.zeros(2),
        "dissipated_J": np.zeros(2),
        "dissipated_slip_friction_J": np.ones(2),
    }
    assert list(parts(history, "energy")) == ["shear"]
    assert list(parts(history, "dissipated")) == ["slip_friction"]


def test_the_losses_are_those_of_the_cycles(two: Path) -> None:
    source = open_run_data(two)
    with house_style():
        left, right = losses(source).axes
    heights = [bar.get_height() for bar in left.containers[0]]
    np.testing.assert_allclose(heights, [cycle.dissipated for cycle in source.cycles])
    shown = [bar.get_height() for bar in right.containers[0]]
    true = np.array([cycle.imbalance for cycle in source.cycles])
    np.testing.assert_allclose(np.array(shown) * true[0], true * shown[0])


def test_energies_show_each_effect_and_their_sum(two: Path) -> None:
    source = open_run_data(two)
    with house_style():
        stored, lost = energies(source).axes
    curves = [line for line in stored.lines if len(line.get_xdata()) > 2]
    np.testing.assert_allclose(curves[0].get_ydata(), source.history["energy_stretch_J"])
    assert [text.get_text() for text in lost.get_legend().get_texts()] == ["slip friction"]


def test_the_solver_shows_every_step(small: Path) -> None:
    source = open_run_data(small)
    source = replace(source, summary={"wall_time_s": {"steps": 9.0, "mesh": 0.001}})
    with house_style():
        iterations, length, phases = solver(source).axes
    assert len(iterations.lines[0].get_xdata()) == 80
    np.testing.assert_allclose(
        length.lines[0].get_ydata() * 1e-3, np.diff(source.history["time_s"])
    )
    assert [text.get_text() for text in phases.get_yticklabels()] == ["steps"]


def test_the_time_of_a_long_run_has_no_exponent() -> None:
    times = (0.01234, 9.87, 244.3, 7_262.0, 86_400.0)
    assert [seconds(time) for time in times] == ["0.012 s", "9.9 s", "240 s", "7300 s", "86000 s"]


def test_an_overlay_has_a_line_for_each_run(two: Path, small: Path) -> None:
    runs = [("a", open_run_data(two)), ("b", open_run_data(small))]
    with house_style():
        (axes,) = loops(runs).axes
        figures = cycle_figures(runs)
    for line, (name, source) in zip(axes.lines, runs, strict=False):
        assert line.get_label() == name
        np.testing.assert_allclose(line.get_xdata(), 1e3 * source.history["displacement_m"])
    peaks = [len(line.get_xdata()) for line in figures.axes[0].lines]
    assert peaks == [3, 1]
