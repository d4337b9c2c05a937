"""What tutorials and how-to pages tell a reader to do works, read from the pages themselves.

A block under "save as `NAME`" is a file. The commands of all ``sh`` blocks are run in a new
folder. A ``text`` block without a name is what the commands before it print, but for numbers.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from wovenfab.parallel import child_environment

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted([*DOCS.glob("tutorials/*.md"), *DOCS.glob("how-to/*.md")])
_BLOCK = re.compile(r"^(?:<!-- (.+?) -->\n)?```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_NAME = re.compile(r"\bas\s+`([\w.-]+\.\w+)`")
_RESULT = re.compile(r"`(results/[^`\s]+)`")
_NUMBER = re.compile(r"\d[\d.e+ -]*")
#: The command with fewer steps and without the pictures of a run, which take longest.
_COMMAND = f"""\
#!/bin/sh
command=$1; shift
case $command in run | resume | sweep | sensitivities)
    set -- --set output.pictures=false --set time.steps_per_cycle=8 "$@" ;;
esac
exec {sys.executable} -P -m wovenfab "$command" "$@"
"""
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


def pattern(printed: str) -> list[str]:
    """Return the lines of an output without their numbers."""
    lines = (_NUMBER.sub("#", line.strip()) for line in printed.splitlines())
    return [line for line in lines if line]


def follow(page: Path, folder: Path) -> None:
    """Do in a folder what a page says, as a reader would."""
    text, printed = page.read_text(encoding="utf-8"), ""
    command = folder / ".bin" / "wovenfab"
    command.parent.mkdir()
    command.write_text(_COMMAND)
    command.chmod(0o755)
    own = child_environment()
    own["PATH"] = f"{command.parent}:{own['PATH']}"
    del own["PYTHONSAFEPATH"]  # a reader's script may import another one beside it
    base = page.with_name("index.md")
    for block in [*(b for b in blocks(base) if b.file), *blocks(page)]:
        if block.file:
            (folder / block.file).write_text(block.text)
        elif block.language == "text":
            missing = set(pattern(block.text)) - set(pattern(printed))
            assert not missing, f"{missing} is not in\n{printed}"
        elif not block.comment.startswith("not tested"):
            assert block.language == "sh", f"a block of {page.name} is no file and no command"
            shell = ["bash", "-e", "-c", block.text]
            ended = subprocess.run(shell, cwd=folder, env=own, capture_output=True, text=True)
            printed = ended.stdout + ended.stderr
            expected = int((re.match(r"exit code (\d)", block.comment) or [0, 0])[1])
            assert ended.returncode == expected, f"{block.text}\n{printed}"
    for result in _RESULT.findall(_BLOCK.sub("", text)):
        assert (folder / result).exists() or result.endswith(_DRAWN), result


@pytest.mark.parametrize("page", PAGES, ids=lambda page: f"{page.parent.name}/{page.stem}")
def test_a_page_does_what_it_says(page: Path, tmp_path: Path) -> None:
    follow(page, tmp_path)
