"""What a process for gmsh does: ``python3 -m wovenfab.sheet.gmsh_program FOLDER``.

It reads FOLDER/request.json, and writes the mesh into FOLDER/mesh.npz. A ``.geo`` is a program in
gmsh's language and may do what its user may do, such as run other programs or write files. A
``.step`` is data, which OpenCASCADE reads.
"""

from __future__ import annotations

import json
import re
import resource
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wovenfab.lacking import LackingError
from wovenfab.sheet.errors import GeometryError
from wovenfab.sheet.gmsh_model import cells_of, load_gmsh, nodes_of, start

#: What gmsh says of a physical group with a member that the geometry lacks.
UNKNOWN = re.compile(r"Skipping unknown (curve|surface) (\d+) in physical \w+ (\d+)")
#: What it says of a file that it reads.
READING = re.compile(r"Reading '(.*)'\.\.\.")
#: Statements after which curves have other numbers.
BOOLEANS = re.compile(r"\b(?:Boolean\w+|Coherence)\b")
#: Statements that make quadrilaterals.
RECOMBINING = re.compile(r"\b(?:Recombine|Mesh\.RecombineAll|Mesh\.SubdivisionAlgorithm)\b")
#: Segments that a full circle of the outline is divided in, at least.
SEGMENTS = 48


