"""The mark in a picture that says which command and which commit made it."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree as ET

from PIL import Image

from wovenfab import __version__
from wovenfab.record.results import Provenance

MAKER = f"wovenfab {__version__}"
_DUBLIN_CORE = "{http://purl.org/dc/elements/1.1/}"


def stamp(kind: str, origin: Provenance) -> dict[str, str | None]:
    """Return the metadata for matplotlib's ``savefig``, the same for equal origins.

    Args:
        kind: Suffix of the file, ``.png`` or ``.svg``.
        origin: What made the picture.

    Raises:
        ValueError: Another kind of file.
    """
    if kind == ".png":
        return {"Software": MAKER, "Command": origin.command, "Commit": origin.commit}
    if kind == ".svg":
        said = {"Creator": MAKER, "Source": origin.command, "Identifier": origin.commit}
        return {"Date": None, **said}
    raise ValueError(f"pictures are .png or .svg, not {kind}")


def comment(origin: Provenance) -> str:
    """Return the comment that marks a GIF."""
    return f"{MAKER}\nCommand: {origin.command}\nCommit: {origin.commit}"


def read_stamp(path: Path) -> Provenance:
    """Return what a picture (PNG, SVG, GIF) says of its origin; empty where it is silent."""
    if path.suffix == ".svg":
        tree = ET.parse(path)
        command, commit = (
            tree.find(f".//{_DUBLIN_CORE}{name}") for name in ("source", "identifier")
        )
        return Provenance(_text(command), _text(commit))
    with Image.open(path) as picture:
        said = dict(picture.info)
    if path.suffix == ".gif":
        said = dict(re.findall(r"(\w+): (.*)", bytes(said.get("comment", b"")).decode()))
    return Provenance(said.get("Command", ""), said.get("Commit", ""))


def faults(origin: Provenance) -> list[str]:
    """Return what keeps others from making a published picture again, in words."""
    found = []
    if not origin.command:
        found.append("it does not say which command made it")
    if re.search(r"(^|[\s='\"])[/~]", origin.command):
        found.append(f"its command has a path of one machine: {origin.command}")
    if not re.fullmatch(r"[0-9a-f]{12}(; [0-9a-f]{12})*", origin.commit):
        found.append(
            f"its commit is {origin.commit!r}: draw it through env/enter, from committed code"
        )
    return found


def _text(element: ET.Element | None) -> str:
    return "" if element is None else element.text or ""
