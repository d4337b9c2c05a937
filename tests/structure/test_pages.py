"""What tutorials and how-to pages tell a reader to do works, read from the pages themselves.

A block under "save as `NAME`" is a file. The commands of all ``sh`` blocks are run in a new
folder. A ``text`` block without a name is what the commands before it print: with its numbers where
a page is followed with all of its steps, else but for numbers.
Comments above a block: ``not tested: WHY``, ``exit code 2``, and ``shorter in tests: COMMAND``,
which makes the files shorter before the block is run.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted([*DOCS.glob("tutorials/*.md"), *DOCS.glob("how-to/*.md")])
#: Pages whose short versions still take more than a quarter of a minute each.
LONG = ("in-python", "my-fabric", "my-measurement")
EACH_PAGE = pytest.mark.parametrize("page", PAGES, ids=lambda p: f"{p.parent.name}/{p.stem}")
_BLOCK = re.compile(r"^(?:<!-- (.+?) -->\n)?```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_NAME = re.compile(r"\bas\s+`([\w.-]+\.\w+)`")
_RESULT = re.compile(r"`(results/[^`\s]+)`")
_NUMBER = re.compile(r"\d[\d.e+ -]*")
_VALUE = re.compile(r"\d+(?:\.\d+)?(?:e[+-]?\d+)?")
#: How near numbers on a page are to those that are printed, relative.
NEAR = 0.01
#: The command, with fewer steps and without the pictures of a run where time matters.
_COMMAND = """\
#!/bin/sh
command=$1; shift
case $command in run | resume | sweep | sensitivities) set -- {settings} "$@" ;; esac
exec {python} -P -m wovenfab "$command" "$@"
"""
_SHORT = "--set output.pictures=false --set time.steps_per_cycle=8"
_DRAWN = ("loop.png", "deformed.png")


@dataclass(frozen=True)
class Block:
    """A fenced block of a page, with the comment above it and the file that it is."""

    language: str
    text: str
    comment: str = ""
    file: str | None = None


def blocks(page: Path) -> Iterator[Block]:
    text = page.read_text(encoding="utf-8")
    for found in _BLOCK.finditer(text):
        paragraph = text[: found.start()].rstrip().rpartition("\n\n")[2]
        names = _NAME.findall(paragraph) if paragraph.endswith(":") else []
        yield Block(found[2], found[3], found[1] or "", names[-1] if names else None)


def lines_of(printed: str) -> list[tuple[str, list[float]]]:
    """Return each line of an output without its numbers, and these."""
    lines = filter(None, map(str.strip, printed.splitlines()))
    return [(_NUMBER.sub("#", line), [*map(float, _VALUE.findall(line))]) for line in lines]


def missing(shown: str, printed: str, numbers: bool) -> list[tuple[str, list[float]]]:
    """Return the lines that a page shows and a command did not print."""
    there = lines_of(printed)
    return [
        (words, values)
        for words, values in lines_of(shown)
        if not any(
            words == other and (not numbers or values == pytest.approx(others, rel=NEAR))
            for other, others in there
        )
    ]


def follow(page: Path, folder: Path, short: bool) -> None:
    """Do in a folder what a page says, as a reader would, or the same with coarse runs."""
    text, printed = page.read_text(encoding="utf-8"), ""
    command = folder / ".bin" / "wovenfab"
    command.parent.mkdir()
    settings = _SHORT if short else ""
    command.write_text(_COMMAND.format(settings=settings, python=sys.executable))
    command.chmod(0o755)
    own = {k: v for k, v in os.environ.items() if not k.startswith(("OMPI_COMM", "PMIX"))}
    own |= {"PATH": f"{command.parent}:{own['PATH']}", "PYTHONPATH": str(ROOT)}
    base = page.with_name("index.md")
    for block in [*(b for b in blocks(base) if b.file), *blocks(page)]:
        if block.file:
            (folder / block.file).write_text(block.text)
        elif block.language == "text":
            lacking = missing(block.text, printed, numbers=not short)
            assert not lacking, f"{lacking} is not in\n{printed}"
        elif not block.comment.startswith("not tested"):
            assert block.language == "sh", f"a block of {page.name} is no file and no command"
            _, shorter, change = block.comment.partition("shorter in tests: ")
            lines = f"{change}\n{block.text}" if short and shorter else block.text
            shell = ["bash", "-e", "-c", lines]
            ended = subprocess.run(shell, cwd=folder, env=own, capture_output=True, text=True)
            printed = ended.stdout + ended.stderr
            expected = int((re.match(r"exit code (\d)", block.comment) or [0, 0])[1])
            assert ended.returncode == expected, f"{block.text}\n{printed}"
    for result in _RESULT.findall(_BLOCK.sub("", text)):
        assert (folder / result).exists() or (short and result.endswith(_DRAWN)), result


@pytest.mark.parametrize(
    "page",
    [pytest.param(p, marks=[pytest.mark.slow] if p.stem in LONG else []) for p in PAGES],
    ids=lambda p: f"{p.parent.name}/{p.stem}",
)
def test_a_page_does_what_it_says(page: Path, tmp_path: Path) -> None:
    follow(page, tmp_path, short=True)


@EACH_PAGE
@pytest.mark.slow
def test_a_page_does_what_it_says_with_all_of_its_steps(page: Path, tmp_path: Path) -> None:
    follow(page, tmp_path, short=False)
