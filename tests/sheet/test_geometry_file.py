"""Files for gmsh: units, parameters, edges by number, and what is refused in words."""

from __future__ import annotations

import re
from math import cos, pi, sin, sqrt
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from tests.cli.test_commands import CASE
from tests.outlines import aligned, edge_lengths
from wovenfab.case import CaseError, read_case
from wovenfab.case.objects import coarse_geometry, sheet_of
from wovenfab.cli.check import check_case, edges_of
from wovenfab.sheet import geometry_file
from wovenfab.sheet.geometry_file import GeometryFile, outline_from_file, read_geometry

OCC = 'SetFactory("OpenCASCADE");\n'
#: 0.9 wide and 0.3 high; the curves are bottom, right, top, left.
PLATE = OCC + "DefineConstant[ w = 0.9 ];\nh = w / 3;\nRectangle(1) = {0, 0, 0, w, h};\n"
SURFACE = 'Physical Surface("s") = {1};\n'
GRIPS = SURFACE + 'Physical Curve("left") = {4};\nPhysical Curve("right") = {2};\n'
#: An ellipse with a straight cut at x = -0.07, the tool beside it.
CUT = (
    OCC + "Disk(1) = {0, 0, 0, 0.1, 0.08};\nRectangle(2) = {-0.27, -0.1, 0, 0.2, 0.2};\n"
    "BooleanDifference(3) = { Surface{1}; Delete; }{ Surface{2}; {delete} };\n"
    'Physical Surface("s") = {3};\n'
    'Physical Curve("left") = {Curve In BoundingBox{-0.071, -0.09, -1, -0.069, 0.09, 1}};\n'
)


def written(folder: Path, text: str, name: str = "sheet.geo") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def case_with(folder: Path, keys: str = "", name: str = "sheet.geo") -> Path:
    """Return a case with a sheet from a file beside it, and more keys of the sheet."""
    own = f"sheet: {{file: {name}, fibres: [45 deg, -45 deg]{keys and ', '}{keys}}}"
    text = re.sub(r"sheet: .*", own, CASE)
    if name.endswith(".msh"):
        text = text.replace(", mesh_size: 150 mm", "")
    return written(folder, text, "case.yaml")


def lengths(folder: Path, keys: str = "", name: str = "sheet.geo") -> dict[str, float]:
    """Return the lengths (m) of the edges of a case's sheet."""
    return edge_lengths(sheet_of(read_case(case_with(folder, keys, name)), MPI.COMM_SELF))


def made_by_gmsh(source: Path, name: str) -> None:
    """Write what gmsh makes of a geometry beside it, as a mesh or as .step in millimetres."""
    import gmsh

    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.open(str(source))
    if name.endswith(".msh"):
        gmsh.model.mesh.generate(2)
    gmsh.write(str(source.with_name(name)))
    gmsh.finalize()


@pytest.mark.parametrize(
    ("geometry", "keys", "height"),
    [
        (PLATE + GRIPS, "", 0.3),
        (PLATE + GRIPS, "parameters: {w: 600 mm}", 0.2),
        (PLATE.replace("0.9", "900") + GRIPS, "unit: mm", 0.3),
        (PLATE.replace("0.9", "900") + GRIPS, "unit: mm, parameters: {w: 0.6 m}", 0.2),
        (PLATE.replace("0.9", "900") + GRIPS, "unit: mm, parameters: {w: 600}", 0.2),
        (PLATE + SURFACE, "edges: {left: 4, right: [2]}", 0.3),
        (PLATE, "edges: {left: 4, right: 2}", 0.3),
    ],
)
def test_unit_parameters_and_edges_of_a_case_make_the_sheet(
    geometry: str, keys: str, height: float, tmp_path: Path
) -> None:
    written(tmp_path, geometry)
    assert lengths(tmp_path, keys) == pytest.approx({"left": height, "right": height})


@pytest.mark.parametrize(
    ("name", "keys"),
    [("plate.step", "edges: {left: 4, right: 2}"), ("plate.msh", "unit: mm")],
)
def test_other_files_in_millimetres_give_the_same_sheet(
    name: str, keys: str, tmp_path: Path
) -> None:
    made_by_gmsh(written(tmp_path, PLATE.replace("0.9", "900") + GRIPS), name)
    assert lengths(tmp_path, keys, name) == pytest.approx({"left": 0.3, "right": 0.3})


def test_check_lists_edges_and_curves_without_a_name(tmp_path: Path) -> None:
    written(tmp_path, PLATE.replace("0.9", "900") + GRIPS)
    case = read_case(case_with(tmp_path, "unit: mm"))
    assert edges_of(coarse_geometry(case, MPI.COMM_SELF)) == [
        "edge right: 0.3 m long, x = 0.9 m, y = 0 to 0.3 m (curve 2)",
        "edge left: 0.3 m long, x = 0 m, y = 0 to 0.3 m (curve 4)",
        "without a name: curve 1 (0.9 m long, x = 0 to 0.9 m, y = 0 m), "
        "curve 3 (0.9 m long, x = 0 to 0.9 m, y = 0.3 m)",
        "the narrowest place is 0.3 m wide (0.33 of the size of the sheet), "
        "at x = 0.45 m, y = 0.15 m",
    ]


