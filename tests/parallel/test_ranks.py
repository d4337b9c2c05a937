"""On several ranks the result is that of one: forces, energies, iterations, failures.

Every rank solves the same scene alone as well, on a communicator of its own. Forms are
compiled by all ranks together first, so that no two compile the same one.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from itertools import count
from pathlib import Path
from time import sleep
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from tests import scenes
from wovenfab.case import read_case
from wovenfab.case.objects import sheet_of, simulation_of
from wovenfab.compat import NOT_FINITE
from wovenfab.model.model import Model, Numerics
from wovenfab.parallel import compute_on_root
from wovenfab.sheet.geometry_file import GeometryFile, from_file
from wovenfab.sheet.gmsh_io import graded_rectangle
from wovenfab.sheet.sheet import GeometryError, Sheet, directions
from wovenfab.solver.problem import SolverOptions
from wovenfab.stepping.program import Program, cycle, program_of, ramp
from wovenfab.stepping.stability import StabilityLoss
from wovenfab.stepping.step import Step, StepFailedError

pytestmark = [pytest.mark.mpi, pytest.mark.mpi4]
COMM, ALONE = MPI.COMM_WORLD, MPI.COMM_SELF
MESHES, CONFIGS = (Path(__file__).parents[2] / folder for folder in ("meshes", "configs"))
SLIDING = (*scenes.COUPLED, "slip_friction")
ONE_CYCLE = program_of(cycle(0.0, 0.04, 0.25, 8))
Place = Callable[[MPI.Comm], Sheet]


def structured(comm: MPI.Comm) -> Sheet:
    return scenes.sheet(mesh_size=0.075, comm=comm)


def dogbone(comm: MPI.Comm) -> Sheet:
    return Sheet(
        *from_file(comm, GeometryFile(MESHES / "dogbone.geo"), 0.06), directions(scenes.BIAS)
    )


def graded(comm: MPI.Comm) -> Sheet:
    parts = graded_rectangle(comm, 0.9, 0.3, 0.1, 0.02)
    return Sheet(*parts, directions(scenes.BIAS))


def numbers(steps: list[Step]) -> list[dict[str, float]]:
    """Return forces, energies and work of each step by name."""
    return [
        {
            **{f"{e} {i}": f[i] for e, f in s.reactions.items() for i in (0, 1)},
            **{f"stored {n}": v for n, v in s.stored.items()},
            **{f"dissipated {n}": v for n, v in s.dissipated.items()},
            "work": s.work,
        }
        for s in steps
    ]


def compare(
    place: Place,
    names: tuple[str, ...],
    numerics: Numerics,
    program: Program,
    scheme: str,
    values: Mapping[str, Any] = scenes.TABLE_1,
    options: SolverOptions | None = None,
) -> None:
    """Assert that all ranks together and each alone run through the same states."""
    models = [scenes.model(place(comm), names, numerics, values) for comm in (COMM, ALONE)]
    assert models[0].unknowns == models[1].unknowns
    together, alone = (scenes.march(m, program, scheme, options=options) for m in models)
    assert [s.iterations for s in together] == [s.iterations for s in alone]
    assert [s.time for s in together] == [s.time for s in alone]
    peak = max(abs(f) for s in alone for f in s.reactions["right"])
    energy = max(scenes.stored(s) for s in alone)
    for shared, expected in zip(numbers(together), numbers(alone), strict=True):
        assert shared.keys() == expected.keys()
        for key, value in expected.items():
            scale = peak if key[-1] in "01" else energy
            assert shared[key] == pytest.approx(value, rel=1e-8, abs=1e-8 * scale), key
    assert COMM.allgather(numbers(together)) == [numbers(together)] * COMM.size
    assert energy > 0 and peak > 100


@pytest.mark.parametrize(
    "place", [graded, dogbone, pytest.param(structured, marks=pytest.mark.slow)]
)
def test_a_bonded_sheet_has_the_same_forces_energies_and_iterations(place: Place) -> None:
    program = program_of([ramp(0.0, 0.04, 1.0, 4)])
    compare(place, scenes.BONDED, scenes.PROTOTYPE, program, "backward-euler")


def test_factors_that_are_kept_lead_to_the_same_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wovenfab.solver.linear.OPERATIONS_PER_USE", 4.0)  # as of a large sheet
    program = program_of(cycle(0.0, 0.04, 0.25, 20))
    compare(structured, SLIDING, scenes.PROTOTYPE_TWO_STEPS, program, "bdf2")


@pytest.mark.parametrize("names", [scenes.BONDED, SLIDING], ids=["one", "two placements"])
def test_grips_that_several_ranks_share_have_the_same_reactions(names: tuple[str, ...]) -> None:
    """A broad sheet, which is cut across its grips; elsewhere ranks have one grip each."""

    def broad(comm: MPI.Comm) -> Sheet:
        return scenes.sheet(0.2, 1.6, 0.1, comm=comm)

    on = broad(COMM)
    own = on.mesh.topology.index_map(1).size_local
    holders = COMM.allgather(bool((on.edge_facets("left") < own).any()))
    assert sum(holders) > 1
    program = program_of([ramp(0.0, 1e-3, 1.0, 2)])
    compare(broad, names, scenes.PROTOTYPE_TWO_STEPS, program, "bdf2")


def test_displacements_by_a_formula_are_attained_on_every_rank() -> None:
    """Ranks round the position of a node that they share differently: its owner's value counts."""
    case = read_case(CONFIGS / "picture-frame.yaml", ["program.to=7.5 mm", "program.steps=1"])
    with simulation_of(case, sheet_of(case, COMM)) as simulation:
        result = simulation.run()
        assert result.failure is None and result.cutbacks == 0
        assert not simulation.solver.problem.constraints.unmet(simulation.model.field)


