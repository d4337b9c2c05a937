"""Fixtures for the tests of env/enter."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.environment.machine import PROJECT, Machine, tiny_root


@pytest.fixture(scope="session")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Tar file of a tiny root."""
    return tiny_root(tmp_path_factory.mktemp("tiny"))


@pytest.fixture
def machine(tmp_path: Path, archive: Path) -> Machine:
    """A machine with an empty cache."""
    machine = Machine(tmp_path, archive)
    machine.builder()
    return machine


@pytest.fixture
def clone(machine: Machine) -> Machine:
    """The same machine with a project folder whose package list may be changed."""
    project = machine.folder / "project"
    shutil.copytree(PROJECT / "env", project / "env")
    return Machine(machine.folder, machine.archive, project)
