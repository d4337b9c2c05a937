"""A target accuracy on several ranks: the same elements, steps, errors and answers as on one."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from wovenfab.case import Case, CaseError, read_case
from wovenfab.case.objects import model_of, sheet_of
from wovenfab.model.assembly import cache_folder
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation import progress
from wovenfab.study.errors.choice import Plan, plan
from wovenfab.study.errors.elements import error_shares
from wovenfab.study.errors.estimate import ERRORS, write_errors
from wovenfab.study.errors.meshes import compile_ahead
from wovenfab.study.errors.step_search import StepSearch
from wovenfab.study.response import (
    Response,
    prolongated,
    response_of,
    trial_of,
    with_elements,
)

pytestmark = [pytest.mark.mpi]
COMM, ALONE = MPI.COMM_WORLD, MPI.COMM_SELF
CONFIGS = Path(__file__).parents[2] / "configs"
SAME = 1e-6
#: Of an answer, for its errors: differences of answers that are solved to 1e-6, extrapolated.
ALIKE = 1e-4
THERE_AND_BACK = "[{to: 20 mm, RAMP}, {to: 0 mm, RAMP}]".replace(
    "RAMP", "type: ramp, duration: 0.1 s, steps: 8"
)


def answer(case: Case, comm: MPI.Comm) -> tuple[Plan, Response, list[str]]:
    """Return the plan, the run with it and the messages on the way."""
    messages: list[str] = []
    planned = plan(case, comm, messages.append)
    return planned, response_of(planned.case, planned.sheet), messages


def relative(planned: Plan) -> dict[str, float]:
    assert planned.estimate is not None
    time = planned.estimate.time or {}
    return planned.estimate.space | {f"{name} of steps": e for name, e in time.items()}


@pytest.mark.parametrize(
    ("name", "program", "accuracy"),
    [
        ("elastic-1x3", "{type: ramp, to: 20 mm, steps: 4}", "1 %"),
        pytest.param("bias-1x3", THERE_AND_BACK, "10 %", marks=pytest.mark.slow),
    ],
)
def test_a_target_accuracy_is_reached_by_the_same_means(
    name: str, program: str, accuracy: str, tmp_path: Path
) -> None:
    overrides = f"accuracy={accuracy}", "discretisation=null", "time=null", f"program={program}"
    case = read_case(CONFIGS / f"{name}.yaml", overrides)
    together, trace, messages = answer(case, COMM)
    alone, expected, messages_alone = answer(case, ALONE)
    assert COMM.bcast(messages) == COMM.bcast(messages_alone)  # the first rank's have the steps
    assert together.shortfall == alone.shortfall == ""
    assert together.case == alone.case
    assert trace.model.unknowns == expected.model.unknowns
    assert trace.outcome == expected.outcome
    assert trace.figures == pytest.approx(expected.figures, rel=SAME)
    assert trace.forces == pytest.approx(expected.forces, abs=SAME * abs(expected.forces).max())
    errors = relative(together)
    assert errors == pytest.approx(relative(alone), abs=ALIKE)
    assert COMM.allgather(errors) == [errors] * COMM.size

    shared = Path(COMM.bcast(str(tmp_path)))
    assert together.estimate is not None and alone.estimate is not None
    write_errors(together.estimate, shared)
    with (shared / ERRORS).open() as file:
        rows = list(csv.DictReader(file))
    history = alone.estimate.history()
    for column, values in history.items():  # errors are differences of the answers themselves
        whole = history[column.replace("_error_of_elements", "")]
        written = np.array([float(row[column]) for row in rows])
        assert np.abs(written - values).max() <= ALIKE * np.abs(whole).max(), column
    own, whole = (error_shares(*p.estimate.models) for p in (together, alone))
    gathered = np.concatenate(COMM.allgather(own))
    assert np.sort(gathered) == pytest.approx(np.sort(whole), abs=SAME)


@pytest.mark.mpi4
def test_steps_are_chosen_by_the_first_rank_as_by_one_while_others_do_something_else() -> None:
    case = read_case(
        CONFIGS / "bias-1x3.yaml",
        ["program={type: ramp, to: 5 mm, duration: 0.1 s, steps: 8}", "time=null"],
    )
    trial = trial_of(with_elements(case, degree=2, mesh_size=0.15), 0.05)
    lines: list[str] = []
    others: list[int] = []
    meanwhile = map(others.append, [COMM.rank])
    chosen = StepSearch(trial, COMM, lines.append).steps_for(0.05, meanwhile)
    alone = StepSearch(trial, ALONE, str).steps_for(0.05)
    assert chosen is not None and alone is not None
    assert (chosen.words, chosen.number, chosen.effort) == (alone.words, alone.number, alone.effort)
    assert chosen.errors == pytest.approx(alone.errors, rel=1e-9)
    assert bool(lines) == (COMM.rank == 0)
    assert others == [COMM.rank][: COMM.rank]


def test_what_is_compiled_ahead_leaves_nothing_to_compile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And what cannot be compiled is left to those who need it."""

    def refuse(*_: object) -> Sheet:
        raise CaseError([])

    monkeypatch.setenv("XDG_CACHE_HOME", COMM.bcast(str(tmp_path)))
    ramp = "program={type: ramp, to: 5 mm, steps: 1}"
    case = with_elements(read_case(CONFIGS / "bonded-1x3.yaml", [ramp]), mesh_size=0.15)
    ahead: list[Path] = []
    for mesher in (refuse, sheet_of):
        if COMM.rank:
            list(compile_ahead(case, COMM, mesher, [2, 3]))
        COMM.Barrier()
        ahead = sorted(cache_folder().glob("*.c"))
        assert bool(ahead) == (mesher is sheet_of)
        COMM.Barrier()  # all have looked
    for degree in (2, 3):
        assert response_of(with_elements(case, degree=degree), sheet_of(case, COMM)).count == 1
    assert sorted(cache_folder().glob("*.c")) == ahead


