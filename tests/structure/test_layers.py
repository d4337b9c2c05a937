"""The shape of the code: data flows one way, and no effect is known by its name."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from wovenfab.forms import effects
from wovenfab.parallel import child_environment

ROOT = Path(__file__).parents[2]
#: From the bottom up; a layer may use itself and what stands before it.
LAYERS = (
    "wovenfab.forms",
    "wovenfab.lacking",
    "wovenfab.mpi",
    "wovenfab.versions",
    "wovenfab.parallel",
    "wovenfab.compat",
    "wovenfab.plain_text",
    "wovenfab.sheet",
    "wovenfab.model",
    "wovenfab.solver",
    "wovenfab.stepping",
    "wovenfab.record",
    "wovenfab.simulation",
    "wovenfab.case",
    "wovenfab.measured",
    "wovenfab.study",
    "wovenfab.report",
    "wovenfab.interface",
    "wovenfab.cli",
    "paper",
    "benchmarks",
)
#: The library: what a FEniCSx user needs, and what it must not know.
CORE = LAYERS[: LAYERS.index("wovenfab.simulation") + 1]
FOREIGN = (
    *("ruamel", "yaml", "pydantic", "pint", "typer", "rich", "matplotlib", "jinja2"),
    *("dask", "distributed", "wovenfab.case", "wovenfab.study", "wovenfab.report"),
)
SOURCES = sorted((*(ROOT / "wovenfab").rglob("*.py"), *(ROOT / "forms").rglob("*.py")))


def module_of(path: Path) -> str:
    """Return the name of a module of the project; forms/ is wovenfab.forms."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(("wovenfab", *parts) if parts[0] == "forms" else parts)


def layer_of(module: str) -> int | None:
    """Return the number of a module's layer; None for what is not the project's."""
    numbers = [i for i, name in enumerate(LAYERS) if (module + ".").startswith(name + ".")]
    return numbers[0] if numbers else None


def imports(path: Path) -> set[str]:
    nodes = list(ast.walk(ast.parse(path.read_text())))
    plain = {alias.name for n in nodes if isinstance(n, ast.Import) for alias in n.names}
    return plain | {n.module for n in nodes if isinstance(n, ast.ImportFrom) and n.module}


def test_no_module_imports_from_a_layer_above_its_own() -> None:
    own = {p: layer_of(module_of(p)) for p in SOURCES}
    assert [
        f"{path.relative_to(ROOT)} imports {module}"
        for path, layer in own.items()
        if layer is not None  # None: wovenfab itself and its entry point
        for module in imports(path)
        if (layer_of(module) or 0) > layer
    ] == []


@pytest.mark.parametrize(
    "layer",
    [c if c == CORE[-1] else pytest.param(c, marks=pytest.mark.slow) for c in CORE],
)
def test_the_library_knows_neither_files_of_cases_nor_what_shows_results(layer: str) -> None:
    """Each module of a layer is imported in a fresh interpreter, as a script would."""
    names = sorted(
        module_of(path) for path in SOURCES if (module_of(path) + ".").startswith(layer + ".")
    )
    names = [name.removesuffix(".__init__") for name in names]
    code = (
        f"import importlib, sys\nfor name in {names}: importlib.import_module(name)\n"
        f"print([m for m in sys.modules if m.startswith({tuple(f'{n}.' for n in FOREIGN)}) "
        f"or m in {FOREIGN}])"
    )
    found = subprocess.run(
        [sys.executable, "-c", code], env=child_environment(), capture_output=True, text=True
    )
    assert found.stdout == "[]\n", found.stderr


def test_every_folder_of_the_project_is_a_layer() -> None:
    folders = {f"wovenfab.{p.parent.name}" for p in (ROOT / "wovenfab").glob("*/*.py")}
    assert folders <= set(LAYERS)


def test_no_module_has_two_names() -> None:
    code = "import sys, wovenfab.cli.check; print('forms' in sys.modules)\nimport forms"
    found = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=child_environment(),
        capture_output=True, text=True,
    )  # fmt: skip
    assert found.stdout == "False\n"
    assert found.stderr.splitlines()[-1].startswith("ImportError"), found.stderr


def test_the_physics_knows_no_mesh_and_no_solver() -> None:
    used = {m for p in (ROOT / "forms").glob("*.py") for m in imports(p)}
    used = {m.split(".")[0] for m in used if not (m + ".").startswith("wovenfab.forms.")}
    assert not used & {"dolfinx", "petsc4py", "mpi4py", "basix", "numpy", "wovenfab"}


def test_nothing_branches_on_the_name_of_an_effect() -> None:
    assert [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in SOURCES
        if path.is_relative_to(ROOT / "wovenfab")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Compare | ast.MatchValue)
        and {c.value for c in ast.walk(node) if isinstance(c, ast.Constant)} & set(effects())
    ] == []
