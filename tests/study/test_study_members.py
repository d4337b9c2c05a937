"""What a sweep runs: grids, named runs and case files, each under a name of its own."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from wovenfab.case import CaseError, Rectangle
from wovenfab.case.program import program_of_case
from wovenfab.study.sweep import Member, members_of
from wovenfab.study.variations import folder_of_run, grid, is_sweep_file, read_over, read_sweep_file

CONFIGS = sorted((Path(__file__).parents[2] / "configs").glob("*.yaml"))
BIAS = Path(__file__).parents[2] / "configs" / "bias-1x3.yaml"


def over(*texts: str, paths: tuple[Path, ...] = (BIAS,)) -> list[Member]:
    return members_of(paths, grid([read_over(text) for text in texts]))


def length(member: Member) -> float:
    assert isinstance(member.case.sheet, Rectangle)
    return member.case.sheet.length


def test_every_combination_is_a_member() -> None:
    members = over("sheet.length=0.6 m,0.9 m,1.2 m", "effects.slip_friction.slope=70,700 s/m")
    assert [m.label for m in members[:2]] == [
        "length=0.6 m, slope=70 s/m",
        "length=0.6 m, slope=700 s/m",
    ]
    assert members[1].name == "length=0.6m,slope=700s_m"
    lengths = [(length(m), m.case.effects["slip_friction"]["slope"]) for m in members]
    assert lengths == [(a, b) for a in (0.6, 0.9, 1.2) for b in (70.0, 700.0)]


def test_lists_and_mappings_are_values_too() -> None:
    (one, two) = over("program.amplitudes=[20 mm],[20 mm, 40 mm]")
    assert [m.steps for m in (one, two)] == [80, 160]
    assert len({one.name, two.name}) == 2
    (only,) = over("program={type: ramp, to: 40 mm, steps: 7, velocity: 1 m/s}")
    assert only.steps == 7


def test_keys_that_end_alike_are_distinguished() -> None:
    (member,) = over("effects.bending.stiffness=1", "effects.stretch.stiffness=2")
    assert member.label == "bending.stiffness=1, stretch.stiffness=2"


def test_null_takes_out() -> None:
    without, other = over("effects.slip_friction=null,{slope: 7, strength: 1}")
    assert "slip_friction" not in without.case.effects
    assert other.case.effects["slip_friction"] == {"slope": 7.0, "strength": 1.0}


def test_case_files_are_members_by_their_names() -> None:
    members = over(paths=(CONFIGS[0], CONFIGS[1]))
    assert [m.name for m in members] == [CONFIGS[0].stem, CONFIGS[1].stem]


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_the_planned_steps_are_those_of_the_program(path: Path) -> None:
    (member,) = over(paths=(path,))
    assert member.steps == len(program_of_case(member.case).milestones) - 1


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (
            ["sheet.length"],
            "--over: expected 'key=value,value', got 'sheet.length'. For example --over "
            '"effects.bending.stiffness=24 N*m,254 N*m".',
        ),
        (["sheet.length="], "--over sheet.length: no value is given."),
        (["sheet.lenght=1,2"], "--over sheet.lenght: unknown key. Did you mean 'length'?"),
        (
            ["sheet.length=1,2 N"],
            "--over sheet.length: expected a length such as '40 mm', got 'N'.",
        ),
        (
            ["sheet.length=1,1"],
            "--over: 2 runs would be called 'length=1'. Give each case and each value once.",
        ),
    ],
)
def test_what_cannot_be_varied_is_reported(texts: list[str], message: str) -> None:
    with pytest.raises(CaseError) as caught:
        over(*texts)
    assert str(caught.value) == message


def sweep_file(folder: Path, text: str) -> Path:
    (folder / "cases").mkdir()
    (folder / "cases" / "bias.yaml").write_text(BIAS.read_text())
    (folder / "sweep.yaml").write_text(text)
    return folder / "sweep.yaml"


def test_a_sweep_file_names_runs_and_combines_them_with_values(tmp_path: Path) -> None:
    path = sweep_file(
        tmp_path,
        "case: cases/bias.yaml\n"
        "runs:\n"
        "  soft: {effects.bending.stiffness: 24 N*m, effects.stretch.stiffness: 8.55e7}\n"
        "  stiff: {effects.bending.stiffness: 560 N*m}\n"
        "over: {sheet.length: [0.6 m, 0.9 m]}\n",
    )
    assert is_sweep_file(path)
    assert not is_sweep_file(BIAS)
    content = read_sweep_file(path)
    members = members_of(content.cases, content.variations)
    assert [m.name for m in members] == [
        "soft,length=0.6m",
        "soft,length=0.9m",
        "stiff,length=0.6m",
        "stiff,length=0.9m",
    ]
    assert members[0].case.effects["stretch"]["stiffness"] == (8.55e7, 8.55e7)
    assert members[3].case.effects["stretch"]["stiffness"] == (1.27e8, 1.27e8)


@pytest.mark.parametrize(
    "name",
    ["overlay.png", "Overlay.PNG", "sweep.csv", "choices.jsonl", "a.log", ".", "..", "...", "/",
     ".hidden", "*", "../", "n" * 300],
)  # fmt: skip
def test_a_run_is_not_called_like_what_the_sweep_writes(name: str, tmp_path: Path) -> None:
    text = f"case: cases/bias.yaml\nruns:\n  ok: {{title: a}}\n  {name!r}: {{title: b}}\n"
    path = sweep_file(tmp_path, text)
    with pytest.raises(CaseError, match=r"sweep\.yaml:4: runs\."):
        read_sweep_file(path)


@pytest.mark.parametrize("name", ["overlay.png", "a.log", ".."])
def test_a_case_file_is_not_called_like_what_the_sweep_writes(name: str, tmp_path: Path) -> None:
    path = tmp_path / f"{name}.yaml"
    path.write_text(BIAS.read_text())
    with pytest.raises(CaseError, match=re.escape(f"'{name}' ")):
        members_of([path, BIAS])


@pytest.mark.parametrize("name", ["a.logs", "overlay", "0.5", "a..b", "\u00fcberlang", "x.png"])
def test_other_names_are_folders(name: str) -> None:
    assert folder_of_run(name) == name


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("case: no.yaml", ":1: case: there is no file 'no.yaml'. Names are relative to the case"),
        ("case: cases/bias.yaml\novr: 1", ":2: ovr: unknown key. Did you mean 'over'?"),
        ("case: cases/bias.yaml\nover: {a: 1}", ":2: over.a: expected a list, got 1."),
        ("case: cases/bias.yaml\nover: {a: []}", ":2: a: no value is given."),
        (
            "case: cases/bias.yaml\nruns: {a: }",
            ":2: runs.a: expected keys with values, got",
        ),
        ("case: cases/bias.yaml\nruns: {a: {}}", ":2: runs.a: no value is given."),
        (
            "case: cases/bias.yaml\nruns:\n  a: {time.scheme: bdf2}\n  b:\n    time.scheme: bdf4",
            ":5: time.scheme: expected 'bdf2', 'bdf3', 'backward-euler' or 'midpoint', got 'bdf4'.",
        ),
        (
            "case: cases/bias.yaml\nover:\n  effects.shear.stiffness: [1 N/m, 2 N]",
            ":3: effects.shear.stiffness: expected a force per length such as '400 N/m', got 'N'",
        ),
    ],
)
def test_a_mistake_in_a_sweep_file_is_reported_with_its_line(
    text: str, message: str, tmp_path: Path
) -> None:
    path = sweep_file(tmp_path, text)
    with pytest.raises(CaseError) as caught:
        file = read_sweep_file(path)
        members_of(file.cases, file.variations)
    assert f"{path}{message}" in str(caught.value)
