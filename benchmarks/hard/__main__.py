"""``python3 -m benchmarks.hard``: run the hard cases, judge them, write the page."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from benchmarks.hard import alternatives
from benchmarks.hard.families import families
from benchmarks.hard.page import page, picture_name, table
from benchmarks.hard.results import ROOT, SOURCES, Result, row_fingerprint, run_row
from benchmarks.hard.row import Family, Picture, is_good, verdict
from wovenfab.case.fingerprint import fingerprint
from wovenfab.record.results import Provenance, this_process
from wovenfab.study.runner import Command, Store, execute

RESULTS = Path("results") / "hard"


def run(
    names: Annotated[
        list[str] | None, typer.Argument(help="Rows, by the beginning of their names; else all.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Run the small versions.")] = False,
    again: Annotated[bool, typer.Option("--again", help="Run rows with results, too.")] = False,
    draw: Annotated[bool, typer.Option("--draw", help="Only draw and write stored results.")] = (
        False
    ),
    only_list: Annotated[bool, typer.Option("--list", help="Only print the rows.")] = False,
) -> None:
    """Run hard cases; exit code 1 if one of them fails."""
    chosen = [_chosen(family, names or [], quick) for family in families()]
    rows = [row for family in chosen for row in family.rows]
    if only_list:
        print("\n".join(f"{row.name:24} {row.title}" for row in rows))
        return
    store = Store(RESULTS / "quick" if quick else RESULTS)
    results: dict[str, Result] = {}
    for row in rows:
        key = row_fingerprint(row)
        result = None if again else Result.of(store.load(row.name, None if draw else key))
        if result is None and not draw:
            result = run_row(row, quick)
            store.save(row.name, key, asdict(result))
        if result is not None:
            results[row.name] = result
            text = verdict(row, result.figures, result.failure)
            print(f"{row.name:24} {result.seconds:6.1f} s {result.memory:5.1f} GB  {text}")
            sys.stdout.flush()
    print("\n" + table(chosen, results))
    if not quick and not names:
        publish(results)
    passed = [r.name for r in rows if r.name in results and is_good(r, results[r.name].figures)]
    missed = [row.name for row in rows if row.name not in passed]
    listed = "; not: " + ", ".join(missed) if missed else ""
    print(f"{len(passed)} of {len(rows)} as they should be{listed}")
    sys.exit(1 if missed else 0)


def _chosen(family: Family, names: list[str], quick: bool) -> Family:
    """Return a family with the chosen rows, the small ones if so."""
    rows = [r for r in family.rows if not names or any(r.name.startswith(n) for n in names)]
    return replace(family, rows=tuple(row.small() if quick else row for row in rows))


def publish(results: Mapping[str, Result]) -> None:
    """Draw the pictures and write the page."""
    docs = ROOT / "docs"
    for family in families():
        of_family = {row.name: results[row.name] for row in family.rows if row.name in results}
        figures = {name: r.figures for name, r in of_family.items() if r.figures is not None}
        if figures:
            path = docs / "pictures" / picture_name(family)
            family.draw(figures, Picture(path, origin(of_family.values())))
    text = page(families(), results, alternatives.section(compared()))
    (docs / "hard-cases.md").write_text(text, encoding="utf-8")
    print("written: docs/hard-cases.md")


def origin(results: Iterable[Result]) -> Provenance:
    """Return what made some results and draws them now."""
    made = Provenance("make hard", this_process().commit)
    for result in results:
        made = Provenance("make hard", result.commit).then(made)
    return made


def compared() -> Mapping[str, Mapping[str, Mapping[str, Any]]]:
    """Return the cost of other ways to a solution, measured in a process of their own."""
    store, name = Store(RESULTS), "alternatives"
    key = "-".join(fingerprint(s.case, *SOURCES) for s in alternatives.CASES.values())
    tallies: Mapping[str, Mapping[str, Mapping[str, Any]]] | None = store.load(name, key)
    if tallies is None:
        print("other ways to a solution", flush=True)
        ended = execute(Command(["-m", alternatives.__name__], folder=ROOT))
        if ended.failure:
            raise RuntimeError(ended.failure)
        tallies = ended.result
        store.save(name, key, tallies)
    return tallies


if __name__ == "__main__":
    typer.run(run)
