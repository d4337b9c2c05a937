"""Mesh files: what gmsh writes is read as it is, and what is no mesh is refused in words."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from tests import scenes
from wovenfab.sheet.errors import GeometryError
from wovenfab.sheet.geometry_file import GeometryFile, from_file, read_geometry
from wovenfab.sheet.msh import read_msh, stated_points
from wovenfab.sheet.sheet import Sheet, directions

MESHES = Path(__file__).parents[2] / "meshes"
#: Versions that gmsh writes, as text and binary.
FORMS = list(product((2.2, 4.1), (False, True)))


def by_gmsh(path: Path, version: float, binary: bool, order: int = 1, name: str = "hole") -> Any:
    """Write a shipped geometry as a mesh; return points, lines and triangles as gmsh has them."""
    import gmsh

    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("Mesh.ElementOrder", order)
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.option.setNumber("Mesh.Binary", binary)
    gmsh.open(str(MESHES / f"{name}.geo"))
    gmsh.model.mesh.generate(2)
    gmsh.write(str(path))
    tags, places, _ = gmsh.model.mesh.getNodes()
    where = dict(zip(tags, places.reshape(-1, 3), strict=True))
    found = {}
    for dim in (1, 2):
        for _, entity in gmsh.model.getEntities(dim):
            (kind,), _, (nodes,) = gmsh.model.mesh.getElements(dim, entity)
            count = gmsh.model.mesh.getElementProperties(kind)[3]
            corners = nodes.reshape(-1, count)[:, : dim + 1]
            found[dim, entity] = np.array([[where[n] for n in cell] for cell in corners])
    groups = {
        gmsh.model.getPhysicalName(*group): tuple(gmsh.model.getEntitiesForPhysicalGroup(*group))
        for group in gmsh.model.getPhysicalGroups()
    }
    gmsh.finalize()
    return found, groups


@pytest.mark.parametrize(("version", "binary"), FORMS)
@pytest.mark.parametrize("order", [1, 3])
def test_a_mesh_has_the_cells_and_names_that_gmsh_has(
    version: float, binary: bool, order: int, tmp_path: Path
) -> None:
    path = tmp_path / "sheet.msh"
    cells, groups = by_gmsh(path, version, binary, order)
    mesh = read_msh(path)
    assert {(1, e) for e in mesh.curves} | {(2, e) for e in mesh.surfaces} == set(cells)
    for dim, own in ((1, mesh.curves), (2, mesh.surfaces)):
        for entity, rows in own.items():
            assert np.abs(mesh.points[rows] - cells[dim, entity]).max() < 1e-14
    read = {g.name: g.members for g in (*mesh.curve_groups, *mesh.surface_groups)}
    assert read == groups
    assert stated_points(path) == len(mesh.points)


def test_all_forms_of_a_mesh_give_one_sheet(tmp_path: Path) -> None:
    sheets = []
    for version, binary in FORMS:
        path = tmp_path / f"{version}{binary}.msh"
        by_gmsh(path, version, binary, name="dogbone")
        sheets.append(read_geometry(GeometryFile(path)))
    for other in sheets[1:]:
        assert len(other.triangles) == len(sheets[0].triangles)
        assert other.outline.polygon.equals_exact(sheets[0].outline.polygon, 1e-12)
        assert {c.name for c in other.curves} == {c.name for c in sheets[0].curves}


def test_the_other_order_of_bytes_is_read(tmp_path: Path) -> None:
    form = struct.pack(">i", 1)
    nodes = struct.pack(
        ">QQQQiiiQQQQ9d", 1, 3, 1, 3, 2, 1, 0, 3, 1, 2, 3, 0, 0, 0, 1, 0, 0, 0, 1, 0
    )
    cells = struct.pack(">QQQQiiiQQQQQ", 1, 1, 1, 1, 2, 1, 2, 1, 1, 1, 2, 3)
    path = tmp_path / "big.msh"
    path.write_bytes(
        b"$MeshFormat\n4.1 1 8\n" + form + b"\n$EndMeshFormat\n$Nodes\n" + nodes
        + b"\n$EndNodes\n$Elements\n" + cells + b"\n$EndElements\n"
    )  # fmt: skip
    mesh = read_msh(path)
    assert mesh.points.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    assert mesh.surfaces[1].tolist() == [[0, 1, 2]]


def moved(text: str, away: float) -> str:
    """Return a mesh of version 2.2 whose nodes are moved in x and y by a distance (m)."""
    head, _, rest = text.partition("$Nodes\n")
    nodes, _, tail = rest.partition("$EndNodes")
    count, *rows = nodes.strip().split("\n")
    places = [(n, float(x) + away, float(y) + away, z) for n, x, y, z in map(str.split, rows)]
    lines = "\n".join(f"{n} {x!r} {y!r} {z}" for n, x, y, z in places)
    return f"{head}$Nodes\n{count}\n{lines}\n$EndNodes{tail}"


def test_a_sheet_far_from_the_origin_has_the_same_force_or_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "sheet.msh"
    by_gmsh(path, 2.2, False, name="rectangle")
    text, forces = path.read_text(), []
    for away in (0.0, 8e3):
        path.write_text(moved(text, away))
        mesh = from_file(MPI.COMM_SELF, GeometryFile(path), None)
        model = scenes.model(Sheet(*mesh, directions(scenes.BIAS)), scenes.BONDED, scenes.PROTOTYPE)
        forces.append(scenes.force(model, scenes.PULL, 0.02)["right"][0])
    assert forces[1] == pytest.approx(forces[0], rel=1e-9)
    path.write_text(moved(text, 1e9))
    with pytest.raises(GeometryError, match="too rough; move it to the origin"):
        read_geometry(GeometryFile(path))


TEXT = """$MeshFormat
2.2 0 8
$EndMeshFormat
$Nodes
3
1 0 0 0
2 1 0 0
3 0 1 0
$EndNodes
$Elements
1
1 2 2 7 1 1 2 3
$EndElements
"""


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t: "", "no mesh of gmsh"),
        (lambda t: "SystemCall 'x';\n" + t, "no mesh of gmsh"),
        (lambda t: t.replace("2.2", "4.0"), "version is '4.0', and 2.2 and 4.1 can be read"),
        (lambda t: t.replace("2.2 0 8", "2.2 1 8"), "order of bytes"),
        (lambda t: t.replace("$EndElements", ""), r"\$Elements has no end"),
        (lambda t: t.replace("1 2 2 7 1 1 2 3", "1 2 2 7 1 1 2 4"), "a node that is not there"),
        (lambda t: t.replace("1 2 2 7", "1 99 2 7"), "elements of type 99"),
        (lambda t: t.replace("1 2 2 7", "1 2 9999 7"), "without physical groups"),
        (lambda t: t.replace("3\n1 0", "99999999999999\n1 0"), "cut short"),
        (lambda t: t.replace("3\n1 0", "-3\n1 0"), "cut short"),
        (lambda t: t.replace("3\n1 0", "2\n1 0"), "more than it says"),
        (lambda t: t.replace("2 1 0 0", "2 nan 0 0"), "not a number"),
        (lambda t: t.replace("2 1 0 0", "2 one 0 0"), "not a number"),
        (lambda t: t.replace("2 1 0 0", "3 1 0 0"), "two nodes of the same number"),
        (lambda t: t.replace("1 2 2 7 1 1 2 3", "1 2 2 7 1 1 2 3.5"), "must be whole"),
        (lambda t: t.replace("Nodes", "Points"), r"no section \$Nodes"),
        (lambda t: t.replace("2 1 0 0", "2 1 0 1e-4"), "not in the x-y plane"),
        (lambda t: t.replace("2 1 0 0", "2 1 0 1e-8"), "no named edges"),  # flat but for rounding
        (lambda t: t, "no named edges"),
        (lambda t: t.replace(" 7 ", " 0 "), "no physical surface"),
    ],
)
def test_what_is_no_whole_mesh_is_refused_with_the_reason(
    change: Callable[[str], str], says: str, tmp_path: Path
) -> None:
    (tmp_path / "sheet.msh").write_text(change(TEXT))
    with pytest.raises(GeometryError, match=f"sheet.msh: .*{says}"):
        read_geometry(GeometryFile(tmp_path / "sheet.msh"))


@pytest.mark.parametrize(("version", "binary"), FORMS)
def test_a_damaged_mesh_is_read_or_refused_in_words(
    version: float, binary: bool, tmp_path: Path
) -> None:
    path = tmp_path / "sheet.msh"
    by_gmsh(path, version, binary, name="rectangle")
    whole, generator, refused = path.read_bytes(), random.Random(7), 0
    for _ in range(60):
        data = bytearray(whole)
        for _ in range(generator.randint(1, 3)):
            at = generator.randrange(len(data))
            if generator.random() < 0.3:
                del data[at : at + generator.choice((1, 7, 10**9))]
            else:
                data[at : at + 1] = generator.choice((b"\xff", b"9", b"-", b" ", b"$", b"\n", b""))
            data = data or bytearray(b"x")
        path.write_bytes(data)
        try:
            read_geometry(GeometryFile(path))
        except GeometryError as error:
            refused += 1
            assert str(error).startswith(f"{path}: ")
    assert refused > 5
