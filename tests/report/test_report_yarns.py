import numpy as np
import pytest

from wovenfab.report.yarns import Triangles, lay_yarns, material_lines, outline
from wovenfab.sheet.output_nodes import OutputNodes

RISING = np.array([1.0, 1.0]) / np.sqrt(2)


def sheet(hole: bool = False) -> Triangles:
    """A 3 by 3 square of squares of two triangles each, with points of their own."""
    lattice = OutputNodes(2)
    corners = []
    for i in range(3):
        for j in range(3):
            if not (hole and i == j == 1):
                corners += [
                    [[i, j], [i + 1, j], [i + 1, j + 1]],
                    [[i, j], [i + 1, j + 1], [i, j + 1]],
                ]
    shape = np.column_stack([1 - lattice.points.sum(axis=1), lattice.points])
    points = np.einsum("pk,ckd->cpd", shape, np.array(corners, dtype=float)).reshape(-1, 2)
    return Triangles(points, lattice.connectivity(len(corners)))


def length(line: np.ndarray) -> float:
    return float(np.hypot(*np.diff(line, axis=0).T).sum())


def test_yarns_run_from_edge_to_edge_along_the_fibre() -> None:
    mesh = sheet()
    lines = material_lines(mesh, RISING, np.zeros_like(mesh.points), spacing=0.3)
    assert len(lines) == 14
    for line in lines:
        across = line @ [-RISING[1], RISING[0]]
        np.testing.assert_allclose(across, across[0], atol=1e-6)
        for end in (line[0], line[-1]):
            assert min(abs(end).min(), abs(end - 3).min()) < 1e-6
    offsets = np.sort([float(np.mean(line @ [-RISING[1], RISING[0]])) for line in lines])
    np.testing.assert_allclose(np.diff(offsets), 0.3, rtol=1e-5)


def test_yarns_are_drawn_where_their_family_is() -> None:
    mesh = sheet()
    gradient = np.array([[1.2, 0.3], [-0.1, 0.9]])
    rest = material_lines(mesh, RISING, np.zeros_like(mesh.points), 0.3)
    moved = material_lines(mesh, RISING, mesh.points @ (gradient - np.eye(2)).T, 0.3)
    for before, after in zip(rest, moved, strict=True):
        np.testing.assert_allclose(after, before @ gradient.T, atol=1e-5)


def test_no_yarn_mixes_the_two_sides_of_a_jump_along_the_fibre() -> None:
    mesh = sheet()
    centres = np.repeat(mesh.points.reshape(-1, 6, 2).mean(axis=1), 6, axis=0)
    above = centres[:, 1] > centres[:, 0]  # the diagonal is a fibre
    jump = np.where(above, 0.5, 0.0)[:, None] * RISING
    # 2 lines a spacing, so that one lies on the diagonal but for the hair beside it
    lines = material_lines(mesh, RISING, jump, spacing=np.sqrt(2))
    assert len(lines) == 2 * int(3 / 2)
    reach = [length(line) for line in lines]
    rest = [length(line) for line in material_lines(mesh, RISING, 0 * jump, np.sqrt(2))]
    np.testing.assert_allclose(reach, rest, rtol=1e-6)


def test_yarns_stop_at_a_hole() -> None:
    mesh = sheet(hole=True)
    lines = material_lines(mesh, np.array([1.0, 0.0]), np.zeros_like(mesh.points), spacing=0.5)
    lengths = sorted(length(line) for line in lines)
    np.testing.assert_allclose(lengths, [1, 1, 1, 1, 3, 3, 3, 3], rtol=1e-5)


@pytest.mark.parametrize(("hole", "lengths"), [(False, [12]), (True, [4, 12])])
def test_the_outline_is_the_edge_and_the_holes_only(hole: bool, lengths: list[float]) -> None:
    mesh = sheet(hole)
    np.testing.assert_allclose(sorted(length(line) for line in outline(mesh)), lengths, rtol=1e-6)
    stretched = outline(mesh, mesh.points)
    np.testing.assert_allclose(sum(map(length, stretched)), 2 * sum(lengths), rtol=1e-6)


def test_the_outline_does_not_depend_on_the_order_of_corners_and_cells() -> None:
    mesh = sheet(hole=True)
    rng = np.random.default_rng(3)
    cells = rng.permutation(mesh.triangles)
    turned = np.where(rng.random(len(cells))[:, None] < 0.5, cells[:, ::-1], cells)
    lines = outline(Triangles(mesh.points, turned))
    np.testing.assert_allclose(sorted(map(length, lines)), [4, 12], rtol=1e-6)
    for line in lines:
        np.testing.assert_allclose(line[0], line[-1], atol=1e-9)


def test_a_field_on_yarns_is_interpolated_along_the_sides_of_triangles() -> None:
    mesh = sheet(hole=True)
    yarns = lay_yarns(mesh, RISING, 0.37)
    places = yarns.on(mesh.points)
    np.testing.assert_allclose(
        yarns.on(2 + mesh.points @ [3, -1]), 2 + places @ [3, -1], atol=1e-12
    )
    assert len(yarns.pieces(places)) == len(yarns.levels)
    assert (yarns.share >= 0).all() and (yarns.share <= 1).all()


def test_a_yarn_that_runs_along_sides_of_triangles_is_there_once() -> None:
    mesh = sheet()
    spacing = 0.5 / (0.5 + 1e-4)  # a yarn at y = 2, where squares meet
    lines = material_lines(mesh, np.array([1.0, 0.0]), np.zeros_like(mesh.points), spacing)
    assert [length(line) for line in lines] == pytest.approx([3.0] * len(lines))
    assert any(abs(line[:, 1] - 2).max() < 1e-9 for line in lines)
