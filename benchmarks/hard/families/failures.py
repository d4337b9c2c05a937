"""Failure itself: reported with its cause, with everything before it intact."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.hard.pictures import draw_failures
from benchmarks.hard.row import Bound, Family, Figures, Row, Setting
from wovenfab.record.fields import read_fields
from wovenfab.record.history import read_history
from wovenfab.record.summary import read_summary
from wovenfab.study.runner import Command, execute

FAILED_STEP = 3
STEPS = ("program.to=80 mm", "program.steps=8")
#: An effect that is no number once the first family is stretched by 1 %.
NO_NUMBER = '''
"""Fails where the first family is stretched by 1 %."""

import ufl

from wovenfab.forms.effect import Effect, Parameter
from wovenfab.forms.kinematics import norm


def energy(point, values):
    """Return a tiny energy density (J/m^2) while there is room."""
    return values["stiffness"] * ufl.sqrt(1.01 - norm(point.f[0]))


EFFECT = Effect(
    name="breaking",
    summary="No number beyond a stretch of 1 %",
    parameters=(Parameter("stiffness", "N/m", "k"),),
    energy=energy,
)
'''
#: An effect that leaves one motion free: nothing acts on the second family.
ONE_FAMILY = '''
"""Resists stretching of the first family only, and says more."""

from wovenfab.forms.effect import Effect, Parameter
from wovenfab.forms.kinematics import norm


def energy(point, values):
    """Return the energy density (J/m^2)."""
    return values["stiffness"] / 2 * (norm(point.f[0]) - 1) ** 2


EFFECT = Effect(
    name="lying",
    summary="Stretch of one family",
    parameters=(Parameter("stiffness", "N/m", "k"),),
    energy=energy,
    resists=frozenset({"stretching", "shearing"}),
)
'''


def failing(effect: tuple[str, str, str] | None, setting: Setting) -> Figures:
    """Run a case that must fail, as a user does, and examine what is left; serial.

    Args:
        effect: Name, source and values of an effect of one's own, or None.
        setting: The case.
    """
    with TemporaryDirectory() as name:
        folder = Path(name)
        if effect is not None:
            (folder / f"{effect[0]}.py").write_text(effect[1], encoding="utf-8")
            own = f"effects.{effect[0]}={{file: {folder}/{effect[0]}.py, {effect[2]}}}"
            setting = setting.but(own)
        code, message = _run(setting, folder / "failed")
        history, summary = read_history(folder / "failed"), read_summary(folder / "failed")
        fields = read_fields(folder / "failed")
        last = float(history["time_s"][-1])
        finite = all(np.isfinite(column).all() for column in history.values())
        stored = [fields.field(n, i) for n in fields.units for i in range(len(fields.times))]
        whole = finite and all(np.isfinite(v).all() for v in stored)
    iterations = history["newton_iterations"][1:]
    place = re.search(r"x = ([-\d.e+]+) mm, y = ([-\d.e+]+) mm", message)
    series = {
        "displacement": history["displacement_m"].tolist(), "force": history["force_N"].tolist(),
        "place": [float(x) / 1e3 for x in place.groups()] if place else None,
        "diagnosis": message, "last": last,
    }  # fmt: skip
    return Figures(
        unknowns=summary["unknowns"], steps=len(iterations),
        mean=float(iterations.mean()) if len(iterations) else 0.0,
        worst=int(iterations.max(initial=0)), cutbacks=summary["cut_backs"],
        margin=None, imbalance=None, end=message, series=series,
    ).with_checks(
        exit_code=code, stored_fields=float(len(stored)), results_whole=float(whole),
        place_named=float(all((place, "shear angle" in message, "stretches" in message))),
    )  # fmt: skip


def _run(setting: Setting, directory: Path) -> tuple[int, str]:
    """Return exit code and message of ``wovenfab run``."""
    arguments = ["-m", "wovenfab", "run", str(setting.path), "-o", str(directory)]
    for override in (*setting.overrides, "output.pictures=false"):
        arguments += ["--set", override]
    ended = execute(Command(arguments))
    lines = [line for line in ended.errors.splitlines() if line.startswith("wovenfab:")]
    return ended.code, lines[-1] if lines else ended.errors[-500:]


def _row(
    name: str, title: str, hard: str, stops: str, *changes: str,
    effect: tuple[str, str, str] | None = None, steps: int = 0,
) -> Row:  # fmt: skip
    measure: Callable[[Setting], Figures] = partial(failing, effect)
    return Row(
        name=f"failure-{name}",
        title=title,
        hard=hard,
        remedy="state restored, step cut, run stopped with a diagnosis",
        setting=Setting(
            "bonded-1x3",
            (
                *(() if changes[0].startswith("program=") else STEPS),
                "discretisation.mesh_size=150 mm",
                "output.every=1",
                *changes,
            ),
        ),
        measure=measure,
        bounds=(
            Bound("exit code", most=FAILED_STEP, least=FAILED_STEP),
            Bound("steps", least=steps),
            Bound("stored fields", least=1),
            Bound("results whole", least=1),
            Bound("place named", least=1),
        ),
        stops=stops,
    )


FAMILY = Family(
    number=10,
    title="Failure itself",
    text=(
        "Each is a run of `wovenfab run` with something broken by means that a user has. Exit code "
        "3, a diagnosis that names the worst point with its shear angle, stretches and slip, and "
        "a history and fields that open, without a number that is not one."
    ),
    rows=(
        _row(
            "iterations", "iterations capped at 2, steps not to be cut below a half",
            "after four short steps a long one cannot converge", "the step is too large",
            "program=[{type: ramp, to: 1 mm, steps: 4}, {type: ramp, to: 400 mm, steps: 1}]",
            "solver.max_iterations=2", "time.smallest_step=0.5", steps=4,
        ),
        _row(
            "factorisation", "16 000 unknowns, 1 MB for the factorisation",
            "the factorisation fails from the start", "the factorisation failed",
            "discretisation.mesh_size=16 mm", "solver.petsc.mat_mumps_icntl_23=1",
            "time.smallest_step=0.5",
        ),
        _row(
            "nan", "an effect that is no number beyond a stretch of 1 %",
            "the residual is not a number", "the energy of breaking is not a number",
            "program.to=300 mm", effect=("breaking", NO_NUMBER, "stiffness: 1e-3"), steps=3,
        ),
        _row(
            "singular", "a sheet of which one family feels nothing",
            "the tangent is singular", "the stiffness is singular",
            "effects.stretch=null", "effects.bending=null", "effects.shear=null",
            "discretisation.penalty=null",
            effect=("lying", ONE_FAMILY, "stiffness: 1e8"),
        ),
        _row(
            "smallest-step", "locking, and steps not to be cut below 1/8",
            "the time step at its minimum", "the sheet locks",
            "sheet.length=600 mm", "program.to=300 mm", "program.steps=30",
            "time.smallest_step=0.125", steps=10,
        ),
    ),
    draw=draw_failures,
)  # fmt: skip