@pytest.mark.mpi4
@pytest.mark.parametrize("angle", [pytest.param(45, marks=pytest.mark.slow), 35])
def test_a_field_is_the_same_in_elements_of_higher_degree_on_any_rank(angle: int) -> None:
    """Also at nodes of a rank that are in none of its cells, as there are on two."""
    fibres = f"sheet.fibres=[{angle} deg, -{angle} deg]"
    case = with_elements(read_case(CONFIGS / "bias-1x3.yaml", [fibres]), mesh_size=0.1)
    on = sheet_of(case, COMM)
    low, high = (model_of(with_elements(case, degree=p), on) for p in (2, 3))
    for model in (low, high):
        x, y = model.placements.positions.T
        model.field.x.array.reshape(-1, 2)[:] = np.column_stack([x + y**2, y - x * y])
    found = prolongated(low.field.x.array, low, high)
    assert found == pytest.approx(high.field.x.array, abs=1e-13)


@pytest.mark.slow
def test_the_same_is_chosen_whatever_memory_the_machines_have(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Else ranks would end the search at different meshes, and wait for each other for ever."""
    case = read_case(
        CONFIGS / "elastic-1x3.yaml",
        ["accuracy=1 %", "discretisation=null", "program={type: ramp, to: 20 mm, steps: 4}"],
    )
    usual = plan(case, COMM, lambda line: None)
    monkeypatch.setattr(progress, "memory_of_machine", lambda: 1.6e8 if COMM.rank else 2.0e8)
    found = plan(case, COMM, lambda line: None)
    assert found.case == usual.case and not found.shortfall
    monkeypatch.setattr(progress, "memory_of_machine", lambda: 1e6)
    with pytest.raises(CaseError, match="memory"):
        plan(case, COMM, lambda line: None)
