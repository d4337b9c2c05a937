"""What docs/case-file.md shows is valid, each example over the default case, and is printed."""

from __future__ import annotations

import re
from pathlib import Path
from shutil import copytree

import pytest

from tests.structure.test_pages import Block, blocks
from wovenfab.case import read_case
from wovenfab.cli.check import check_case
from wovenfab.interface import execute
from wovenfab.study.variations import read_sweep_file

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "case-file.md"
EXAMPLES = [block for block in blocks(PAGE) if block.language == "yaml"]
BASE = "from: bias-1x3.yaml\n"
FORCES = ("creep.yaml", "force-cycles.yaml")


def first_line(block: Block) -> str:
    """Return the first line of an example."""
    return block.text.partition("\n")[0][:50]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The ready cases and geometries, with the files that the page shows or names."""
    made = copytree(ROOT / "configs", tmp_path_factory.mktemp("documented") / "configs")
    copytree(ROOT / "meshes", made.parent / "meshes")
    (made / "my_effect.py").write_text((ROOT / "docs" / "examples" / "my_effect.py").read_text())
    (made / "pretension.yaml").write_text(
        f"{BASE}program: {{type: ramp, to: 5 mm, velocity: 1, steps: 1}}\n"
        "discretisation: {degree: 2, mesh_size: 300 mm}\n"
    )
    execute(read_case(made / "pretension.yaml"), made.parent / "results" / "pretension")
    for block in blocks(PAGE):
        if block.language == "c" and block.file:
            (made / block.file).write_text(block.text)
    return made


@pytest.mark.parametrize("block", EXAMPLES, ids=first_line)
def test_an_example_of_the_page_is_valid(
    block: Block, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = folder / "example.yaml"
    path.write_text(block.text if re.match(r"(from|case):", block.text) else BASE + block.text)
    if block.text.startswith("case:"):
        assert len(read_sweep_file(path).variations) == 4
        return
    assert check_case(path, []) == 0
    told = capsys.readouterr().out
    assert "the case is valid" in told and "warning" not in told


def test_what_the_page_says_that_check_prints_is_printed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    check_case(ROOT / "configs" / "bias-1x3.yaml", ["sheet.length=320"])
    check_case(ROOT / "configs" / "programs" / "measured.yaml", [])
    told = capsys.readouterr().out.splitlines()
    shown = [block.text for block in blocks(PAGE) if block.language == "text"]
    assert shown and all(line in told for text in shown for line in text.splitlines())


def test_every_ready_program_is_listed_with_its_page() -> None:
    listed = (ROOT / "docs" / "how-to" / "index.md").read_text(encoding="utf-8")
    ready = [*(ROOT / "configs" / "programs").glob("*.yaml"), *map(Path, FORCES)]
    assert len(ready) > len(FORCES)
    assert [path.name for path in ready if f"{path.name})" not in listed] == []
