"""One list of packages serves the environment and the image."""

from __future__ import annotations

import re
import subprocess
import tomllib
from importlib.metadata import packages_distributions, version
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from tests.environment.conftest import PROJECT
from tests.structure.test_layers import SOURCES, imports
from wovenfab.lacking import GMSH_LIBRARIES

LINES = (PROJECT / "env" / "packages.txt").read_text().splitlines()
PACKAGES = [line.split("#")[0].strip() for line in LINES if line.split("#")[0].strip()]
#: What comes with a package that is named.
PARTS = {"pydantic_core", "pydantic-core", "ruamel.yaml.clib"}


def test_the_image_installs_exactly_the_list(tmp_path: Path) -> None:
    dockerfile = (PROJECT / "Dockerfile").read_text().replace("\\\n", "")
    (copy,) = re.findall(r"^COPY env/packages\.txt (\S+)$", dockerfile, re.M)
    (command,) = re.findall(r"^RUN (.*apt-get install.*)$", dockerfile, re.M)
    (tmp_path / "apt-get").write_text(f'#!/bin/sh\nprintf "%s\\n" "$@" >>"{tmp_path}/asked"\n')
    (tmp_path / "rm").write_text("#!/bin/sh\n")
    for stub in ("apt-get", "rm"):
        (tmp_path / stub).chmod(0o755)
    subprocess.run(
        ["sh", "-c", command.replace(copy, str(PROJECT / "env" / "packages.txt"))],
        env={"PATH": f"{tmp_path}:/usr/bin:/bin"},
        check=True,
    )
    asked = (tmp_path / "asked").read_text().split()
    assert asked[:2] == ["update", "install"]
    assert [word for word in asked[2:] if not word.startswith("-")] == PACKAGES


def test_pip_is_asked_for_no_dependency() -> None:
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text())["project"]
    assert "dependencies" not in project
    assert "dependencies" not in project.get("dynamic", [])


def test_what_the_wheel_says_it_needs_is_there_and_is_all_that_the_code_imports() -> None:
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text())["project"]
    extras = {
        name: [*map(Requirement, texts)] for name, texts in project["optional-dependencies"].items()
    }
    wheels = {one.name for one in extras["wheels"]}
    assert wheels - {one.name for one in extras["needs"]} == {"dolfinx-solver-real"}
    wanted = [one for name in ("needs", "cluster") for one in extras[name]]
    for one in wanted:
        assert one.specifier.contains(version(one.name), prereleases=True), one
    by_module = packages_distributions()
    used = {m.partition(".")[0] for path in SOURCES for m in imports(path)} - {"dask_jobqueue"}
    needed = {name.lower() for module in used for name in by_module.get(module, [])}
    assert needed - {one.name for one in wanted} <= PARTS | {"wovenfab"}


def test_the_readme_installs_what_the_wheels_need() -> None:
    listed = (PROJECT / "env" / "wheels.txt").read_text().splitlines()
    packages = {line.split("#")[0].strip() for line in listed} - {"", "ca-certificates"}
    readme = (PROJECT / "README.md").read_text()
    (told,) = re.findall(r"^sudo apt-get install (.*?)$", readme.replace("\\\n", ""), re.M)
    assert set(told.partition("#")[0].split()) == packages
    assert set(GMSH_LIBRARIES.split()) < packages


@pytest.mark.mpi
@pytest.mark.mpi4
def test_ranks_reach_each_other() -> None:
    from mpi4py import MPI

    world = MPI.COMM_WORLD
    assert world.allreduce(world.rank) == world.size * (world.size - 1) // 2
