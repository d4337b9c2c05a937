"""What a FEniCSx user can do without a case: meshes, terms, conditions and loops of their own."""

from __future__ import annotations

import ast
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import GhostMode, create_rectangle, create_unit_interval, meshtags
from mpi4py import MPI

import wovenfab as wf
from wovenfab.simulation.progress import peak_memory

ROOT = Path(__file__).parents[2]
COMM = MPI.COMM_WORLD
YARNS = wf.directions((np.pi / 4, -np.pi / 4))
CORNERS = [(0, 0), (0.3, 0), (0.3, 0.1), (0, 0.1)]
NAMES = ["bottom", "right", "top", "left"]
EFFECTS = [wf.stretch(5e5), wf.shear(40.0), wf.bending(0.02)]
EDGES = [wf.clamp("left"), wf.move("right", (wf.PROGRAM, 0.0))]
SERIAL = ("case_in_python.py", "fields.py", "one_loop.py")
LIBRARY = sorted(p for p in (ROOT / "examples").glob("*.py") if p.name not in SERIAL)


def plain_sheet() -> wf.Sheet:
    """Return a coarse sheet of 300 mm by 100 mm."""
    return wf.fibre_sheet(CORNERS, NAMES, YARNS, 0.1, held=("left", "right"))


def force(terms: Any = EFFECTS, sheet: Any = None, **more: Any) -> Any:
    """Return the history of a pull by 10 mm."""
    model = wf.build_model(sheet or plain_sheet(), terms, EDGES, wf.Numerics(2), **more)
    return wf.simulate(wf.Simulation(wf.Problem(model), wf.program(wf.Ramp(0.01, steps=4)))).history


