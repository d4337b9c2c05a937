"""Checkpoints: what a run needs to go on, in a file that is whole or not there.

The last two are kept. Arrays have one row a cell of the mesh, in an order that does not depend
on the ranks, so that another number of ranks can go on.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from wovenfab.record.field_file import UNLOCKED, hdf5_image
from wovenfab.record.results import (
    CHECKPOINT,
    EARLIER_CHECKPOINT,
    NothingToResumeError,
    write_whole,
)

#: Version of what checkpoints hold; another one cannot be read.
VERSION = 1


@dataclass(frozen=True)
class Checkpoint:
    """The state of a run after a step.

    Attributes:
        step: Number of the step.
        time: s.
        values: Plain values, which stand for arrays by their names.
        arrays: Rows of all cells by name; on rank 0 alone.
    """

    step: int
    time: float
    values: Mapping[str, Any]
    arrays: Mapping[str, NDArray[np.float64]] = field(repr=False)


def write_checkpoint(directory: Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint; the last one stays as the one before. On one rank.

    Raises:
        OSError: It cannot be written; the earlier ones are still there.
    """

    def fill(file: h5py.File) -> None:
        for name, rows in checkpoint.arrays.items():
            file.create_dataset(name, data=rows)
        file.attrs["version"] = VERSION
        file["state"] = json.dumps(
            {
                "step": checkpoint.step,
                "time": checkpoint.time,
                "values": checkpoint.values,
            }
        )

    new, last = directory / f"{CHECKPOINT}.new", directory / CHECKPOINT
    write_whole(new, hdf5_image(fill))
    if last.exists():
        last.replace(directory / EARLIER_CHECKPOINT)
    new.replace(last)


def newest_checkpoint(directory: Path) -> Checkpoint:
    """Return the newest whole checkpoint of a results directory; on one rank.

    Raises:
        NothingToResumeError: There is none, or another version wrote it.
    """
    for name in (f"{CHECKPOINT}.new", CHECKPOINT, EARLIER_CHECKPOINT):
        try:
            with h5py.File(directory / name, "r", **UNLOCKED) as file:
                version = int(file.attrs["version"])
                if version != VERSION:
                    raise NothingToResumeError(
                        f"{directory / name} was written by another version of wovenfab (state "
                        f"{version}, here {VERSION}); go on with that version, or begin anew with "
                        "--overwrite"
                    )
                state = json.loads(file["state"][()])
                arrays = {n: file[n][()] for n in file if n != "state"}
        except (OSError, KeyError, ValueError):  # not there, or not whole
            continue
        return Checkpoint(**state, arrays=arrays)
    why = "does not exist" if not directory.is_dir() else "holds no checkpoint"
    raise NothingToResumeError(
        f"there is nothing to go on from: {directory} {why}; run the case from its beginning"
    )
