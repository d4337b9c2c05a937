"""A march that is pushed past the critical load: stop there, follow the branch, or ignore it."""

from __future__ import annotations

import re
from functools import cache
from math import pi

import numpy as np
import pytest

from tests import scenes
from wovenfab.model.constraints import Grip
from wovenfab.model.model import Model
from wovenfab.solver.problem import SolverOptions
from wovenfab.stepping.program import Program, cycle, program_of, ramp
from wovenfab.stepping.schemes import SCHEMES
from wovenfab.stepping.stability import StabilityLostError, Treatment
from wovenfab.stepping.step import Step
from wovenfab.stepping.time_stepper import TimeStepper

FRICTION = (*scenes.COUPLED, "slip_friction")
#: Far beyond the critical load, which is met at 0.03 mm, and not so far.
FAR = program_of([ramp(0.0, 4e-3, 1.0, 3)])
NEAR = program_of([ramp(0.0, 1e-4, 1.0, 1)])
#: Yarns that the clamps do not hold in direction are hinged columns, whose load this is (N),
#: were the mesh fine.
EULER = 0.3 * (pi**2 * 254.1 / 0.81 + 400)


@cache
def sheet(names: tuple[str, ...] = scenes.BONDED) -> Model:
    numerics = scenes.PROTOTYPE if names == scenes.BONDED else scenes.PROTOTYPE_TWO_STEPS
    return scenes.model(scenes.sheet(fibres=scenes.ALONG), names, numerics)


def march(
    model: Model,
    treatment: Treatment,
    program: Program = FAR,
    grips: tuple[Grip, ...] = scenes.PUSH,
    seed: int = 0,
    scheme: str = "backward-euler",
) -> tuple[list[Step], list[np.ndarray], StabilityLostError | None]:
    """Return the steps, the field at each, and the error that ended the march."""
    model.field.x.array[:] = 0
    options = SolverOptions(descend=treatment == "follow", seed=seed)
    equilibrium = scenes.solver(model, grips, options)
    marching = TimeStepper(equilibrium, program, SCHEMES[scheme], 1 / 1024, treatment)
    steps, fields, failure = [], [], None
    try:
        for step in marching.steps():
            steps.append(step)
            fields.append(model.field.x.array.copy())
    except StabilityLostError as error:
        failure = error
    equilibrium.destroy()
    return steps, fields, failure


def energy(step: Step) -> float:
    return sum(step.stored.values())


def side(field: np.ndarray) -> float:
    """Return the largest deflection across the yarns with its sign."""
    return float(field[1::2][np.abs(field[1::2]).argmax()])


def test_stop_ends_at_the_last_minimum_and_says_where_and_at_which_load() -> None:
    model = sheet()
    steps, fields, failure = march(model, "stop")
    assert failure is not None
    loss, last = failure.loss, steps[-1]
    assert (model.field.x.array == fields[-1]).all()
    assert (loss.time, loss.displacement) == (last.time, last.displacement)
    assert [s.negatives for s in steps] == [0] * len(steps)
    assert loss.negatives == 1
    assert 0 < loss.increment < 2e-3 * loss.displacement
    assert loss.step == pytest.approx(loss.increment / 4e-3)
    assert loss.reactions == last.reactions
    assert -loss.reactions["right"][0] == pytest.approx(EULER, rel=0.05)  # six cells
    assert re.fullmatch(
        r"the sheet loses its stability at t = [\d.e-]+ s \(displacement 0\.0\d+ mm, known to "
        r"[\d.e-]+ mm\) under a force of \d+\.?\d* N; "
        r"solver\.stability=follow goes on along the branch",
        str(failure),
    )


def test_ignore_stays_on_the_saddle_and_counts() -> None:
    steps, fields, failure = march(sheet(), "ignore")
    assert failure is None
    counts = [s.negatives for s in steps]
    assert counts[0] == 0 and min(counts[1:]) >= 1 and counts == sorted(counts)
    assert abs(side(fields[-1])) < 1e-9


@pytest.mark.parametrize("names", [scenes.BONDED, scenes.COUPLED, FRICTION], ids=len)
def test_follow_accepts_only_minima_and_stays_below_the_saddles(names: tuple[str, ...]) -> None:
    scheme = "bdf2" if names == FRICTION else "backward-euler"
    steps, fields, failure = march(sheet(names), "follow", scheme=scheme)
    saddles, _, _ = march(sheet(names), "ignore", scheme=scheme)
    assert failure is None
    assert [s.negatives for s in steps] == [0] * len(steps)
    losses = [s.loss for s in steps if s.loss]
    assert len(losses) == 1
    planned = [s for s in steps if s.milestone]
    assert [s.time for s in planned] == [s.time for s in saddles]
    for branch, trivial in zip(planned[1:], saddles[1:], strict=True):
        assert branch.displacement == trivial.displacement > losses[0].displacement
        assert energy(branch) < 0.2 * energy(trivial)
    sides = [side(f) for f in fields if abs(side(f)) > 1e-5]
    assert len(sides) > 5
    assert (np.sign(sides) == np.sign(sides[0])).all()  # never over to the other branch
    assert (np.diff(np.abs(sides)) > 0).all()


def test_equal_seeds_give_equal_branches_and_some_seed_the_other() -> None:
    ends = [march(sheet(), "follow", NEAR, seed=seed)[1][-1] for seed in (0, 0, 1, 2, 3)]
    assert (ends[0] == ends[1]).all()
    assert {np.sign(side(end)) for end in ends} == {1.0, -1.0}
    for end in ends:  # mirror images
        assert abs(side(end)) == pytest.approx(abs(side(ends[0])), rel=1e-6)


def test_a_branch_leads_back_to_the_straight_sheet_and_buckles_again() -> None:
    there_and_back = program_of([*cycle(0.0, 2e-3, 1.0, 8), *cycle(0.0, 2e-3, 1.0, 8)])
    steps, fields, failure = march(sheet(), "follow", there_and_back)
    assert failure is None
    assert [s.negatives for s in steps] == [0] * len(steps)
    assert [s for s in steps if s.loss]
    ends = [end for _, end in there_and_back.cycles]
    back = [i for i, s in enumerate(steps) if s.time in ends]
    assert [abs(side(fields[i])) < 1e-8 for i in back] == [True, True]
    peaks = [i for i, s in enumerate(steps) if s.displacement == 2e-3]
    assert [abs(side(fields[i])) > 0.02 for i in peaks] == [True, True]


@pytest.mark.parametrize("names", [scenes.BONDED, FRICTION], ids=["bonded", "friction"])
def test_a_bias_sheet_stays_stable_pulled_and_pushed(names: tuple[str, ...]) -> None:
    """Shear gives way before it can buckle; this is the default case with a coarse mesh."""
    numerics = scenes.PROTOTYPE_TWO_STEPS if names == FRICTION else scenes.PROTOTYPE
    model = scenes.model(scenes.sheet(mesh_size=0.3), names, numerics)
    for grips in (scenes.PULL, scenes.PUSH):
        program = program_of(cycle(0.0, 0.04, 0.25, 16))
        scheme = "bdf2" if names == FRICTION else "backward-euler"
        steps, _, failure = march(model, "stop", program, grips, scheme=scheme)
        assert failure is None
        assert len(steps) == 17
        assert not any(s.negatives or s.cutbacks for s in steps)
