"""The shape of the code: data flows one way, and no effect is known by its name."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from forms.catalogue import effects

ROOT = Path(__file__).parents[2]
#: From the bottom up; a layer may use itself and what stands before it.
LAYERS = (
    "forms",
    "wovenfab.parallel",
    "wovenfab.compat",
    "wovenfab.log",
    "wovenfab.case",
    "wovenfab.sheet",
    "wovenfab.model",
    "wovenfab.solver",
    "wovenfab.stepping",
    "wovenfab.record",
    "wovenfab.simulation",
    "wovenfab.study",
    "wovenfab.report",
    "wovenfab.execution",
    "wovenfab.interface",
    "wovenfab.cli",
    "paper",
    "benchmarks",
)
SOURCES = sorted((*(ROOT / "wovenfab").rglob("*.py"), *(ROOT / "forms").rglob("*.py")))


def layer_of(module: str) -> int | None:
    """Return the number of a module's layer; None for what is not the project's."""
    found = [i for i, name in enumerate(LAYERS) if (module + ".").startswith(name + ".")]
    return found[0] if found else None


def imports(path: Path) -> list[str]:
    tree = ast.parse(path.read_text())
    found = [a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names]
    return found + [
        n.module
        for n in ast.walk(tree)
        if isinstance(n, ast.ImportFrom) and n.module and not n.level
    ]


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_no_module_imports_from_a_layer_above_its_own(path: Path) -> None:
    own = layer_of(".".join(path.relative_to(ROOT).with_suffix("").parts))
    if own is None:  # wovenfab itself and its entry point
        return
    above = [m for m in imports(path) if (layer_of(m) or 0) > own]
    assert not above


def test_every_folder_of_the_project_is_a_layer() -> None:
    folders = {f"wovenfab.{p.name}" for p in (ROOT / "wovenfab").iterdir() if p.is_dir()}
    assert folders - {"wovenfab.__pycache__"} <= set(LAYERS)


def test_the_physics_knows_no_mesh_and_no_solver() -> None:
    used = {m.split(".")[0] for p in (ROOT / "forms").glob("*.py") for m in imports(p)}
    assert not used & {"dolfinx", "petsc4py", "mpi4py", "basix", "numpy", "wovenfab"}


@pytest.mark.parametrize(
    "path", [p for p in SOURCES if "wovenfab" in p.parts], ids=lambda p: str(p.relative_to(ROOT))
)
def test_nothing_branches_on_the_name_of_an_effect(path: Path) -> None:
    names = set(effects())
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Compare | ast.MatchValue):
            constants = {c.value for c in ast.walk(node) if isinstance(c, ast.Constant)}
            assert not {c for c in constants if isinstance(c, str)} & names