def main(folder: Path) -> None:
    """Do what the request in a folder says, and leave the result there."""
    request = json.loads((folder / "request.json").read_text())
    resource.setrlimit(resource.RLIMIT_AS, (request["memory"], request["memory"]))
    arrays: dict[str, NDArray[Any]] = {}
    try:
        head, arrays = _meshed(load_gmsh(), request, folder)
    except GeometryError as error:
        head = {"problem": str(error), "key": error.key}
    except LackingError as error:
        head = {"problem": str(error), "key": "file"}
    arrays["head"] = np.array(json.dumps(head))
    with (folder / "mesh.npz").open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def _meshed(
    gmsh: Any, request: dict[str, Any], folder: Path
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return what describes the mesh of a file, and its arrays."""
    path = Path(request["path"])
    start(gmsh)
    gmsh.logger.start()
    try:
        if path.suffix.lower() == ".geo":
            _run(gmsh, path, request["parameters"], folder)
        else:
            gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
            gmsh.model.occ.importShapes(str(path), highestDimOnly=False, format="step")
            gmsh.model.occ.synchronize()
        if request["follow"]:
            _follow_curves(gmsh)
        if (size := request["mesh_size"]) is not None:
            _require_few(gmsh, request)
            if request["follow"]:  # cells inside need not be as small as those at edges
                gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)
            if not request["coarse"]:
                gmsh.option.setNumber("Mesh.MeshSizeMax", size)
        if not gmsh.model.mesh.getNodes()[0].size:
            gmsh.model.mesh.generate(2)
        return _result(gmsh, path)
    except Exception as error:
        if type(error) is not Exception:  # that of gmsh
            raise
        why = str(error).replace(f"'{path}', ", "")  # gmsh names the file again
        nothing = (
            f"it ends without a word, as where {request['memory'] / 1e9:.1f} GB of memory are "
        )
        text = f"gmsh cannot mesh it: {why or nothing + 'too little for too many cells'}"
        if not _ends(path):
            text += "; its last line has no line end: add one, for gmsh reads that line otherwise"
        raise GeometryError(text) from error


def _ends(path: Path) -> bool:
    """Return whether the last line of a geometry has an end."""
    return path.suffix.lower() != ".geo" or path.read_bytes()[-1:] in (b"\n", b"")


def _run(gmsh: Any, path: Path, parameters: dict[str, float], folder: Path) -> None:
    """Run a geometry with values for the constants that it lets others define."""
    for name, value in parameters.items():
        gmsh.parser.setNumber(name, [value])
    if _ends(path):
        gmsh.merge(str(path))  # unlike open, it leaves parameters as they are
    else:  # gmsh leaves out statements at the end of a file whose last line has no end
        whole, quote = folder / "whole.geo", "'" if '"' in str(path) else '"'
        whole.write_text(f"Include {quote}{path}{quote};\n\n\n")
        gmsh.merge(str(whole))
    read = [path, *(Path(p) for line in gmsh.logger.get() for p in READING.findall(line))]
    code = "\n".join(_code(other) for other in read if other.is_file())
    known = sorted({*gmsh.parser.getNames()} - {*parameters})
    for name, value in parameters.items():
        key = f"parameters.{name}"
        if not re.search(rf"\b{re.escape(name)}\b", code):
            has = f"it has {', '.join(known)}" if known else "it has none"
            raise GeometryError(f"there is no parameter {name!r}; {has}", key)
        if gmsh.parser.getNumber(name)[0] != value:
            raise GeometryError(
                f"the file computes {name!r}; a case sets what stands in DefineConstant[ … ]",
                key,
            )


def _code(path: Path) -> str:
    """Return the text of a geometry without comments, for messages."""
    text = path.read_text(encoding="latin-1")
    comments = r"//[^\n]*|/\*.*?\*/"
    return re.sub(comments, lambda m: re.sub(r"[^\n]", " ", m.group()), text, flags=re.DOTALL)


def _line(path: Path, statement: re.Pattern[str]) -> str:
    """Return in words the line where a statement stands, or nothing."""
    code = _code(path) if path.suffix.lower() == ".geo" else ""
    found = statement.search(code)
    return f"in line {code.count(chr(10), 0, found.start()) + 1}" if found else ""


def _follow_curves(gmsh: Any) -> None:
    """Divide curves finely enough for their shape, whatever the size of the cells."""
    for _, curve in gmsh.model.getEntities(1):
        if gmsh.model.getType(1, curve) != "Line":
            (first,), (last,) = gmsh.model.getParametrizationBounds(1, curve)
            places = np.linspace(first, last, SEGMENTS + 1)
            slopes = gmsh.model.getDerivative(1, curve, places).reshape(-1, 3)
            angles = np.unwrap(np.arctan2(slopes[:, 1], slopes[:, 0]))
            turned = np.abs(np.diff(angles)).sum()
            parts = max(1, int(np.ceil(turned / (2 * np.pi) * SEGMENTS)))
            gmsh.model.mesh.setTransfiniteCurve(curve, parts + 1)


def _require_few(gmsh: Any, request: dict[str, Any]) -> None:
    """Refuse a geometry that would get too many cells, as one in millimetres does."""
    x, y, _, right, top, _ = gmsh.model.getBoundingBox(-1, -1)
    size, unit = request["mesh_size"], request["unit"]
    if 2 * (right - x) * (top - y) > request["cells"] * size**2:
        raise GeometryError(
            f"{(right - x) * unit:g} m x {(top - y) * unit:g} m in cells of {size * unit:g} m are "
            "too many; if it is in millimetres, write 'unit: mm' beside 'file'"
        )


def _result(gmsh: Any, path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return what describes the present mesh, and its arrays."""
    mesh = gmsh.model.mesh
    arrays: dict[str, NDArray[Any]] = {}
    arrays["points"], rows = nodes_of(gmsh)
    entities = {dim: [int(tag) for _, tag in gmsh.model.getEntities(dim)] for dim in (1, 2)}
    for dim, numbers in entities.items():
        for number in numbers:
            arrays[f"{dim} {number}"] = cells_of(gmsh, dim, number, rows)
    lacking: dict[tuple[int, int], list[int]] = {}
    for line in gmsh.logger.get():
        for kind, tag, group in UNKNOWN.findall(line):
            lacking.setdefault((1 if kind == "curve" else 2, int(group)), []).append(int(tag))
    groups = []
    for dim, group in {**dict.fromkeys(gmsh.model.getPhysicalGroups()), **lacking}:
        if dim in entities:
            name = gmsh.model.getPhysicalName(dim, group)
            known = group in {tag for _, tag in gmsh.model.getPhysicalGroups(dim)}
            members = gmsh.model.getEntitiesForPhysicalGroup(dim, group) if known else []
            place = _line(path, re.compile(rf"Physical\s+\w+\s*\(\s*\"{re.escape(name)}\""))
            missing = lacking.get((dim, group), [])
            groups.append((dim, name, [int(m) for m in members], missing, place))
    kinds = [mesh.getElementProperties(kind)[5] for kind in mesh.getElementTypes(2)]
    head = {
        "entities": entities,
        "groups": groups,
        "other_cells": any(corners != 3 for corners in kinds),
        "recombining": _line(path, RECOMBINING),
        "boolean": _line(path, BOOLEANS),
    }
    return head, arrays


if __name__ == "__main__":
    main(Path(sys.argv[1]))
