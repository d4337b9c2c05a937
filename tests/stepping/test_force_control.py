"""Force control: a displacement-controlled loop is found again from its forces."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from tests.scenes import (
    BONDED,
    CLAMP,
    PROTOTYPE,
    PROTOTYPE_TWO_STEPS,
    SCHEMES,
    TABLE_1,
    model,
    sheet,
    solver,
)
from wovenfab import CaseError, read_case, simulate
from wovenfab.case.objects import differentiate, sheet_of, simulation_of
from wovenfab.forms.effect import Target
from wovenfab.model.constraints import Grip, Held
from wovenfab.stepping.program import Program, cycle, program_of, ramp, table
from wovenfab.stepping.stability import StabilityLostError
from wovenfab.stepping.step import Step
from wovenfab.stepping.time_stepper import TimeStepper

CONFIGS = Path(__file__).parents[2] / "configs"
COARSE = {"discretisation.degree": "2", "discretisation.mesh_size": "150 mm"}
SMALLEST = 1 / 64
LAWS = {
    "bonded": BONDED,
    "slip": (*BONDED, "coupling", "slip_friction"),
    "spin": (*BONDED, "spin_friction"),
    "coulomb": (*BONDED, "coupling", "slip_friction:coulomb"),
}


def forced(names: tuple[str, ...], scheme: str, program: Program) -> tuple[list[Step], list[float]]:
    """Return all steps, and the force (N) on the right edge where each has its equilibrium."""
    numerics = PROTOTYPE if scheme == "backward-euler" else PROTOTYPE_TWO_STEPS
    equilibrium = solver(model(sheet(), names, numerics))
    stepper = TimeStepper(equilibrium, program, SCHEMES[scheme], SMALLEST)
    stepper.control_force()
    steps, forces = [], []
    for step in stepper.steps():
        steps.append(step)
        forces.append(equilibrium.problem.reactions()["right"][0])
    equilibrium.destroy()
    return steps, forces


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("law", "scheme"),
    [
        pytest.param("bonded", "bdf2", marks=pytest.mark.slow),
        ("slip", "bdf2"),
        ("slip", "midpoint"),
        pytest.param("slip", "backward-euler", marks=pytest.mark.slow),
        pytest.param("spin", "bdf2", marks=pytest.mark.slow),
        pytest.param("coulomb", "bdf2", marks=pytest.mark.slow),
    ],
)
def test_the_displacements_of_a_loop_are_found_from_its_forces(law: str, scheme: str) -> None:
    steps, forces = forced(LAWS[law], scheme, program_of(cycle(0.0, 0.02, 0.2, 12)))
    targets, stage = [0.0], SCHEMES[scheme].stage
    for force in forces[1:]:
        targets.append(targets[-1] + (force - targets[-1]) / stage)
    times = [step.time for step in steps]
    again, _ = forced(LAWS[law], scheme, program_of(table(0.0, times, targets, force=True)))
    assert [step.time for step in again] == times
    found, wanted = (np.array([s.displacement for s in run]) for run in (again, steps))
    assert np.abs(found - wanted).max() <= 1e-6 * np.abs(wanted).max()


def test_a_held_force_creeps_and_a_displacement_held_after_it_stays() -> None:
    program = (
        "[{type: ramp, to: 100 N, duration: 0.1 s, steps: 4}, {type: hold, duration: 1 s, "
        "steps: 6}, {type: hold, duration: 1 s, steps: 3, control: displacement}, "
        "{type: ramp, to: 0 N, duration: 0.1 s, steps: 4}]"
    )
    run = simulate(read_case(CONFIGS / "bias-1x3.yaml", {**COARSE, "program": program}))
    force, moved = run.history["force"], run.history["displacement"]
    assert force[4:11] == pytest.approx(100.0, rel=1e-6)
    assert moved[10] > 1.05 * moved[4]
    assert set(moved[10:14]) == {moved[10]}
    assert force[-1] == pytest.approx(0.0, abs=1e-5)


def test_a_force_is_as_exact_as_the_solver_and_takes_few_more_steps() -> None:
    program = (
        "[{type: ramp, to: 100 N, duration: 1 s, steps: 4}, {type: hold, duration: 1 s, steps: 4}]"
    )
    case = read_case(CONFIGS / "bias-1x3.yaml", {**COARSE, "program": program})
    histories = {
        tolerance: simulate(case.changed(f"solver.tolerance={tolerance}")).history
        for tolerance in (1e-9, 1e-5, 1e-3)
    }
    for tolerance, history in histories.items():
        assert history["force"][-1] == pytest.approx(100.0, rel=max(1e-6, tolerance))
        assert len(history["step"]) <= 2 * len(histories[1e-9]["step"])


def test_a_force_that_rounding_makes_uncertain_is_good_enough() -> None:
    """Yarns along the force so stiff that rounded positions make a millionth of a newton."""
    program = ", ".join(f"{{type: ramp, to: {f} N, duration: 1 s, steps: 4}}" for f in (1, 0.5))
    stiff = {"effects.stretch.stiffness": "1e11 N/m", "sheet.fibres": "[0 deg, 90 deg]"}
    mesh = {"discretisation.degree": "3", "discretisation.mesh_size": "60 mm"}
    case = read_case(CONFIGS / "bias-1x3.yaml", {"program": f"[{program}]", **stiff, **mesh})
    history = simulate(case).history
    assert len(history["step"]) <= case.planned_steps + 2
    assert history["force"][[-5, -1]] == pytest.approx([1.0, 0.5], rel=1e-5)


def test_a_force_beyond_a_limit_point_is_refused_and_the_largest_one_is_found() -> None:
    """Yarns askew to the clamps are compressed as these move past each other, then released."""
    values = {**TABLE_1, "stretch": {"stiffness": (1e5, 0.0)}, "shear": {"stiffness": 1.0}}
    on = sheet(0.1, 0.3, 0.05, fibres=(0.35, 0.35 - np.pi / 2))
    past = Grip("left", CLAMP), Grip("right", (Held(), Held(-1.0)))

    def steps(program: Program, force: bool) -> Iterator[Step]:
        equilibrium = solver(model(on, BONDED, PROTOTYPE, values), past)
        stepper = TimeStepper(equilibrium, program, SCHEMES["backward-euler"], SMALLEST)
        if force:
            stepper.control_force()
        try:
            yield from stepper.steps()
        finally:
            equilibrium.destroy()

    moved = list(steps(program_of([ramp(0.0, 0.03, 1.0, 30)]), force=False))
    peak = max(moved, key=lambda s: s.force)
    assert moved[-1].force < peak.force / 2
    largest, forced = 2 * peak.force, [moved[0]]
    with pytest.raises(StabilityLostError) as lost:
        for step in steps(program_of(table(0.0, [0.0, 1.0], [0.0, largest], force=True)), True):
            forced.append(step)
    last = forced[-1]
    assert peak.force - 2 * SMALLEST * largest < last.force < 1.01 * peak.force
    assert lost.value.loss.displacement == last.displacement < peak.displacement + 0.001
    assert lost.value.loss.force == last.force
    curve = np.array([(s.displacement, s.force) for s in moved]).T
    found = np.interp([s.displacement for s in forced], *curve)
    assert np.abs(found - [s.force for s in forced]).max() < 0.01 * peak.force


@pytest.mark.parametrize(
    ("program", "words"),
    [
        ("{type: cycles, amplitudes: [5 N, 1 mm], frequency: 1 Hz}", "all lengths or all forces"),
        ("{type: cycles, amplitudes: 5 N, max_velocity: 1 m/s}", "has a frequency"),
        ("{type: ramp, to: 5 N, velocity: 1 m/s}", "has a duration"),
        (
            "[{type: ramp, to: 5 N, duration: 1 s}, {type: ramp, to: 1 mm, velocity: 1 m/s}]",
            "is not known",
        ),
        (
            "[{type: ramp, to: 5 N, duration: 1 s}, "
            "{type: trapezoid, to: 1 mm, velocity: 1 m/s, hold: 1 s}]",
            "Ramp to a displacement first",
        ),
    ],
)
def test_a_program_of_forces_that_cannot_be_is_refused(program: str, words: str) -> None:
    with pytest.raises(CaseError, match=words):
        read_case(
            CONFIGS / "bias-1x3.yaml",
            ["program=null", f"program={program}"],
        )


def test_derivatives_under_a_prescribed_force_are_refused() -> None:
    case = read_case(CONFIGS / "force-cycles.yaml", COARSE)
    refused = pytest.raises(CaseError, match="not available where a force is prescribed")
    with simulation_of(case, sheet_of(case, MPI.COMM_SELF)) as simulation, refused:
        differentiate(simulation, case, [Target("shear", "stiffness")])
