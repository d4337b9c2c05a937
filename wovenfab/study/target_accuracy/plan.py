"""Elements and steps that reach a wanted accuracy, found by estimating errors."""

from __future__ import annotations

from dataclasses import replace

from wovenfab.case import Case
from wovenfab.simulation.progress import memory_of_machine
from wovenfab.simulation.response import brief, discretised
from wovenfab.study.target_accuracy.cost_model import Limits
from wovenfab.study.target_accuracy.mesh import COARSEST, Mesher, Plan, mesh_for, meshed, side
from wovenfab.study.target_accuracy.time_steps import Tell, steps_for

#: Share of the machine's memory that a run may take.
ROOM = 0.6
#: Share of the accuracy that is aimed at, for estimates are not exact; the largest share of that
#: which elements may use where steps have an error, too: finer cells cost more than more steps.
AIM, OF_ELEMENTS = 0.8, 0.75


def plan(case: Case, mesher: Mesher, tell: Tell, limits: Limits | None = None) -> Plan:
    """Return elements and steps for the accuracy of a case; collective.

    Elements are found first, with few steps, and then the steps, with coarse elements: the
    errors of both add up. Of several cycles the largest is tried.

    Args:
        case: A case with an accuracy.
        mesher: Returns the sheet of a case.
        tell: Called with what is being done.
        limits: Of memory and time; a share of the machine's memory if None.
    """
    assert case.accuracy is not None
    base = case.model_copy(update={"accuracy": None})
    whole = mesher(base)
    limits = limits or Limits(memory_of_machine() * ROOM)
    aim = AIM * case.accuracy
    share = OF_ELEMENTS if base.needs.history else 1.0
    found = mesh_for(base, share * aim, mesher, limits, tell, whole)
    if found.reachable:
        able = f"about {100 * found.reachable / (share * AIM):.2g} % can be asked for"
        found = replace(found, shortfall=f"{found.shortfall}; {able}")
    if found.estimate is None:
        return found
    coarse = discretised(base, mesh_size=side(whole) / COARSEST, degree=2)
    coarse, rough = meshed(coarse, mesher, whole)
    error = found.estimate.worst
    left = max(aim - error, (1 - OF_ELEMENTS) * max(aim, error))
    paced = steps_for(found.case, brief(coarse, left), rough, left, tell)
    if paced is None:
        return found
    estimate = replace(found.estimate, time=paced.errors)
    reason = found.shortfall if estimate.worst > case.accuracy else ""
    if not reason and estimate.worst > case.accuracy:
        reason = "shorter steps were not tried"
    return replace(found, case=paced.case, estimate=estimate, shortfall=reason)