@pytest.mark.parametrize(("size", "times"), [("100 mm", 2), ("5 mm", 1)])
def test_check_runs_a_geometry_once_and_again_for_a_small_mesh_alone(
    size: str, times: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A geometry is a program of the user's."""
    written(tmp_path, PLATE + GRIPS)
    path, made = case_with(tmp_path, "unit: m"), []
    mesh = geometry_file.meshed
    monkeypatch.setattr(geometry_file, "meshed", lambda *a: made.append(a) or mesh(*a))
    assert check_case(path, [f"discretisation.mesh_size={size}"]) == 0
    assert len(made) == times


@pytest.mark.parametrize("delete", ["", "Delete;"])
def test_a_cut_ellipse_has_its_straight_edge_with_or_without_the_tool(
    delete: str, tmp_path: Path
) -> None:
    path = written(tmp_path, CUT.replace("{delete}", delete))
    outline, _ = outline_from_file(MPI.COMM_SELF, GeometryFile(path), 0.03)
    chord = 2 * 0.08 * sqrt(1 - 0.7**2)
    on = aligned(outline, (45, -45), 0.03)
    assert edge_lengths(on) == pytest.approx({"left": chord}, rel=1e-6)


#: Geometry, keys of the sheet, and the message.
REFUSED = [
    (PLATE + GRIPS, "parameters: {v: 1}", r"parameters\.v: .*no parameter 'v'; it has .*\bw\b"),
    (PLATE + GRIPS, "parameters: {h: 1}", r"parameters\.h: .*computes 'h'; .*DefineConstant"),
    (PLATE + GRIPS, "parameters: {w: 1 kg}", r"parameters\.w: expected a number, a length or"),
    (PLATE + GRIPS, "unit: s", r"sheet\.unit: expected a unit of length such as 'mm'"),
    (PLATE + GRIPS, "edges: {top: 7}", r"edges\.top: .*curve 7 of 'top' is not on the outline"),
    (PLATE + GRIPS, "edges: {top: 4}", "curve 4 is in two edges, 'left' and 'top'"),
    (PLATE + SURFACE, "", r"no named edges; .*edges: \{left: 1\}.* curve 1 \(0.9 m long"),
    (
        PLATE + "Disk(2) = {0, 0, 0, 0.1};\n"
        "BooleanDifference(3) = { Surface{1}; Delete; }{ Surface{2}; Delete; };\n"
        'Physical Surface("s") = {3};\nPhysical Curve("left") = {77};\n',
        "",
        r"Physical Curve\('left'\) in line 8 names curve 77, which is not there: "
        r"the Boolean operation in line 6 .*the outline has curve",
    ),
    (PLATE + GRIPS + "Recombine Surface {1};\n", "", "has quadrilaterals.*Recombine in line 8"),
    (
        PLATE + "Rectangle(2) = {2, 0, 0, 1, 1};\n" + GRIPS.replace("{1}", "{1, 2}"),
        "",
        "in 2 pieces, the second one at x = ",
    ),
    (
        PLATE + "Rectangle(2) = {0.5, 0, 0, 1, 1};\n" + GRIPS.replace("{1}", "{1, 2}"),
        "",
        "touches or overlaps itself|crosses itself|in 2 pieces",
    ),
    (PLATE + GRIPS + "Rotate{{1, 0, 0}, {0, 0, 0}, 1} { Surface{1}; }\n", "", "x-y plane: z is"),
]


@pytest.mark.parametrize(("geometry", "keys", "says"), REFUSED)
def test_what_makes_no_sheet_is_refused_with_cause_and_remedy(
    geometry: str, keys: str, says: str, tmp_path: Path
) -> None:
    written(tmp_path, geometry)
    with pytest.raises(CaseError, match=says):
        lengths(tmp_path, keys)


@pytest.mark.parametrize(
    ("name", "keys", "says"),
    [
        ("a.step", "unit: cm", "a .step file states its unit"),
        ("a.step", "parameters: {w: 1}", "a.step has no parameters"),
        ("plate.msh", "", "quadrilaterals.*gmsh -2 FILE.geo"),
    ],
)
def test_keys_and_cells_that_do_not_fit_a_file_are_refused(
    name: str, keys: str, says: str, tmp_path: Path
) -> None:
    written(tmp_path, "", name)
    if name == "plate.msh":
        made_by_gmsh(written(tmp_path, PLATE + GRIPS + "Recombine Surface {1};\n"), name)
    with pytest.raises(CaseError, match=says):
        lengths(tmp_path, keys, name)


def test_an_outline_of_small_edges_is_read_without_small_cells_inside(tmp_path: Path) -> None:
    n, lines = 400, [OCC]
    turns = [2 * pi * k / n for k in range(n)]
    lines += [f"Point({k}) = {{{cos(t)}, {sin(t)}, 0}};" for k, t in enumerate(turns, 1)]
    lines += [f"Line({k}) = {{{k}, {k % n + 1}}};" for k in range(1, n + 1)]
    lines += [f"Curve Loop(1) = {{1:{n}}};", "Plane Surface(1) = {1};", SURFACE]
    lines += ['Physical Curve("left") = {200:220};', 'Physical Curve("right") = {1:20};']
    file = GeometryFile(written(tmp_path, "\n".join(lines)))
    full, coarse = (read_geometry(file, 0.5, follow_curves=f) for f in (False, True))
    assert 5 * len(coarse.triangles) < len(full.triangles)
    (ring,), (other,) = coarse.outline.rings, full.outline.rings
    assert (ring.points == other.points).all() and ring.names == other.names


def test_an_outline_of_long_cells_has_the_area_of_its_circle_without_many_edges(
    tmp_path: Path,
) -> None:
    """A polygon of n sides lacks 2 pi^2 / (3 n^2) of the area."""
    text = OCC + 'Disk(1) = {0, 0, 0, 0.1};\nPhysical Curve("left") = {1};\n' + SURFACE
    file = GeometryFile(written(tmp_path, text))
    (ring,) = read_geometry(file, 0.1, follow_curves=True).outline.rings
    x, y = ring.points.T
    area = abs(x @ np.roll(y, 1) - y @ np.roll(x, 1)) / 2
    assert 0.997 < area / (0.01 * pi) < 1
    assert len(ring.points) < 60
