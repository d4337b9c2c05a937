"""``python3 -m benchmarks.hard``: run the hard cases, judge them, write the page."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from benchmarks.hard.alternatives import section
from benchmarks.hard.families import families
from benchmarks.hard.page import page, picture_name, table, write
from benchmarks.hard.row import Family, Picture, Row, is_good, verdict
from benchmarks.hard.store import ROOT, Kept, fingerprint, load, save
from benchmarks.hard.worker import work
from wovenfab.record.results import Provenance, this_process

RESULTS = Path("results") / "hard"


def run(
    names: Annotated[
        list[str] | None, typer.Argument(help="Rows, by the beginning of their names; else all.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Run the small versions.")] = False,
    again: Annotated[bool, typer.Option("--again", help="Run what has been run, too.")] = False,
    draw: Annotated[bool, typer.Option("--draw", help="Only draw and write what is kept.")] = False,
    only_list: Annotated[bool, typer.Option("--list", help="Only print the rows.")] = False,
) -> None:
    """Run hard cases; exit code 1 if one of them fails."""
    wanted = [_chosen(family, names or [], quick) for family in families()]
    rows = [row for family in wanted for row in family.rows]
    if only_list:
        print("\n".join(f"{row.name:24} {row.title}" for row in rows))
        return
    folder = RESULTS / "quick" if quick else RESULTS
    kept: dict[str, Kept] = {}
    for row in rows:
        path = folder / f"{row.name}.json"
        found = None if again else load(path, any_sources=draw)
        if found is None and not draw:
            found = work(row, quick)
            save(found, path)
        if found is not None:
            kept[row.name] = found
            _tell(row, found)
    print("\n" + table(wanted, kept))
    if not quick and not names:
        publish(kept)
    passed = [row.name for row in rows if row.name in kept and is_good(row, kept[row.name].figures)]
    missed = [row.name for row in rows if row.name not in passed]
    print(f"{len(passed)} of {len(rows)} as they should be" + _listed(missed))
    sys.exit(1 if missed else 0)


def _chosen(family: Family, names: list[str], quick: bool) -> Family:
    """Return a family with the rows that are wanted, the small ones if so."""
    rows = [r for r in family.rows if not names or any(r.name.startswith(n) for n in names)]
    return replace(family, rows=tuple(row.small() if quick else row for row in rows))


def publish(kept: dict[str, Kept]) -> None:
    """Draw the pictures and write the page."""
    docs = ROOT / "docs"
    for family in families():
        found = {row.name: kept[row.name].figures for row in family.rows if row.name in kept}
        figures = {name: f for name, f in found.items() if f is not None}
        if figures:
            path = docs / "pictures" / picture_name(family)
            family.draw(figures, Picture(path, origin(found, kept)))
    write(page(families(), kept, section(compared())), docs / "hard-cases.md")
    print("written: docs/hard-cases.md")


def origin(names: Iterable[str], kept: Mapping[str, Kept]) -> Provenance:
    """Return what made the results of some rows and draws them now."""
    made = Provenance("make hard", this_process().commit)
    for name in names:
        made = Provenance("make hard", kept[name].commit).then(made)
    return made


def compared() -> dict[str, dict[str, dict[str, Any]]]:
    """Return what other ways to a solution cost, measured in a process of their own."""
    path = RESULTS / "alternatives.json"
    mark = path.with_suffix(".sources")
    if not path.exists() or not mark.exists() or mark.read_text() != fingerprint():
        command = [sys.executable, "-m", "benchmarks.hard.alternatives", str(path)]
        subprocess.run(command, check=True)
        mark.write_text(fingerprint())
    found: dict[str, dict[str, dict[str, Any]]] = json.loads(path.read_text(encoding="utf-8"))
    return found


def _tell(row: Row, kept: Kept) -> None:
    said = verdict(row, kept.figures, kept.failure)
    print(f"{row.name:24} {kept.seconds:6.1f} s {kept.memory:5.1f} GB  {said}", flush=True)


def _listed(missed: list[str]) -> str:
    return "; not: " + ", ".join(missed) if missed else ""


if __name__ == "__main__":
    typer.run(run)
