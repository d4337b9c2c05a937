from collections import Counter

import numpy as np
import pytest

from wovenfab.sheet.output_nodes import OutputNodes

DEGREES = [1, 2, 3, 4, 5]


@pytest.mark.parametrize("degree", DEGREES)
def test_the_points_are_the_lattice_of_the_reference_triangle(degree: int) -> None:
    points = OutputNodes(degree).points
    assert points.shape == ((degree + 1) * (degree + 2) // 2, 2)
    assert len(np.unique(points, axis=0)) == len(points)
    np.testing.assert_allclose(points * degree, np.round(points * degree), atol=1e-14)
    assert points.min() == 0
    assert points.sum(axis=1).max() <= 1 + 1e-15


@pytest.mark.parametrize("degree", DEGREES)
def test_the_triangles_tile_the_reference_triangle(degree: int) -> None:
    lattice = OutputNodes(degree)
    corners = lattice.points[lattice.triangles]
    (a, b) = (corners[:, i] - corners[:, 0] for i in (1, 2))
    areas = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    np.testing.assert_allclose(areas, 1 / (2 * degree**2))
    edges = Counter(
        frozenset((t[i], t[i - 1])) for t in lattice.triangles.tolist() for i in range(3)
    )
    shared = Counter(edges.values())
    assert (shared[1], shared[2]) == (3 * degree, 3 * degree * (degree - 1) // 2)
    assert sum(shared.values()) == shared[1] + shared[2]


def test_every_cell_has_points_of_its_own() -> None:
    lattice = OutputNodes(3)
    triangles = lattice.connectivity(4)
    assert triangles.shape == (4 * 9, 3)
    owners = triangles // len(lattice.points)
    assert (owners == np.repeat(np.arange(4), 9)[:, None]).all()
    np.testing.assert_array_equal(triangles[27:] % len(lattice.points), lattice.triangles)


def test_a_lattice_without_intervals_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        OutputNodes(0)
