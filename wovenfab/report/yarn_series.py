"""The yarns of a run over time, as lines that ParaView opens."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wovenfab.record.field_file import FieldFile, polylines
from wovenfab.record.stored_fields import StoredFields
from wovenfab.report.sheet import YARNS_ALONG, displacements
from wovenfab.report.source import Source
from wovenfab.report.yarns import Triangles, Yarns, lay_yarns

Values = NDArray[np.float64]
#: Name of the two files, without suffix.
SERIES = "yarns"


def write_yarns(source: Source, stored: StoredFields) -> list[Path]:
    """Write ``yarns.xdmf`` and ``yarns.h5`` with every stored time.

    A yarn is cut out of the sheet at rest and moves with its own family; its points have all
    scalar fields, those of one family under their names without its number.

    Args:
        source: The run; its fibres must be known.
        stored: Its fields.

    Returns:
        The two files.
    """
    assert source.fibres is not None
    mesh = Triangles(stored.points(), stored.triangles())
    spacing = float(np.ptp(mesh.points, axis=0).max()) / YARNS_ALONG
    families = [lay_yarns(mesh, direction, spacing) for direction in source.fibres]
    rest = np.concatenate([yarns.on(mesh.points) for yarns in families])
    sizes = [len(piece) for y in families for piece in y.pieces(y.share)]
    units = {"points": "m", "family": "1", "yarn": "1"} | _common(stored)
    file = FieldFile(source.directory, SERIES, polylines(sizes), rest, units, moving=True)
    marks = {
        "family": np.repeat([1.0, 2.0], [len(yarns.share) for yarns in families]),
        "yarn": np.concatenate([_numbers(yarns) for yarns in families]),
    }
    for index, (step, time) in enumerate(zip(stored.steps, stored.times, strict=True)):
        moved = [
            yarns.on(mesh.points + stored.field(_of(stored, "displacement", number), index))
            for number, yarns in enumerate(families, 1)
        ]
        fields = {
            name: np.concatenate(
                [
                    yarns.on(stored.field(_of(stored, name, number), index))
                    for number, yarns in enumerate(families, 1)
                ]
            )
            for name in _common(stored)
        }
        file.add(int(step), float(time), {"points": np.concatenate(moved), **marks, **fields})
    return [source.directory / f"{SERIES}.{kind}" for kind in ("xdmf", "h5")]


def _common(stored: StoredFields) -> dict[str, str]:
    """Return names, without the family's number, and units of the scalar fields."""
    vectors = {*displacements(stored), "relative_displacement"}
    return {
        name.removesuffix("_1").removesuffix("_2"): unit
        for name, unit in stored.units.items()
        if name not in vectors
    }


def _of(stored: StoredFields, name: str, family: int) -> str:
    """Return the field of a family, or the one that both share."""
    own = f"{name}_{family}"
    return own if own in stored.units else name


def _numbers(yarns: Yarns) -> Values:
    """Return the number of its yarn at each point."""
    sizes = np.diff([*yarns.starts, len(yarns.share)])
    return np.repeat(yarns.levels, sizes).astype(np.float64)
