"""A run over a measured curve: what is drawn is what is compared, and all of it is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from wovenfab.cli.report import report_results, show_measured
from wovenfab.measured.layout import Layout
from wovenfab.report.run_data import open_run_data


def curve(folder: Path, text: str) -> Path:
    path = folder / "a$b_[red].csv"
    path.write_text(text)
    return path


def on_the_lines(directory: Path, form: str) -> str:
    """Return points half way between the steps of a run, and those at the steps, as text."""
    history = open_run_data(directory).history
    u, force = history["displacement_m"], history["force_N"]
    steps = np.arange(len(u))
    at = np.arange(0, len(u) - 0.5, 0.5)
    pairs = zip(1e3 * np.interp(at, steps, u), np.interp(at, steps, force), strict=True)
    return "".join(form.format(*pair) for pair in pairs)


@pytest.mark.slow
def test_points_on_the_drawn_line_have_no_distance_in_any_wording(
    small: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain = curve(small, "displacement_mm,force_N\n" + on_the_lines(small, "{:.9f},{:.9f}\n"))
    assert report_results([small], None, lab=plain) == 0
    said = capsys.readouterr().out
    assert ": 0.00 % of the largest force" in said and "rows are compared" not in said
    other = on_the_lines(small, "{1:.9f};{0:.9f}\n").replace(".", ",")
    path = curve(small, "a;b\n" + other)
    layout = Layout({"displacement": 2, "force": 1}, {"displacement": "mm", "force": "N"})
    assert report_results([small], None, lab=path, layout=layout) == 0
    assert ": 0.00 % of the largest force" in capsys.readouterr().out
    assert (small / "lab.png").stat().st_size > 10_000
    assert report_results([small], None, layout=layout) == 2
    assert "--lab" in capsys.readouterr().err


def test_the_command_shows_what_is_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = "".join(f"{u},5;{2 * u},25\n" for u in (*range(20), *range(18, 4, -1)))
    path = curve(tmp_path, f"Weg [mm];[/b]Kraft\x1b[31m [kN]\n{rows}3,5;NaN\n")
    assert show_measured(path) == 0
    said = capsys.readouterr().out
    for part in ("decimal comma", "34 rows", "1 skipped", "branches: 2 (0.5 to 19.5 to 5.5 mm)"):
        assert part in said
    assert "largest force: 38250 N at 19.5 mm (line 21)" in said
    assert "[/b]" in said and "\x1b" not in said
