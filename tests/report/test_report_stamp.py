"""Every picture says which command and which commit made it."""

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

from wovenfab.record.results import Provenance, draw_in_subprocess, this_process
from wovenfab.record.summary import read_summary
from wovenfab.report.run_data import origin_of
from wovenfab.report.style import APART, fill, read_provenance, save, write_png

ROOT = Path(__file__).parents[2]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PICTURES = sorted(
    path for path in (ROOT / "docs").rglob("*") if path.suffix in (".png", ".svg", ".gif")
)
ORIGIN = Provenance("wovenfab run 'a b.yaml' --set x=\"1 <m>\"", "0123456789ab")


@pytest.mark.parametrize("path", PICTURES, ids=lambda path: path.name)
def test_a_picture_of_the_documents_says_how_it_was_made(path: Path) -> None:
    origin = read_provenance(path)
    assert origin.command and not re.search(r"(^|[\s='\"])[/~]", origin.command), (
        "one machine's path"
    )
    assert re.fullmatch(r"[0-9a-f]{12}(; [0-9a-f]{12})*", origin.commit), "code not committed"
    link = re.compile(rf"""(\]\(|src=")[^)"]*\b{re.escape(path.name)}[)"]""")
    shown = {page.name: page.read_text() for page in DOCUMENTS}
    shown = {name: text for name, text in shown.items() if link.search(text)}
    assert shown, "no document shows it"
    if len(shown) > 1:  # the gallery shows pictures of other pages, which it leads to
        shown.pop("gallery.md", None)
    for text in shown.values():
        assert all(command in text for command in origin.command.split("; ")), origin.command


@pytest.mark.parametrize("kind", ["png", "svg"])
def test_what_is_written_is_read_again(kind: str, tmp_path: Path) -> None:
    assert read_provenance(save(Figure(), tmp_path / f"empty.{kind}", ORIGIN)) == ORIGIN


def test_a_picture_without_an_origin_of_its_own_tells_that_of_the_process(tmp_path: Path) -> None:
    assert read_provenance(save(Figure(), tmp_path / "empty.png")) == this_process()


def test_documents_stay_small() -> None:
    assert sum(path.stat().st_size for path in PICTURES) < 3e6


def test_a_png_keeps_white_paper_and_rare_colours(tmp_path: Path) -> None:
    shades = np.array([to_rgb(shade) for shade in APART])
    pixels = np.ones((300, 400, 3))
    pixels[50:250, 50:350] = fill()(np.linspace(0, 1, 300))[:, :3]
    pixels[260:264, 100:128] = np.repeat(shades, 4, axis=0)
    drawn = np.round(255 * pixels).astype(np.uint8)
    path = write_png(Image.fromarray(drawn), tmp_path / "a.png", ORIGIN)
    with Image.open(path) as picture:
        assert picture.mode == "P"
        stored = np.asarray(picture.convert("RGB")).astype(int)
    assert (stored[0, 0] == 255).all()
    assert np.abs(stored - drawn).max() < 12
    assert read_provenance(path) == ORIGIN


@pytest.mark.parametrize(
    ("arguments", "command"),
    [
        (["-m", "tests.report.who", "a b"], "python3 -m tests.report.who 'a b'"),
        (["tests/report/who.py", "-m", "x"], "who.py -m x"),
    ],
)
def test_a_command_is_told_as_people_type_it(arguments: list[str], command: str) -> None:
    said = subprocess.run(
        [sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert said.stdout.splitlines() == [command, f"mpirun -n 2 {command}"]


def test_pictures_of_a_run_tell_the_command_of_the_run(small: Path) -> None:
    summary = read_summary(small)
    run = Provenance(str(summary["command"]), str(summary["commit"]))
    assert run.command == this_process().command  # the made-up run was made here
    drawn = draw_in_subprocess(small).paths
    assert {read_provenance(path).command for path in drawn} == {run.command}


def test_a_later_command_is_told_beside_the_first() -> None:
    run, again = ORIGIN, Provenance("wovenfab report a", "ba9876543210")
    assert run.then(again) == Provenance(
        f"{run.command}; wovenfab report a", f"{run.commit}; {again.commit}"
    )
    assert run.then(replace(again, commit=run.commit)).commit == run.commit
    assert run.then(run) == run


def test_a_run_without_a_summary_has_pictures_of_this_process(small: Path) -> None:
    (small / "summary.json").unlink()
    assert origin_of(small) == this_process()


@pytest.mark.parametrize("kind", ["png", "svg"])
def test_a_picture_is_not_drawn_through_a_link(kind: str, tmp_path: Path) -> None:
    outside, picture = tmp_path / "precious", tmp_path / f"loop.{kind}"
    outside.write_text("mine")
    picture.symlink_to(outside)
    save(Figure(), picture)
    assert outside.read_text() == "mine" and not picture.is_symlink()
    assert read_provenance(picture) == this_process()


def test_a_matplotlibrc_in_the_current_folder_changes_nothing(tmp_path: Path) -> None:
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\naxes.facecolor: red\n")
    code = (
        "import matplotlib as mpl; from wovenfab.report.style import house_style\n"
        "with house_style(): print(mpl.rcParams['text.usetex'], mpl.rcParams['axes.facecolor'])\n"
        "print(mpl.rcParams['text.usetex'])"
    )
    command = [sys.executable, "-P", "-c", code]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert ended.stdout.split() == ["False", "white", "True"]
