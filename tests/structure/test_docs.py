"""What the documents name exists: paths, links, targets of the Makefile, Python imports."""

from __future__ import annotations

import ast
import importlib.util
import pkgutil
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import wovenfab

ROOT = Path(__file__).parents[2]
FOLDERS = "wovenfab|forms|tests|benchmarks|configs|docs|paper|examples|meshes|env"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
CHANGELOG = ROOT / "CHANGELOG.md"
EACH_PAGE = pytest.mark.parametrize(
    "page", PAGES, ids=lambda page: f"{page.parent.name}/{page.name}"
)

_LINK = re.compile(r"\]\(([^)\s]+)\)|<img src=\"([^\"]+)\"")
_PATH = re.compile(rf"(?<![\w./$:-])(?:{FOLDERS})/[\w./*-]*\w")
_FENCED = re.compile(r"^```([\w{}-]*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
_INLINE = re.compile(r"`([^`\n]+)`")
_HEADING = re.compile(r"^#+ (.*)$", re.MULTILINE)


def links(page: Path) -> list[str]:
    """Return the targets of relative links and pictures."""
    targets = [a or b for a, b in _LINK.findall(page.read_text(encoding="utf-8"))]
    return [target for target in targets if "://" not in target]


def commands(page: Path) -> Iterator[str]:
    """Yield each line of code, in blocks and in the text."""
    text = page.read_text(encoding="utf-8")
    for _, block in _FENCED.findall(text):
        yield from block.splitlines()
    yield from _INLINE.findall(_FENCED.sub("", text))


def anchors(page: Path) -> set[str]:
    """Return the anchors that GitHub gives to the headings."""
    headings = _HEADING.findall(_FENCED.sub("", page.read_text(encoding="utf-8")))
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}


def python_blocks() -> list[str]:
    """Return the Python blocks that use wovenfab, of pages whose blocks no other test runs."""
    still = [page for page in PAGES if page.parent.name not in ("tutorials", "how-to")]
    blocks = [b for page in still for b in _FENCED.findall(page.read_text(encoding="utf-8"))]
    return [code for language, code in blocks if language == "python" and "wovenfab" in code]


@EACH_PAGE
def test_every_path_that_is_named_exists(page: Path) -> None:
    text = _LINK.sub("", page.read_text(encoding="utf-8"))
    missing = [p for p in _PATH.findall(text) if not any(ROOT.glob(p))]
    assert not missing


@pytest.mark.parametrize("page", [*PAGES, CHANGELOG], ids=lambda page: page.name)
def test_every_relative_link_leads_to_a_file_and_a_heading(page: Path) -> None:
    for link in links(page):
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


@EACH_PAGE
def test_every_make_target_and_python_name_exists(page: Path) -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"^([a-z-]+):", makefile, re.MULTILINE))
    for command in commands(page):
        for target in re.findall(r"^make ([a-z-]+)", command):
            assert target in targets, command
        for module in re.findall(r"python3 -m ([\w.]+)", command):
            assert importlib.util.find_spec(module), command
        if re.fullmatch(r"wovenfab(\.\w+)+", command):
            assert pkgutil.resolve_name(command)


def test_classes_and_functions_of_the_architecture_are_in_the_files_beside_them() -> None:
    page = ROOT / "docs" / "architecture.md"
    for line in page.read_text(encoding="utf-8").splitlines():
        files = re.findall(r"\]\(([^)]+\.py)\)", line)
        code = "".join((page.parent / name).read_text(encoding="utf-8") for name in files)
        names = re.findall(r"`(?:[A-Z]\w+\.)?([A-Za-z]\w+)`", line) if line[:1] == "|" else []
        assert not files or all(re.search(rf"\b{name}\b", code) for name in names), line


@pytest.mark.parametrize("code", python_blocks())
def test_python_in_the_documents_compiles_and_uses_names_that_exist(code: str) -> None:
    tree = ast.parse(code)
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            exec(compile(ast.Module([node], []), "<documents>", "exec"), {})
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "wovenfab":
            assert hasattr(wovenfab, node.attr)
