"""Past the critical load: stop there, follow the branch, or ignore it."""

from __future__ import annotations

import re
from functools import cache
from math import pi

import numpy as np
import pytest

from tests import scenes
from wovenfab.model.model import Model
from wovenfab.stepping.program import cycle, program_of, ramp
from wovenfab.stepping.stability import StabilityLostError
from wovenfab.stepping.state import State

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


def side(field: np.ndarray) -> float:
    """Return the largest deflection across the yarns with its sign."""
    return float(field[1::2][np.abs(field[1::2]).argmax()])


def test_stop_ends_at_the_last_minimum_and_says_where_and_at_which_load() -> None:
    model = sheet()
    run = scenes.push(model, FAR, "stop")
    assert isinstance(run.failure, StabilityLostError)
    loss, last = run.failure.loss, run.steps[-1]
    assert (model.field.x.array == run.fields[-1]).all()
    assert (loss.time, loss.displacement) == (last.time, last.displacement)
    assert not any(s.negatives for s in run.steps)
    assert loss.negatives == 1
    assert 0 < loss.increment < 2e-3 * loss.displacement
    assert loss.step == pytest.approx(loss.increment / 4e-3)
    assert loss.reactions == last.reactions
    assert -loss.reactions["right"][0] == pytest.approx(EULER, rel=0.05)  # six cells
    assert re.fullmatch(
        r"the sheet loses its stability at t = [\d.e-]+ s \(displacement 0\.0\d+ mm, known to "
        r"[\d.e-]+ mm\) under a force of \d+\.?\d* N; "
        r"solver\.stability=follow goes on along the branch",
        str(run.failure),
    )


def test_ignore_stays_on_the_saddle_and_counts() -> None:
    run = scenes.push(sheet(), FAR, "ignore")
    assert run.failure is None
    counts = [s.negatives for s in run.steps]
    assert counts[0] == 0 and min(counts[1:]) >= 1 and counts == sorted(counts)
    assert abs(side(run.fields[-1])) < 1e-9


@pytest.mark.parametrize("names", [scenes.BONDED, scenes.COUPLED, FRICTION], ids=len)
def test_follow_accepts_only_minima_and_stays_below_the_saddles(names: tuple[str, ...]) -> None:
    scheme = "bdf2" if names == FRICTION else "backward-euler"
    run = scenes.push(sheet(names), FAR, "follow", scheme=scheme)
    saddles = scenes.push(sheet(names), FAR, "ignore", scheme=scheme).steps
    assert run.failure is None
    assert not any(s.negatives for s in run.steps)
    (loss,) = [s.loss for s in run.steps if s.loss]
    planned = [s for s in run.steps if s.milestone]
    assert [s.time for s in planned] == [s.time for s in saddles]
    for branch, trivial in zip(planned[1:], saddles[1:], strict=True):
        assert branch.displacement == trivial.displacement > loss.displacement
        assert scenes.stored(branch) < 0.2 * scenes.stored(trivial)
    sides = [side(f) for f in run.fields if abs(side(f)) > 1e-5]
    assert len(sides) > 5
    assert (np.sign(sides) == np.sign(sides[0])).all()  # never over to the other branch
    assert (np.diff(np.abs(sides)) > 0).all()


def test_equal_seeds_give_equal_branches_and_some_seed_the_other() -> None:
    seeds = (0, 0, 1, 2, 3)
    ends = [scenes.push(sheet(), NEAR, "follow", seed=seed).fields[-1] for seed in seeds]
    assert (ends[0] == ends[1]).all()
    assert {np.sign(side(end)) for end in ends} == {1.0, -1.0}
    for end in ends:  # mirror images
        assert abs(side(end)) == pytest.approx(abs(side(ends[0])), rel=1e-6)


def test_a_branch_leads_back_to_the_straight_sheet_and_buckles_again() -> None:
    there_and_back = program_of([*cycle(0.0, 2e-3, 1.0, 8), *cycle(0.0, 2e-3, 1.0, 8)])
    run = scenes.push(sheet(), there_and_back, "follow")
    assert run.failure is None
    assert not any(s.negatives for s in run.steps)
    assert any(s.loss for s in run.steps)
    states = list(zip(run.steps, map(side, run.fields), strict=True))
    ends = [end for _, end in there_and_back.cycles]
    assert [abs(across) < 1e-8 for s, across in states if s.time in ends] == [True, True]
    peaks = [abs(across) > 0.02 for s, across in states if s.displacement == 2e-3]
    assert peaks == [True, True]


def test_the_way_back_is_that_of_the_branch_that_a_step_has_snapped_to(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The last step there ends on the mirror image of the branch: both its ends are minima."""
    program, peak, guess = program_of(cycle(0.0, 2e-3, 1.0, 16)), 0.5, State._guess

    def pushed(seed: int) -> scenes.Run:
        run = scenes.push(sheet(), program, "follow", seed=seed)
        assert run.failure is None
        return run

    def at_peak(run: scenes.Run) -> np.ndarray:
        return run.fields[[s.time for s in run.steps].index(peak)]

    ends = [at_peak(pushed(seed)) for seed in range(4)]
    mirrored = next(end for end in ends if side(end) * side(ends[0]) < 0)
    monkeypatch.setattr(
        State, "_guess", lambda s, t, *to: mirrored if t == peak else guess(s, t, *to)
    )
    run = pushed(0)
    assert at_peak(run) == pytest.approx(mirrored, abs=1e-8)
    planned = [(s, side(f)) for s, f in zip(run.steps, run.fields, strict=True) if s.milestone]
    there, back = planned[4:8], planned[-5:-9:-1]
    for (step, across), (later, mirror) in zip(there, back, strict=True):
        assert step.time < peak < later.time
        assert later.displacement == pytest.approx(step.displacement)
        assert mirror == pytest.approx(-across, rel=1e-6) and abs(across) > 0.01


@pytest.mark.parametrize("names", [scenes.BONDED, FRICTION], ids=["bonded", "friction"])
def test_a_bias_sheet_stays_stable_pulled_and_pushed(names: tuple[str, ...]) -> None:
    """Shear gives way before it can buckle; this is the default case with a coarse mesh."""
    numerics = scenes.PROTOTYPE_TWO_STEPS if names == FRICTION else scenes.PROTOTYPE
    model = scenes.model(scenes.sheet(mesh_size=0.3), names, numerics)
    for grips in (scenes.PULL, scenes.PUSH):
        program = program_of(cycle(0.0, 0.04, 0.25, 16))
        scheme = "bdf2" if names == FRICTION else "backward-euler"
        run = scenes.push(model, program, "stop", scheme=scheme, grips=grips)
        assert run.failure is None
        assert len(run.steps) == 17
        assert not any(s.negatives or s.cutbacks for s in run.steps)
