"""Results kept row by row, so that an interrupted suite goes on where it was."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks.hard.row import Figures

ROOT = Path(__file__).parents[2]
#: Folders whose files decide what a row gives, and what in them does not.
SOURCES = ("forms", "wovenfab", "configs", "meshes")
MERELY_SHOWS = ("benchmarks/hard/pictures", "benchmarks/hard/page.py", "wovenfab/report")


@dataclass(frozen=True)
class Kept:
    """The result of a row.

    Attributes:
        figures: What it gave, or None where it gave nothing.
        failure: Why it gave nothing.
        seconds: Wall time, start of the process included.
        memory: Largest resident memory of a rank, GB.
        commit: Commit of the code that gave it.
    """

    figures: Figures | None
    failure: str = ""
    seconds: float = 0.0
    memory: float = 0.0
    commit: str = ""


@cache
def fingerprint() -> str:
    """Return what identifies the sources."""
    digest = hashlib.sha256()
    for folder in SOURCES:
        for path in sorted((ROOT / folder).rglob("*")):
            name = str(path.relative_to(ROOT))
            if path.suffix in (".py", ".yaml", ".geo") and not name.startswith(MERELY_SHOWS):
                digest.update(name.encode() + path.read_bytes())
    return digest.hexdigest()


def save(kept: Kept, path: Path) -> None:
    """Write a result; what is there before is replaced at once."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"sources": fingerprint(), **asdict(kept)}, default=dict)
    part = path.with_suffix(".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)


def load(path: Path, any_sources: bool = False) -> Kept | None:
    """Return a result, or None if there is none of the present sources.

    Args:
        path: The file.
        any_sources: Take one of other sources, too.
    """
    try:
        data: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, json.JSONDecodeError):
        return None
    if data.pop("sources") != fingerprint() and not any_sources:
        return None
    return Kept(**{**data, "figures": figures_from(data["figures"])})


def figures_from(data: Mapping[str, Any] | None) -> Figures | None:
    """Return figures from what JSON makes of them."""
    return None if data is None else Figures(**data)
