"""Elements and steps that reach a wanted accuracy, found by estimating errors."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from mpi4py import MPI

from wovenfab.case import Case
from wovenfab.model.placements import placements_on
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.assemble import scheme_of
from wovenfab.simulation.size import memory, memory_of_machine
from wovenfab.simulation.trace import Trace, discretised, keeps_its_steps, paced, steps_in, trace_of
from wovenfab.stepping.failure import StepFailedError
from wovenfab.stepping.stability import StabilityLostError
from wovenfab.study.estimate import FEW, Estimate, Ladder, Pair, Tell, combined

Mesher = Callable[[Case], Sheet]
Failure = StepFailedError | StabilityLostError
#: Sizes of cells that are tried, as parts of the sheet's shorter side.
PARTS = (2, 3, 4, 6, 8, 12, 16, 24, 32)
#: Degrees of the elements that are tried; one lower and one higher tell their errors.
DEGREES = (3, 4)
#: Shares of the usual number of steps that are tried; half of the first begins.
SHARES = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
#: Times the wanted error at which the next degree, which is dear to compile, is not tried.
HOPELESS = 2.0
#: Share of the machine's memory that a run may take.
ROOM = 0.6


@dataclass(frozen=True)
class Found:
    """What the pilot found.

    Attributes:
        case: The case with elements and steps, without a wanted accuracy.
        sheet: Its sheet.
        estimate: Its errors; None where no trial got to its end.
        shortfall: Why the accuracy is not reached, or empty.
    """

    case: Case
    sheet: Sheet
    estimate: Estimate | None
    shortfall: str = ""


def pilot(case: Case, mesher: Mesher, tell: Tell, most: float | None = None) -> Found:
    """Return elements and steps for the accuracy of a case; collective.

    Steps are found first, with the coarsest elements, and then the elements, with few
    steps: the errors of both add up, so that each may have a half.

    Args:
        case: A case with an accuracy.
        mesher: Returns the sheet of a case.
        tell: Called with what is being done.
        most: Memory that a run may take, bytes; a share of the machine's if None.
    """
    assert case.accuracy is not None
    base = case.model_copy(update={"accuracy": None})
    whole = mesher(base)
    sized = discretised(base, mesh_size=_side(whole) / PARTS[0], degree=2)
    coarse, rough = _meshed(sized, mesher, whole)
    timed, pair = _steps(coarse, rough, case.accuracy / 2, tell)
    part = case.accuracy / 2 if pair else case.accuracy
    room = memory_of_machine() * ROOM if most is None else most
    return _elements(timed, pair, part, case.accuracy, mesher, room, tell, whole)


def _steps(case: Case, sheet: Sheet, wanted: float, tell: Tell) -> tuple[Case, Pair | None]:
    """Return the case with steps that are short enough, and the answers that show it."""
    if not case.needs.history or keeps_its_steps(case):
        return case, None
    found: Pair | None = None
    chosen, before = case, paced(case, SHARES[0] / 2)
    earlier: Trace | None = None
    for share in SHARES:
        trial = paced(case, share)
        tell(f"steps: {steps_in(trial)} in all")
        try:
            earlier = earlier or trace_of(before, sheet)
            trace = trace_of(trial, sheet)
        except (StepFailedError, StabilityLostError):
            before, earlier = trial, None
            continue
        found = Pair((steps_in(before), steps_in(trial)), (earlier, trace), scheme_of(case).order)
        chosen, before, earlier = trial, trial, trace
        if _worst(found.errors(), trace) <= wanted:
            break
    return chosen, found


def _elements(
    case: Case,
    pair: Pair | None,
    wanted: float,
    accuracy: float,
    mesher: Mesher,
    room: float,
    tell: Tell,
    whole: Sheet,
) -> Found:
    best: Found | None = None
    reason = "finer cells were not tried"
    failure: Failure | None = None
    for trial, sheet in _meshes(case, mesher, whole):
        traces: dict[int, Trace] = {}
        room_is_out = False
        for degree in DEGREES:
            degrees = degree - 1, degree, degree + 1
            need = memory(_unknowns(trial, sheet, degrees[-1]))
            if need > room:
                room_is_out = True
                reason = f"the next finer elements need {need / 1e9:.2g} GB of memory"
                break
            try:
                for p in degrees:
                    if p not in traces:
                        tell(f"elements: degree {p}, {_unknowns(trial, sheet, p)} unknowns")
                        traces[p] = trace_of(discretised(paced(trial, FEW), degree=p), sheet)
            except (StepFailedError, StabilityLostError) as error:
                failure = error
                break
            ladder = Ladder(degrees, tuple(traces[p] for p in degrees))
            found = combined(degree, ladder, pair)
            done = Found(discretised(trial, degree=degree), sheet, found)
            if best is None or best.estimate is None or found.worst < best.estimate.worst:
                best = done
            tell(f"degree {degree}: error {found.worst:.2%}")
            promised = _worst(ladder.errors(degrees[-1]), traces[degrees[-1]])
            if _is_sized(case) and promised > HOPELESS * wanted:
                break
            if found.worst <= accuracy and _worst(ladder.errors(degree), traces[degree]) <= wanted:
                return done
        if room_is_out:
            break
    if best is None:
        why = f"no trial got to its end: {failure}" if failure else reason
        return Found(discretised(case, degree=DEGREES[0]), mesher(case), None, why)
    assert best.estimate is not None
    short = "" if best.estimate.worst <= accuracy else reason
    return Found(best.case, best.sheet, best.estimate, short)


def _meshes(case: Case, mesher: Mesher, whole: Sheet) -> Iterator[tuple[Case, Sheet]]:
    """Yield the case with ever finer meshes; a mesh that was given stays."""
    for part in PARTS if _is_sized(case) else PARTS[:1]:
        yield _meshed(discretised(case, mesh_size=_side(whole) / part), mesher, whole)


def _meshed(case: Case, mesher: Mesher, whole: Sheet) -> tuple[Case, Sheet]:
    if not _is_sized(case):
        return discretised(case, mesh_size=None), whole
    return case, mesher(case)


def _is_sized(case: Case) -> bool:
    """Return whether the size of the cells can be chosen."""
    return not str(getattr(case.sheet, "file", "")).endswith(".msh")


def _side(sheet: Sheet) -> float:
    """Return the shorter side of a sheet's bounding box, m; collective."""
    x, comm = sheet.mesh.geometry.x, sheet.mesh.comm
    sides = [
        comm.allreduce(float(x[:, i].max()), op=MPI.MAX)
        - comm.allreduce(float(x[:, i].min()), op=MPI.MIN)
        for i in (0, 1)
    ]
    return float(min(sides))


def _unknowns(case: Case, sheet: Sheet, degree: int) -> int:
    return placements_on(sheet.mesh, degree, case.needs.placements, sheet.jumps).unknowns


def _worst(errors: dict[str, float], trace: Trace) -> float:
    """Return the largest error over its figure, of the figures that are not zero."""
    return max((abs(errors[k]) / abs(v) for k, v in trace.figures.items() if v), default=0.0)