@pytest.mark.parametrize(
    ("place", "scheme"),
    [
        (structured, "midpoint"),
        pytest.param(structured, "bdf2", marks=pytest.mark.slow),
        pytest.param(graded, "bdf2", marks=pytest.mark.slow),
    ],
)
def test_two_placements_with_slip_friction_have_the_same_loop(place: Place, scheme: str) -> None:
    compare(place, SLIDING, scenes.PROTOTYPE_TWO_STEPS, ONE_CYCLE, scheme)


@pytest.mark.parametrize(
    ("kind", "strength", "slope"),
    [
        ("slip_friction:coulomb", 2e4, 1.0),
        pytest.param("spin_friction:coulomb", 100.0, 1.0, marks=pytest.mark.slow),
        pytest.param("slip_friction:smooth", 1e4, 1e6, marks=pytest.mark.slow),
    ],
)
def test_friction_at_points_has_the_same_loop(kind: str, strength: float, slope: float) -> None:
    """The last one begins with its stress as a function of the rate, which is too sharp.

    A reversal by the whole stroke takes as many iterations as are allowed, one more or less by
    rounding; so the cycle has more steps.
    """
    values = {**scenes.TABLE_1, kind[:13]: {"strength": strength, "slope": slope}}
    names, numerics = (*scenes.COUPLED, kind), scenes.PROTOTYPE_TWO_STEPS
    program = program_of(cycle(0.0, 0.04, 0.25, 8))
    compare(lambda comm: scenes.sheet(comm=comm), names, numerics, program, "bdf2", values)


def wavy_sheet(comm: MPI.Comm, names: tuple[str, ...] = scenes.BONDED) -> Model:
    """Return a smooth, strongly deformed sheet; its state does not depend on the numbering."""
    model = scenes.model(structured(comm), names, scenes.PROTOTYPE)
    scenes.set_field(
        model.field,
        lambda x: np.array([0.03 * np.sin(9 * x[0] + 5 * x[1]), 0.02 * np.cos(7 * x[0] * x[1])]),
    )
    return model


@pytest.mark.parametrize("names", [scenes.BONDED, scenes.COUPLED], ids=["one", "two placements"])
def test_the_assembled_force_is_the_same_at_every_place(names: tuple[str, ...]) -> None:
    states = []
    for comm in (COMM, ALONE):
        model = wavy_sheet(comm, names)
        force = scenes.internal_force(model).reshape(-1, 2)
        places = model.placements.positions[: len(force)]
        if comm.size > 1:
            force = np.concatenate(comm.allgather(force))
            places = np.concatenate(comm.allgather(places))
        order = np.lexsort(np.round(places, 9).T)
        states.append((places[order], force[order], scenes.energy(model)))
    (places, force, energy), (expected_places, expected, alone) = states
    assert places == pytest.approx(expected_places, abs=1e-12)
    assert force == pytest.approx(expected, rel=1e-9, abs=1e-12 * np.abs(expected).max())
    assert energy == pytest.approx(alone, rel=1e-12)


def test_swapping_the_sides_of_facets_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ranks may see the sides of a shared facet in different order."""
    as_built = scenes.internal_force(wavy_sheet(COMM))
    scenes.swap_sides(monkeypatch)
    other = scenes.internal_force(wavy_sheet(COMM))
    assert other == pytest.approx(as_built, rel=1e-9, abs=1e-12 * np.abs(as_built).max())


def failed(program: Program, options: SolverOptions) -> tuple[int, str, bool]:
    """Return accepted steps, the failure's message and whether the field was restored."""
    model = scenes.model(scenes.sheet(0.6, mesh_size=0.075), scenes.BONDED, scenes.PROTOTYPE)
    run = scenes.run(model, program, options, 0.4)
    assert isinstance(run.failure, StepFailedError)
    restored = bool((model.field.x.array == run.fields[-1]).all())
    return len(run.steps), str(run.failure), restored


def test_a_failure_at_the_barrier_reaches_every_rank_alike() -> None:
    program = program_of([ramp(0.0, 0.02, 1.0, 2), ramp(0.02, 5.0, 1.0, 1)])
    accepted, message, restored = failed(program, SolverOptions(max_iterations=8))
    assert accepted >= 3 and restored
    assert COMM.allgather((accepted, message, restored)) == [(accepted, message, True)] * COMM.size


