"""The picture of README.md shows what docs/accuracy.md has in its tables."""

from __future__ import annotations

from pathlib import Path

from benchmarks.accuracy_picture import BOTH, PAGE, SPACE, draw, rows


def test_every_run_of_the_tables_is_read() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for table, least in ((SPACE, 10), (BOTH, 3)):
        runs = list(rows(page, table))
        part = page.split("## Two placements, slip friction")[1].split(table)[1].split("\n\n")[1]
        assert len(runs) == len(part.splitlines()) - 2 >= least
        assert all(0 < run.error < 1 and run.seconds > 0 for run in runs)


def test_the_error_is_that_of_the_worst_quantity_and_bounds_are_known(tmp_path: Path) -> None:
    page = """
## Two placements, slip friction

**Space**

| setting | unknowns | steps | iterations | wall (s) | memory (MB) | a: error | b: error |
|---|---:|---:|---:|---:|---:|---:|---:|
| P2 on fibres, 75 mm | 18 | 10 | 39 | 0.6 | 197 | 3.5 % (1.9) | 9.1 % (2.1) |
| P2 on fibres, 37.5 mm | 66 | 10 | 39 | 1.8 | 216 | ≤ 0.92 % | 0.5 % (2.1) |

**Both together**

| setting | unknowns | steps | iterations | wall (s) | memory (MB) | a: error | b: error |
|---|---:|---:|---:|---:|---:|---:|---:|
| P4 on fibres, 75 mm, bdf3, 80 steps | 66 | 80 | 232 | 5.8 | 229 | 0.014 % | 0.062 % |
"""
    first, second = rows(page, SPACE)
    assert (first.method, first.seconds, first.error, first.bound) == (
        "P2 on fibres",
        0.6,
        0.091,
        False,
    )
    assert (second.error, second.bound) == (0.0092, True)
    assert [run.error for run in rows(page, BOTH)] == [0.062 / 100]
    assert draw(page, tmp_path / "a.png").stat().st_size > 1000
