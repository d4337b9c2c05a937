"""Every picture says which command and which commit made it."""

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from wovenfab.record.results import Provenance, this_process
from wovenfab.record.summary import read_summary
from wovenfab.report import draw_in_subprocess
from wovenfab.report.run_data import origin_of
from wovenfab.report.style import read_provenance, save

ROOT = Path(__file__).parents[2]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PICTURES = sorted(
    path for path in (ROOT / "docs").rglob("*") if path.suffix in (".png", ".svg", ".gif")
)
ORIGIN = Provenance("wovenfab run 'a b.yaml' --set x=\"1 <m>\"", "0123456789ab")


def faults(origin: Provenance) -> list[str]:
    """Return what keeps others from making a published picture again, in words."""
    problems = []
    if not origin.command:
        problems.append("it does not say which command made it")
    if re.search(r"(^|[\s='\"])[/~]", origin.command):
        problems.append(f"its command has a path of one machine: {origin.command}")
    if not re.fullmatch(r"[0-9a-f]{12}(; [0-9a-f]{12})*", origin.commit):
        problems.append(
            f"its commit is {origin.commit!r}: draw it through env/enter, from committed code"
        )
    return problems


@pytest.mark.parametrize("path", PICTURES, ids=lambda path: path.name)
def test_a_picture_of_the_documents_says_how_it_was_made(path: Path) -> None:
    origin = read_provenance(path)
    assert faults(origin) == [], "make pictures"
    link = re.compile(rf"""(\]\(|src=")[^)"]*\b{re.escape(path.name)}[)"]""")
    shown = [text for text in map(Path.read_text, DOCUMENTS) if link.search(text)]
    assert shown, "no document shows it"
    for text in shown:
        assert all(command in text for command in origin.command.split("; ")), origin.command


@pytest.mark.parametrize("kind", ["png", "svg"])
def test_what_is_written_is_read_again(kind: str, tmp_path: Path) -> None:
    assert read_provenance(save(Figure(), tmp_path / f"empty.{kind}", ORIGIN)) == ORIGIN


def test_a_picture_without_an_origin_of_its_own_tells_that_of_the_process(tmp_path: Path) -> None:
    assert read_provenance(save(Figure(), tmp_path / "empty.png")) == this_process()


@pytest.mark.parametrize(
    ("origin", "fault"),
    [
        (Provenance("", "0123456789ab"), "which command"),
        (Provenance("wovenfab run /home/me/a.yaml", "0123456789ab"), "one machine"),
        (Provenance("wovenfab run a.yaml -o ~/b", "0123456789ab"), "one machine"),
        (Provenance("wovenfab run a.yaml", ""), "its commit is ''"),
        (Provenance("wovenfab run a.yaml", "0123456789ab+"), "committed code"),
    ],
)
def test_what_cannot_be_made_again_is_found(origin: Provenance, fault: str) -> None:
    (found,) = faults(origin)
    assert fault in found


def test_nothing_is_wrong_with_a_good_one() -> None:
    assert faults(ORIGIN) == []
    assert faults(Provenance("wovenfab run a/b.yaml; wovenfab report a", "0" * 12)) == []


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