def test_a_nan_on_one_rank_stops_all_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    here = slice(None) if COMM.rank == COMM.size - 1 else slice(0)
    scenes.spoil_residuals(monkeypatch, range(10**6), here)
    program = program_of([ramp(0.0, 0.02, 1.0, 2)])
    accepted, message, _ = failed(program, SolverOptions())
    assert accepted == 1
    assert NOT_FINITE in message
    assert COMM.allgather(message) == [message] * COMM.size


def test_the_step_limit_is_that_of_the_worst_rank() -> None:
    limits = []
    for comm in (COMM, ALONE):
        model = scenes.model(structured(comm), scenes.BONDED, scenes.PROTOTYPE)
        equilibrium = scenes.solver(model)
        # Families cross first near the right end, on one rank.
        scenes.set_field(
            equilibrium.crossing.direction,
            lambda x: np.array([0.2 * x[0] ** 3, -0.3 * x[0] ** 2 * x[1]]),
        )
        limits.append(equilibrium.crossing.limit(equilibrium.crossing.direction.x.array))
        equilibrium.destroy()
    assert np.isfinite(limits[1])
    assert limits[0] == pytest.approx(limits[1], rel=1e-12)
    assert COMM.allgather(limits[0]) == [limits[0]] * COMM.size


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("false.msh", "x"),
        ("exit.geo", "Exit;\n"),
        pytest.param("missing.geo", None, marks=pytest.mark.slow),
        pytest.param("false.step", "x", marks=pytest.mark.slow),
    ],
)
def test_a_geometry_that_cannot_be_meshed_is_refused_on_every_rank(
    name: str, text: str | None, shared_path: Path
) -> None:
    if COMM.rank == 0 and text is not None:
        (shared_path / name).write_text(text)
    with pytest.raises(GeometryError, match=re.escape(name)):
        from_file(COMM, GeometryFile(shared_path / name), None)


def test_what_the_first_rank_makes_and_what_any_rank_raises_is_the_same_on_all() -> None:
    done: list[int] = []
    made = compute_on_root(COMM, lambda: (COMM.rank, done.append(0)), map(done.append, [COMM.rank]))
    assert made == (0, None)
    assert done == [COMM.rank]
    assert compute_on_root(COMM, lambda: COMM.rank) == 0

    def fail(_: int = 0) -> None:
        raise ValueError(f"by rank {COMM.rank}")

    with pytest.raises(ValueError, match="by rank 0"):
        compute_on_root(COMM, fail, map(fail, [0]))
    with pytest.raises(ValueError, match="by rank 1"):
        compute_on_root(COMM, lambda: None, map(fail, [0]))


def test_what_others_do_meanwhile_ends_once_the_first_rank_is_done() -> None:
    done: list[int] = []
    endless = (done.append(i) or sleep(0.05) for i in count())  # type: ignore[func-returns-value]
    compute_on_root(COMM, lambda: sleep(0.5), endless)
    begun = len(done)

    def fail() -> None:
        raise ValueError("by the first")

    with pytest.raises(ValueError, match="by the first"):
        compute_on_root(COMM, fail, endless)
    assert begun or not COMM.rank  # at the end: a rank that fails before leaves the others waiting


def test_edges_have_the_same_facets_on_all_ranks_together() -> None:
    for place in (structured, dogbone):
        counts = []
        for comm in (COMM, ALONE):
            on = place(comm)
            own = on.mesh.topology.index_map(1).size_local
            mine = {edge: int((on.edge_facets(edge) < own).sum()) for edge in on.edges}
            counts.append({edge: comm.allreduce(n) for edge, n in mine.items()})
        assert counts[0] == counts[1]
        assert min(counts[1].values()) > 0


def buckled(comm: MPI.Comm) -> tuple[StabilityLoss, Step, float]:
    """Return the loss, the last step on the branch, and the deflection there."""
    on = scenes.sheet(fibres=scenes.ALONG, comm=comm)
    model = scenes.model(on, scenes.BONDED, scenes.PROTOTYPE)
    run = scenes.push(model, program_of([ramp(0.0, 2e-4, 1.0, 1)]), "follow")
    assert run.failure is None
    (loss,) = [s.loss for s in run.steps if s.loss]
    across = model.field.x.array[1::2]
    sides = comm.allgather((float(across.min()), float(across.max())))
    return loss, run.steps[-1], max((a for pair in sides for a in pair), key=abs)


def test_all_ranks_together_find_the_critical_load_and_the_branch_of_one() -> None:
    (loss, end, side), (alone, last, expected) = buckled(COMM), buckled(ALONE)
    assert (loss.time, loss.step, loss.negatives) == (alone.time, alone.step, alone.negatives)
    assert loss.reactions["right"][0] == pytest.approx(alone.reactions["right"][0], rel=1e-8)
    assert end.negatives == last.negatives == 0
    assert side == pytest.approx(expected, rel=1e-5)  # the same sign, too
    assert end.reactions["right"][0] == pytest.approx(last.reactions["right"][0], rel=1e-8)
    assert COMM.allgather(str(loss)) == [str(loss)] * COMM.size
