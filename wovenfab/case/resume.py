"""How a case goes on from a checkpoint, or starts from the state of one."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from wovenfab.case.case import Case
from wovenfab.case.document import FILE
from wovenfab.case.errors import CaseError
from wovenfab.case.fingerprint import EFFECT, STATE, contents_of
from wovenfab.case.program import program_of_case
from wovenfab.model.model import Model
from wovenfab.parallel import compute_on_root
from wovenfab.record.field_file import PROGRAM, Checkpoint
from wovenfab.record.results import NothingToResumeError
from wovenfab.simulation.checkpoint import (
    ARRAY,
    Array,
    SnapshotFormat,
    fitting,
    has_mesh,
    load_checkpoint,
    values_at,
)
from wovenfab.stepping.program import SAME

#: Sections of a case that a run may change when it goes on.
FREE = {
    *("title", "fabric", "program", "second_program", "accuracy"),
    *("time", "solver", "output", "figures"),
}


def require_same(case: Case, checkpoint: Checkpoint, directory: Path) -> Case:
    """Return a case that goes on from a checkpoint: with an accuracy, what was chosen for it.

    Raises:
        NothingToResumeError: Physics, mesh or a finished part of the program differ, or a study
            wrote the checkpoint.
    """
    _require_case(checkpoint, directory)
    if "run" not in checkpoint.values:
        raise NothingToResumeError(
            f"{directory} is a part of a study, which goes on when the study is repeated"
        )
    with fitting(directory):
        if case.accuracy is not None:
            case = _with_choices(case, checkpoint, directory)
        before, now = _without_places(checkpoint.values["case"]), _without_places(fixed_part(case))
        differing = [name for name in sorted({*before, *now}) if before.get(name) != now.get(name)]
        if not differing and not _has_made(case, checkpoint):
            differing = [f"program before t = {checkpoint.time:.6g} s"]
    if differing:
        raise NothingToResumeError(
            f"the run in {directory} cannot go on with this case: {' and '.join(differing)} "
            f"{'differs' if len(differing) == 1 else 'differ'}. Go on with the case as it was, or "
            "run this one into another directory with -o"
        )
    return case


def _with_choices(case: Case, checkpoint: Checkpoint, directory: Path) -> Case:
    """Return a case with the elements and steps that were chosen for its accuracy.

    Raises:
        NothingToResumeError: They were chosen for another accuracy.
    """
    wanted = (checkpoint.values["run"]["errors"] or {}).get("wanted")
    if wanted != case.accuracy:
        raise NothingToResumeError(
            f"the run in {directory} was {'not ' if wanted is None else ''}made for an accuracy"
            f"{'' if wanted is None else f' of {wanted:g}, not {case.accuracy:g}'}; leave accuracy "
            "out, or run this case into another directory with -o"
        )
    chosen = dict(checkpoint.values["chosen"])
    segments = chosen_part(case)["program"]
    if _motions(segments[: len(chosen["program"])]) == _motions(chosen["program"]):
        chosen["program"] += segments[len(chosen["program"]) :]
    else:
        del chosen["program"]
    changes = [f"{name}={json.dumps(value)}" for name, value in chosen.items()]
    return case.changed("accuracy=null", *changes)


def state_checkpoint(case: Case, comm: MPI.Comm) -> Checkpoint:
    """Return the checkpoint that a case starts from; collective.

    Raises:
        CaseError: There is none, or it is of another sheet or of other elements by its case.
    """
    directory = case.from_state
    assert directory is not None
    try:
        checkpoint = load_checkpoint(directory, comm)
        _require_case(checkpoint, directory)
        with fitting(directory):
            before, now = checkpoint.values["case"], fixed_part(case)
            parts = "sheet", "discretisation"
            differing = " and ".join(n for n in parts if before.get(n) != now.get(n))
    except NothingToResumeError as error:
        raise CaseError([case.problem(STATE, str(error))]) from error
    _require_equal(case, differing)
    return checkpoint


def state_of(case: Case, model: Model) -> Array:
    """Return the state that a case starts from: unknowns with ghosts, m; collective.

    Raises:
        CaseError: There is none, or it is of another sheet or of other elements.
    """
    assert case.from_state is not None
    checkpoint = state_checkpoint(case, model.comm)
    try:
        with fitting(case.from_state):
            differing, name = _differing(model, checkpoint)
    except NothingToResumeError as error:
        raise CaseError([case.problem(STATE, str(error))]) from error
    _require_equal(case, differing)
    state: Array = SnapshotFormat(model).scatter({ARRAY: name}, checkpoint.arrays)
    return state


def _require_equal(case: Case, differing: str) -> None:
    """Raise if the sheet of the run that a case starts from differs in something."""
    if differing:
        message = f"the run in {case.from_state} has another sheet: {differing} differ"
        remedy = "Take the same sheet, elements and number of placements."
        raise CaseError([case.problem(STATE, message, remedy)])


def _differing(model: Model, checkpoint: Checkpoint) -> tuple[str, str]:
    """Return what the mesh of a checkpoint has otherwise, and its array of a state; collective."""
    same = has_mesh(model.sheet, checkpoint)
    name = str(checkpoint.values["stepper"]["state"]["states"][0][ARRAY])
    size = int(np.prod(model.placements.blocks.shape[1:])) * 2
    cells, values = compute_on_root(model.comm, lambda: checkpoint.arrays[name].shape)
    if not same:
        return "the meshes that its geometry gives", name
    if values != size:
        return "the number of placements", name
    if cells != model.sheet.mesh.topology.index_map(2).size_global:
        return "the number of cells", name
    return "", name


def _require_case(checkpoint: Checkpoint, directory: Path) -> None:
    """Raise if a checkpoint is not of a run of a case.

    Raises:
        NothingToResumeError: It is of a simulation that was made without a case.
    """
    if not {"case", "chosen"} <= {*checkpoint.values}:
        raise NothingToResumeError(
            f"the run in {directory} was not made from a case: it goes on from Python, by "
            "wovenfab.simulate(simulation, directory, resume=True)"
        )


def identity_of(case: Case) -> dict[str, Any]:
    """Return what checkpoints keep of a case, by which its run is recognised."""
    return {"case": fixed_part(case), "chosen": chosen_part(case)}


def fixed_part(case: Case) -> dict[str, Any]:
    """Return what must not change while a run goes on; of files it is what is in them.

    Of a geometry it is the mesh, which :func:`require_same_mesh` compares; of tables it is the
    program so far.
    """
    dump = case.model_dump(mode="json", by_alias=True, exclude=FREE)
    sheet = {k: v for k, v in dump["sheet"].items() if k != "file" and v is not None}
    contents = {
        f"the contents of {name}": of
        for name, of in contents_of(case).items()
        if name.startswith(EFFECT) or name == STATE
    }
    return {**dump, "sheet": sheet, **contents}


def _without_places(part: Mapping[str, Any]) -> dict[str, Any]:
    """Return a fixed part without the places of files of effects, whose contents it has."""
    effects = {
        name: {k: v for k, v in values.items() if k != FILE}
        for name, values in part["effects"].items()
    }
    return {**part, "effects": effects}


def chosen_part(case: Case) -> dict[str, Any]:
    """Return what an accuracy may have chosen."""
    names = {"discretisation", "time", "program"}
    chosen = case.model_dump(mode="json", by_alias=True, exclude_none=True, include=names)
    if isinstance(chosen["program"], dict):  # a single segment
        chosen["program"] = [chosen["program"]]
    return chosen


def _motions(segments: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return segments of a program without their numbers of steps."""
    return [{k: v for k, v in segment.items() if k != "steps"} for segment in segments]


def _has_made(case: Case, checkpoint: Checkpoint) -> bool:
    """Return whether a case has the program of a checkpoint up to its time."""
    program, before = program_of_case(case), checkpoint.arrays[PROGRAM]
    largest = np.abs(before).max(axis=1, keepdims=True)
    same = np.abs(values_at(program, before[0]) - before) <= SAME * largest
    return bool(program.milestones[-1].time >= checkpoint.time and same.all())
