"""Meshes by gmsh: named edges, grading, and files that cannot be used."""

from __future__ import annotations

from math import hypot, pi
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from tests import scenes
from tests.outlines import LENGTHS, assert_edges, edge_lengths
from wovenfab.compat import corners_of
from wovenfab.sheet.geometry_file import GeometryFile, from_file
from wovenfab.sheet.gmsh_io import graded_rectangle
from wovenfab.sheet.msh import stated_points
from wovenfab.sheet.sheet import GeometryError, Sheet, directions

MESHES = Path(__file__).parents[2] / "meshes"
#: Two straight grips, two quarter circles of radius 50 mm and the gauge.
SIDE = 0.2 + 0.05 * pi / 2 + 0.5 + 0.05 * pi / 2 + 0.2
DOGBONE = {"left": 0.3, "right": 0.3, "bottom": SIDE, "top": SIDE}


def shipped(name: str | Path, mesh_size: float | None = None) -> Sheet:
    return Sheet(
        *from_file(MPI.COMM_WORLD, GeometryFile(MESHES / name), mesh_size), directions(scenes.BIAS)
    )


@pytest.mark.parametrize(
    ("name", "lengths", "slack"),
    [("rectangle.geo", LENGTHS, 1e-12), ("dogbone.geo", DOGBONE, 0.01)],
)
def test_shipped_geometries_have_named_edges(
    name: str, lengths: dict[str, float], slack: float
) -> None:
    on = shipped(name)
    assert_edges(on, lengths, slack)
    assert on.mesh.geometry.dim == 2


def test_the_mesh_size_of_a_case_refines_a_shipped_geometry() -> None:
    coarse, fine = shipped("rectangle.geo"), shipped("rectangle.geo", 0.02)
    cells = [on.mesh.topology.index_map(2).size_global for on in (coarse, fine)]
    assert cells[1] > 4 * cells[0]
    assert sizes(fine)[0].max() < 1.5 * 0.02


def test_a_msh_file_gives_the_mesh_that_it_holds(tmp_path: Path) -> None:
    import gmsh

    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.open(str(MESHES / "rectangle.geo"))
    gmsh.model.mesh.generate(2)
    triangles = len(gmsh.model.mesh.getElementsByType(2)[0])
    gmsh.write(str(tmp_path / "sheet.msh"))
    gmsh.finalize()
    on = shipped(tmp_path / "sheet.msh")
    assert on.mesh.topology.index_map(2).size_global == triangles
    assert edge_lengths(on) == pytest.approx(LENGTHS, rel=1e-12)


@pytest.mark.parametrize(
    ("version", "binary"), [(2.2, False), (2.2, True), (4.0, False), (4.1, False), (4.1, True)]
)
def test_the_head_of_a_mesh_tells_its_points(version: float, binary: bool, tmp_path: Path) -> None:
    import gmsh

    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.open(str(MESHES / "rectangle.geo"))
    gmsh.model.mesh.generate(2)
    points = len(gmsh.model.mesh.getNodes()[0])
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.option.setNumber("Mesh.Binary", binary)
    gmsh.write(str(tmp_path / "sheet.msh"))
    gmsh.finalize()
    assert stated_points(tmp_path / "sheet.msh") == points


def sizes(on: Sheet) -> tuple[np.ndarray, np.ndarray]:
    """Return the size of each cell and its distance from the nearest corner (m)."""
    cells = np.arange(on.mesh.topology.index_map(2).size_local, dtype=np.int32)
    middles = on.mesh.geometry.x[corners_of(on.mesh)].mean(axis=1)[:, :2]
    corners = np.array([(0, 0), (0.9, 0), (0.9, 0.3), (0, 0.3)])
    away = np.linalg.norm(middles[:, None] - corners[None], axis=2).min(axis=1)
    return on.mesh.h(2, cells), away


def test_a_graded_rectangle_has_its_smallest_cells_at_the_corners() -> None:
    parts = graded_rectangle(MPI.COMM_WORLD, 0.9, 0.3, 0.05, 0.002)
    on = Sheet(*parts, directions(scenes.BIAS))
    size, away = sizes(on)
    assert edge_lengths(on) == pytest.approx(LENGTHS, rel=1e-12)
    assert size[away < 0.003].max() < 0.005
    assert size[np.argsort(size)[:8]].max() < 0.004
    assert away[np.argsort(size)[:8]].max() < 0.02
    assert size[away > 0.2].min() > 0.02
    assert np.corrcoef(size, away)[0, 1] > 0.8