@pytest.mark.mpi
@pytest.mark.parametrize(
    "example",
    [
        pytest.param(p, id=p.name, marks=[pytest.mark.slow] if p.name == "own_solver.py" else [])
        for p in LIBRARY
    ],
)
def test_an_example_of_the_library_runs_on_any_number_of_ranks(
    example: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if "slepc4py" in example.read_text():
        pytest.importorskip("slepc4py")
    folder = COMM.bcast(tmp_path)
    monkeypatch.chdir(folder)
    if COMM.rank == 0:
        (folder / "configs").symlink_to(ROOT / "configs")
    COMM.barrier()
    runpy.run_path(str(example))
    assert len(example.read_text().splitlines()) <= 40


def test_public_names_are_those_that_type_checkers_see() -> None:
    tree = ast.parse((ROOT / "wovenfab" / "__init__.py").read_text())
    (block,) = [n for n in tree.body if isinstance(n, ast.If)]
    imports = [n for n in block.body if isinstance(n, ast.ImportFrom)]
    seen = {alias.asname or alias.name for n in imports for alias in n.names}
    assert seen == {*wf.__all__, *wf.effects()} - {"__version__"}
    assert all(getattr(wf, name) is not None for name in seen)


def test_study_report_and_commands_use_public_names_only() -> None:
    files = [p for of in ("study", "report", "cli") for p in (ROOT / "wovenfab" / of).rglob("*.py")]
    nodes = [(p, node) for p in files for node in ast.walk(ast.parse(p.read_text()))]
    imported = [
        (path.name, alias.name)
        for path, node in nodes
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("wovenfab")
        for alias in node.names
    ]
    of_others = [
        (path.name, node.attr)
        for path, node in nodes
        if isinstance(node, ast.Attribute)
        and not (isinstance(node.value, ast.Name) and node.value.id in ("self", "cls"))
    ]
    private = [n for n in (*imported, *of_others) if n[1].startswith("_") and n[1][:2] != "__"]
    assert private == []


@pytest.mark.parametrize(
    "kinds",
    [
        pytest.param(["field"], marks=pytest.mark.mpi),
        ["expression", "constant", "function"],
    ],
)
def test_a_field_an_expression_and_a_number_are_the_same_stiffness(kinds: list[str]) -> None:
    sheet = plain_sheet()
    field = fem.Function(fem.functionspace(sheet.mesh, ("DG", 0)))
    field.x.array[:] = 40.0
    given = {
        "field": field,
        "expression": 40.0 + 0 * ufl.SpatialCoordinate(sheet.mesh)[0],
        "constant": fem.Constant(sheet.mesh, 40.0),
        "function": lambda x: 40.0 + 0 * x[1],
    }
    expected = force(EFFECTS[:2], sheet)["force"]
    for kind in kinds:
        terms = [wf.stretch(5e5), wf.shear(given[kind])]
        np.testing.assert_allclose(force(terms, sheet)["force"], expected, rtol=1e-9)


def test_a_potential_of_the_user_is_the_effect_that_has_the_same_energy() -> None:
    """A bed of springs by UFL, and the energy that the history then has in one more column."""

    def bed(displacements: tuple[Any, Any]) -> Any:
        return 1e3 * ufl.inner(displacements[0], displacements[0]) * ufl.dx

    without, within = force(), force(potentials={"bed": bed})
    assert within["force"][-1] > 1.05 * without["force"][-1]
    assert within["energy_bed"][-1] > 0
    energy = within["energy"]
    np.testing.assert_allclose(
        within["energy_bed"] + sum(within[f"energy_{t.effect.name}"] for t in EFFECTS), energy
    )
    assert abs(within["imbalance"][-1]) < 0.02 * energy[-1]  # of four steps


def test_a_condition_of_dolfinx_holds_and_has_its_reaction() -> None:
    """Pulled by a Dirichlet condition in place of a grip, the sheet needs the same force."""
    sheet, expected = plain_sheet(), force()
    model = wf.build_model(sheet, EFFECTS, [wf.clamp("left")], wf.Numerics(2))
    right = fem.locate_dofs_topological(model.space, 1, sheet.edge_facets("right"))
    given = fem.Function(model.space)
    problem = wf.Problem(model, bcs={"grip": fem.dirichletbc(given, right)})
    with wf.Simulation(problem, wf.program(wf.Ramp(0.01, steps=4))) as simulation:
        for step in simulation.steps():
            assert step.reactions["grip"][0] == pytest.approx(
                expected["force"][step.number], rel=1e-7, abs=1e-9
            )
            given.x.array[::2] = expected["displacement"][min(step.number + 1, 4)]


def test_a_motion_has_one_force_however_it_is_worded() -> None:
    """Pulled by one grip or by both, by multiples or by functions, the work is the same."""
    turned = (lambda x, y, program, second: 2 * program, 0.0)
    reference = force()
    for edges, factor in (
        ([wf.clamp("left"), wf.move("right", (2 * wf.PROGRAM, 0.0))], 2.0),
        ([wf.clamp("left"), wf.move("right", turned)], 2.0),
        ([wf.move("left", (-wf.PROGRAM, 0.0)), wf.move("right", (wf.PROGRAM, 0.0))], 2.0),
    ):
        model = wf.build_model(plain_sheet(), EFFECTS, edges, wf.Numerics(2))
        program = wf.program(wf.Ramp(0.01 / factor, steps=4))
        found = wf.simulate(wf.Simulation(wf.Problem(model), program)).history
        np.testing.assert_allclose(
            found["force"], factor * reference["force"], rtol=1e-7, atol=1e-9
        )
        np.testing.assert_allclose(found["work"], reference["work"], rtol=1e-7, atol=1e-12)


def test_a_dead_load_is_a_number_ufl_or_a_function() -> None:
    sheet, moved = plain_sheet(), []
    x = ufl.SpatialCoordinate(sheet.mesh)
    for pull in (
        5.0,
        5.0 + 0 * x[1],
        fem.Constant(sheet.mesh, 5.0),
        lambda x, program, second: 5.0,
    ):
        edges = [wf.clamp("left"), wf.load("right", (pull, 0.0))]
        model = wf.build_model(sheet, EFFECTS[:2], edges, wf.Numerics(2))
        solver = wf.EquilibriumSolver(wf.Problem(model))
        assert solver.advance(0.0).converged
        moved.append(wf.PointFields(model, [(0.29, 0.05)]).values()["displacement"])
        solver.destroy()
    assert moved[0][0, 0] > 1e-3
    np.testing.assert_allclose(moved[1:], moved[:1] * 3, rtol=1e-7, atol=1e-12)  # across it is zero


@pytest.mark.mpi
def test_ranks_that_lack_the_cells_beside_their_own_are_told() -> None:
    corners, none = [[0.0, 0.0], [1.0, 1.0]], GhostMode.none
    square = create_rectangle(COMM, corners, [4, 4], ghost_mode=none)
    tags = meshtags(square, 1, np.array([], dtype=np.int32), np.array([], dtype=np.int32))
    if COMM.size == 1:
        wf.Sheet(square, tags, {}, YARNS)
        return
    with pytest.raises(ValueError, match="ghost_mode"):
        wf.Sheet(square, tags, {}, YARNS)


def test_a_scheme_that_looks_back_farther_than_the_model_is_refused() -> None:
    terms = [*EFFECTS, wf.coupling(1e6), wf.slip_friction(2e3, 100.0)]
    model = wf.build_model(plain_sheet(), terms, EDGES, wf.Numerics(2, history=1))
    program = wf.program(wf.Ramp(0.01, steps=1, duration=1.0))
    with pytest.raises(ValueError, match="history=2"):
        wf.Simulation(wf.Problem(model), program, "bdf2")


def test_a_step_that_is_rejected_leaves_the_state_as_it_was() -> None:
    terms = [*EFFECTS, wf.coupling(1e6), wf.slip_friction(2e3, law="coulomb")]
    solver = wf.EquilibriumSolver(
        wf.Problem(wf.build_model(plain_sheet(), terms, EDGES, wf.Numerics(2)))
    )
    assert solver.advance(0.005).converged
    solver.accept()
    before = solver.model.field.x.array.copy()
    solver.advance(0.02)
    solver.reject()
    np.testing.assert_array_equal(solver.model.field.x.array, before)
    direct = solver.advance(0.01)
    once = solver.model.field.x.array.copy()
    solver.reject()
    assert direct.converged and solver.advance(0.01).converged
    np.testing.assert_allclose(solver.model.field.x.array, once, atol=1e-9)
    solver.destroy()


@pytest.mark.mpi
def test_values_at_points_are_those_of_probes() -> None:
    terms = [*EFFECTS, wf.coupling(1e6)]
    model = wf.build_model(plain_sheet(), terms, EDGES, wf.Numerics(2))
    model.field.x.array[:] = 1e-3 * np.cos(np.arange(model.field.x.array.size))
    model.field.x.scatter_forward()
    at = (0.11, 0.04)
    (u,), (v,) = (
        wf.PointFields(model, [at]).values()[f"displacement_{family}"] for family in (1, 2)
    )
    probe = wf.Probes(model, {"p": wf.PointProbe(at)}).values()
    np.testing.assert_allclose([*u, *v], probe[:4], rtol=1e-12)
    with pytest.raises(ValueError, match="not on the sheet"):
        wf.PointFields(model, [(1.0, 1.0)])


def test_what_cannot_be_a_sheet_or_a_model_is_refused() -> None:
    interval = create_unit_interval(MPI.COMM_SELF, 2)
    none = meshtags(interval, 0, np.array([], dtype=np.int32), np.array([], dtype=np.int32))
    with pytest.raises(ValueError, match="triangles"):
        wf.Sheet(interval, none, {}, YARNS)
    shared = GhostMode.shared_facet
    square = create_rectangle(MPI.COMM_SELF, [[0.0, 0.0], [1.0, 1.0]], [1, 1], ghost_mode=shared)
    tags = meshtags(square, 1, np.array([], dtype=np.int32), np.array([], dtype=np.int32))
    for fibres, why in ((2 * YARNS, "unit"), (YARNS[[0, 0]], "cross")):
        with pytest.raises(ValueError, match=why):
            wf.Sheet(square, tags, {}, fibres)
    with pytest.raises(wf.GeometryError, match="counter-clockwise"):
        wf.fibre_sheet(CORNERS[::-1], NAMES, YARNS, 0.1)
    sheet = wf.Sheet(square, tags, {}, YARNS)
    with pytest.raises(ValueError, match="no edge 'left'"):
        wf.build_model(sheet, EFFECTS, EDGES)
    with pytest.raises(ValueError, match="each once"):
        wf.build_model(sheet, [*EFFECTS, EFFECTS[0]])


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (lambda: wf.shear(), "needs stiffness"),
        (lambda: wf.shear(1.0, 2.0), "takes stiffness"),
        (lambda: wf.shear(1.0, stiffness=2.0), "takes no 'stiffness'"),
        (lambda: wf.slip_friction(1.0, law="none"), "no law 'none'"),
        (lambda: wf.Cycles([0.02]), "velocities or frequencies"),
        (lambda: wf.clamp("left", families=[3]), "families are 1, 2"),
    ],
)
def test_arguments_that_make_no_sense_are_refused(make: Any, why: str) -> None:
    with pytest.raises((TypeError, ValueError), match=why):
        make()


@pytest.mark.slow
def test_memory_does_not_grow_over_a_hundred_simulations() -> None:
    sheet, program = plain_sheet(), wf.program(wf.Ramp(0.01, steps=1))

    def make() -> None:
        model = wf.build_model(sheet, [*EFFECTS, wf.coupling(1e6)], EDGES, wf.Numerics(2))
        with wf.Simulation(wf.Problem(model), program) as simulation:
            assert len(list(simulation.steps())) == 2

    for _ in range(20):
        make()
    before = peak_memory()
    for _ in range(100):
        make()
    assert peak_memory() < before + 20e6
