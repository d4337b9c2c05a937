"""The documentation site: it builds without a warning, and needs nothing but its own files."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from html import unescape
from pathlib import Path
from urllib.parse import unquote

import pytest

import wovenfab
from wovenfab.case import json_schema
from wovenfab.cli import console
from wovenfab.cli.app import app
from wovenfab.parallel import child_environment

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
_LOADED = re.compile(
    r"<(?:script|img|iframe|source)\b[^>]*?\bsrc=\"([^\"]+)\"|<link\b[^>]*?\bhref=\"([^\"]+)\""
)
_LINK = re.compile(r"<a\b[^>]*?\bhref=\"([^\"]+)\"")
_STYLE = re.compile(r"url\(\s*['\"]?([^'\")]+)|@import\s+['\"]([^'\"]+)")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built as ``make docs`` does."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-E"]
    built = subprocess.run(
        [*command, "-d", folder / "doctrees", ROOT / "docs", folder / "site"],
        env=child_environment(), capture_output=True, text=True,
    )  # fmt: skip
    assert built.returncode == 0, built.stderr
    return folder / "site"


def pages(site: Path) -> Iterator[tuple[Path, str]]:
    for path in site.rglob("*.html"):
        yield path, path.read_text(encoding="utf-8")


def test_nothing_is_loaded_from_a_network(site: Path) -> None:
    for path, text in pages(site):
        for loaded in map(unescape, filter(None, sum(_LOADED.findall(text), ()))):
            assert not re.match(r"\w+:|//", loaded), f"{path} loads {loaded}"
            assert (path.parent / unquote(re.sub(r"[?#].*", "", loaded))).exists(), loaded
    for path in site.rglob("*.css"):
        for loaded in filter(None, sum(_STYLE.findall(path.read_text(encoding="utf-8")), ())):
            assert not re.match(r"(?!data:)\w+:|//", loaded), f"{path} loads {loaded}"


def test_every_link_leads_to_a_file_and_a_place_in_it(site: Path) -> None:
    texts = dict(pages(site))
    for path, text in texts.items():
        for link in map(unescape, _LINK.findall(text)):
            name, _, anchor = link.partition("#")
            if re.match(r"\w+:|//", link):
                continue
            target = (path.parent / unquote(name)).resolve() if name else path
            assert target.exists(), f"{path} leads to {link}"
            assert not anchor or f'id="{unquote(anchor)}"' in texts[target], f"{path}: {link}"


def test_the_reference_has_every_key_command_and_name(site: Path) -> None:
    sections = [s for s in json_schema()["$defs"].values() if s.get("title", "a")[0].isupper()]
    keys = {key for section in sections for key in section.get("properties", ())}
    listed = (site / "reference" / "case-keys.html").read_text(encoding="utf-8")
    effects = (site / "parameters.html").read_text(encoding="utf-8")
    assert [key for key in keys if f">{key}<" not in listed + effects] == []
    commands = (site / "reference" / "command-line.html").read_text(encoding="utf-8")
    assert app.registered_commands
    for command in app.registered_commands:
        assert f"wovenfab {command.callback.__name__}<" in commands
    interface = (site / "reference" / "python-interface.html").read_text(encoding="utf-8")
    names = set(wovenfab.__all__) - {"__version__"}
    assert [name for name in names if f'id="wovenfab.{name}"' not in interface] == []


def test_every_exit_code_is_explained() -> None:
    text = (ROOT / "docs" / "reference" / "exit-codes.md").read_text(encoding="utf-8")
    codes = {console.BAD_INPUT, console.FAILED_STEP, console.CANNOT_WRITE, console.INTERRUPTED}
    assert codes <= {int(code) for code in re.findall(r"\b\d+\b", text)}