def test_an_ungraded_rectangle_is_uniform() -> None:
    parts = graded_rectangle(MPI.COMM_WORLD, 0.9, 0.3, 0.05, None)
    size, _ = sizes(Sheet(*parts, directions(scenes.BIAS)))
    assert size.max() / size.min() < 2.0


def test_a_gmsh_rectangle_and_a_structured_one_give_nearly_the_same_force() -> None:
    structured, gmsh = (
        scenes.force(scenes.model(on, scenes.BONDED, scenes.PROTOTYPE), scenes.PULL, 0.02)["right"]
        for on in (scenes.sheet(mesh_size=0.025), shipped("rectangle.geo", 0.025))
    )
    assert gmsh[0] == pytest.approx(structured[0], rel=0.03)
    assert hypot(*gmsh) == pytest.approx(gmsh[0], rel=1e-3)


@pytest.mark.parametrize(
    ("message", "group"),
    [
        (
            r'no physical surface; add one, such as Physical Surface\("sheet"\) = \{1\};',
            "Physical Curve",
        ),
        ("no named edges; add", "Physical Surface"),
    ],
)
def test_a_geometry_without_physical_groups_is_refused_with_its_remedy(
    message: str, group: str, tmp_path: Path
) -> None:
    lines = (MESHES / "rectangle.geo").read_text().splitlines()
    kept = [ln for ln in lines if not ln.startswith("Physical") or ln.startswith(group)]
    path = tmp_path / "sheet.geo"
    path.write_text("\n".join(kept))
    with pytest.raises(GeometryError, match=f"sheet.geo: {message}"):
        from_file(MPI.COMM_WORLD, GeometryFile(path), None)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("missing.geo", None),
        ("noise.geo", "this is not a geometry;\n"),
        ("noise.msh", "\x00\x01 noise"),
        ("empty.geo", ""),
        ("open.geo", "Point(1) = {0,0,0};\nPoint(2) = {1,0,0};\nLine(1) = {1,2};\n"
                     "Curve Loop(1) = {1};\nPlane Surface(1) = {1};\n"
                     'Physical Surface("s") = {1};\nPhysical Curve("left") = {1};\n'),
    ],
)  # fmt: skip
def test_an_unusable_file_is_refused_by_name(name: str, text: str | None, tmp_path: Path) -> None:
    path = tmp_path / name
    if text is not None:
        path.write_text(text)
    with pytest.raises(GeometryError, match=name):
        from_file(MPI.COMM_WORLD, GeometryFile(path), None)
    # gmsh has been put away: the next geometry is not disturbed.
    assert set(shipped("rectangle.geo").edges) == set(LENGTHS)


def test_a_curve_without_a_name_is_no_edge_and_says_which_are(tmp_path: Path) -> None:
    text = (MESHES / "rectangle.geo").read_text()
    path = tmp_path / "sheet.geo"
    path.write_text(text.replace('Physical Curve("top")', "Physical Curve(9)"))
    assert set(shipped(path).edges) - {""} == {"left", "right", "bottom"}


def test_a_geometry_reads_others_beside_it(tmp_path: Path) -> None:
    (tmp_path / "part.geo").write_text((MESHES / "rectangle.geo").read_text())
    (tmp_path / "whole.geo").write_text('// Print, then Exit.\nInclude "part.geo";\n')
    whole, part = (
        from_file(MPI.COMM_SELF, GeometryFile(tmp_path / f"{n}.geo"), None)
        for n in ("whole", "part")
    )
    assert whole[2] == part[2]


def test_a_geometry_in_millimetres_is_refused_before_it_is_meshed(tmp_path: Path) -> None:
    (tmp_path / "mm.geo").write_text(
        "Point(1) = {0, 0, 0}; Point(2) = {900, 0, 0}; Point(3) = {900, 300, 0};\n"
        "Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 1};\n"
        "Curve Loop(1) = {1:3}; Plane Surface(1) = {1};\n"
    )
    with pytest.raises(
        GeometryError, match=r"900 m x 300 m in cells of 0\.05 m are too .*unit: mm"
    ):
        from_file(MPI.COMM_WORLD, GeometryFile(tmp_path / "mm.geo"), 0.05)
