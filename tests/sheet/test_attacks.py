"""Files and options from elsewhere run no program and write no file."""

from __future__ import annotations

import gzip
import os
import pickle
import re
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from tests.cli.test_commands import CASE
from tests.sheet.test_gmsh_process import PLATE
from wovenfab.case import CaseError, read_case
from wovenfab.case.document import existing_file
from wovenfab.sheet.errors import GeometryError
from wovenfab.sheet.geometry_file import GeometryFile, read_geometry

#: Statements of gmsh that run a program or write a file named "ran".
STATEMENTS = (
    'SystemCall "touch ran";',
    'System "touch ran";',
    'NonBlockingSystemCall "touch ran";',
    'Field[1] = ExternalProcess; Field[1].CommandLine = "touch ran"; Background Field = 1;',
    "a='\"'; SystemCall 'touch ran'; b='\"';",
    'Printf("x") > "ran";',
    'Printf("x") > Str("ran");',
    'Save "ran";',
    'Print "ran";',
    'CreateDir "ran";',
    'f = "evil"; // Merge "x"\nMerge StrCat(f, ".txt");',
    "Merge 'evil.txt';",
    'Include "evil.txt";',
    'OnelabRun("x", "touch ran");',
    'Plugin(MathEval).Run; SystemCall "touch ran";',
)
TOUCH = STATEMENTS[0]
MESH = """$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
3
1 1 "left"
1 2 "right"
2 3 "s"
$EndPhysicalNames
$Nodes
4
1 0 0 0
2 0.9 0 0
3 0.9 0.3 0
4 0 0.3 0
$EndNodes
$Elements
4
1 1 2 1 4 4 1
2 1 2 2 2 2 3
3 2 2 3 1 1 2 3
4 2 2 3 1 1 3 4
$EndElements
"""
_STEP = Path(__file__).parent / "square.step"


def step() -> str:
    return _STEP.read_text()


class Touch:
    """What runs a program as soon as it is read."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        """Return what pickle calls."""
        return os.system, ("touch ran",)


#: Name of the sheet's file, its content, and other files.
FILES: dict[str, tuple[str, str | bytes, dict[str, str]]] = {
    **{f"false mesh: {s}": ("sheet.msh", s + "\n" + PLATE, {}) for s in STATEMENTS},
    **{f"false step: {s}": ("sheet.step", s + "\n", {}) for s in STATEMENTS[:4]},
    "mesh in capitals": ("sheet.MSH", TOUCH + "\n" + PLATE, {}),
    "head, then statements": ("sheet.msh", MESH[: MESH.index("$Phys")] + TOUCH, {}),
    "mesh, then statements": ("sheet.msh", MESH + TOUCH + "\n", {}),
    "comments in a mesh": ("sheet.msh", MESH + f"$Comments\n{TOUCH}\n$EndComments\n", {}),
    "a name that closes its quotes": (
        "sheet.msh",
        MESH.replace('"left"', f'"left"; {TOUCH} "'),
        {},
    ),
    "a view in a mesh": ("sheet.msh", MESH + f'View "x" {{ {TOUCH} }};\n', {}),
    "packed statements": ("sheet.msh", gzip.compress(TOUCH.encode()), {}),
    "a pickle": ("sheet.msh", pickle.dumps(Touch()), {}),
    "python": ("sheet.msh", "import os; os.system('touch ran')\n", {}),
    "step in a mesh": ("sheet.msh", "ISO-10303-21;\n" + TOUCH, {}),
    "options beside a mesh": ("sheet.msh", MESH, {"sheet.msh.opt": TOUCH, "sheet.opt": TOUCH}),
    "options beside a step": ("sheet.step", step(), {"sheet.step.opt": TOUCH, "sheet.opt": TOUCH}),
    "settings of a user": ("sheet.msh", MESH, {".gmshrc": TOUCH, ".gmsh-options": TOUCH}),
    "settings with a step": ("sheet.step", step(), {".gmshrc": TOUCH, ".gmsh-options": TOUCH}),
    "step, then statements": ("sheet.step", step() + TOUCH + "\n", {}),
    "step with a name": ("sheet.step", step().replace("Open CASCADE", TOUCH), {}),
    "a mesh as step": ("sheet.stp", MESH, {}),
    "modules beside a mesh": ("sheet.msh", MESH, dict.fromkeys(
        ("gmsh.py", "numpy.py", "json.py", "sitecustomize.py"), "open('ran', 'w')\n")),
    "modules beside a step": ("sheet.step", step(), dict.fromkeys(
        ("gmsh.py", "numpy.py", "json.py", "sitecustomize.py"), "open('ran', 'w')\n")),
    "a name for a shell": ("$(touch ran)`touch ran`;touch ran.msh", MESH, {}),
    "a step's name for a shell": ("$(touch ran)`touch ran`;touch ran.step", step(), {}),
}  # fmt: skip


@pytest.mark.parametrize("attack", FILES)
def test_a_mesh_or_step_file_runs_nothing(
    attack: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, content, others = FILES[attack]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    others = {**others, "evil.txt": TOUCH}
    for other, text in others.items():
        (tmp_path / other).write_text(text)
    data = content if isinstance(content, bytes) else content.encode()
    (tmp_path / name).write_bytes(data)
    edges = {"left": (4,)} if name.lower().endswith(("step", "stp")) else {}
    with suppress(GeometryError):
        read_geometry(GeometryFile(tmp_path / name, edges=edges))
    left = {p.name for p in tmp_path.iterdir()} - {".fltk"}  # a folder that FLTK makes, in any case
    assert left == {name, *others}
    assert all((tmp_path / other).read_text() == text for other, text in others.items())
    assert (tmp_path / name).read_bytes() == data


def test_what_the_attacks_change_is_a_sheet_without_them(tmp_path: Path) -> None:
    (tmp_path / "sheet.msh").write_text(MESH)
    (tmp_path / "sheet.step").write_text(step())
    assert len(read_geometry(GeometryFile(tmp_path / "sheet.msh")).triangles) == 2
    edges = {"left": (4,)}
    assert len(read_geometry(GeometryFile(tmp_path / "sheet.step", edges=edges)).curves) == 4


@pytest.mark.parametrize("name", ["sheet.msh", "sheet.step", "sheet.MSH"])
@pytest.mark.parametrize("target", ["x.geo", "x.GEO", "x", "x.py"])
def test_a_name_says_what_is_read_also_of_a_link(name: str, target: str, tmp_path: Path) -> None:
    (tmp_path / target).write_text(TOUCH + "\n" + PLATE)
    (tmp_path / name).symlink_to(target)
    path = tmp_path / "case.yaml"
    sheet = f"sheet: {{file: {name}, fibres: [45 deg, -45 deg]}}"
    path.write_text(re.sub(r"^sheet:.*(\n .*)*", sheet, CASE, flags=re.MULTILINE))
    with pytest.raises(CaseError) as refused:
        read_case(path)
    assert "sheet.file" in {problem.key for problem in refused.value.problems}


def test_a_link_to_a_file_of_its_kind_is_followed(tmp_path: Path) -> None:
    (tmp_path / "plate.geo").write_text(PLATE)
    (tmp_path / "sheet.geo").symlink_to("plate.geo")
    assert existing_file("sheet.geo", tmp_path, (".geo",)) == (tmp_path / "plate.geo").resolve()


#: Files of options that PETSc would read in the current folder.
OPTION_FILES = {
    ".petscrc": "-ksp_view_mat ascii:victim\n-log_view :victim\n",
    "petscrc": "-pc_type python\n-pc_python_type evil.X\n-log_view :victim\n",
}


@pytest.mark.parametrize(
    "start",
    ["import wovenfab.interface", "import wovenfab.mpi; wovenfab.mpi.start_petsc(['-a', '1'])"],
)
def test_petsc_reads_no_options_of_the_current_folder(start: str, tmp_path: Path) -> None:
    for name, text in OPTION_FILES.items():
        (tmp_path / name).write_text(text)
    code = f"{start}\nfrom petsc4py import PETSc\nprint(*PETSc.Options().getAll())"
    command = [sys.executable, "-P", "-c", code]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert {*ended.stdout.splitlines()[0].split()} <= {"skip_petscrc", "a"}
    assert {p.name for p in tmp_path.iterdir()} == {*OPTION_FILES}


#: PETSc options by which a case could load code, run it or write files.
OPTIONS = (
    {"pc_type": "python", "pc_python_type": "x.Y"},
    {"pc_python_type": "x.Y"},
    {"ksp_type": "python"},
    {"ksp_python_type": "x.Y"},
    {"snes_type": "python", "snes_python_type": "x.Y"},
    {"mat_type": "python"},
    {"ksp_view_mat": "ascii:victim"},
    {"ksp_view_mat": "binary:victim"},
    {"ksp_view": "ascii:victim"},
    {"ksp_view_solution": "binary:victim"},
    {"ksp_monitor": "ascii:victim"},
    {"ksp_converged_reason": "ascii:victim"},
    {"snes_monitor": "ascii:victim"},
    {"snes_monitor": ":victim"},
    {"snes_monitor_solution": "binary:victim"},
    {"snes_view": ":victim:ascii_xml"},
    {"snes_linesearch_monitor": "victim"},
    {"snes_view_solution": "hdf5:victim"},
    {"log_view": ":victim"},
    {"log_trace": "victim"},
    {"info": ":victim"},
    {"history": "victim"},
    {"options_file": "evil.txt"},
    {"options_monitor": "ascii:victim"},
    {"dll_prepend": "evil.so"},
    {"dll_append": "evil.so"},
    {"on_error_attach_debugger": "touch"},
    {"start_in_debugger": "touch"},
    {"debugger_nodes": "0"},
    {"on_error_emacs": "touch ran"},
    {"malloc_dump": "victim"},
    {"mat_mumps_ooc_tmpdir": "."},
    {"mat_mumps_icntl_22": 1},
    {"mat_mumps_icntl_1": 99},
    {"mat_mumps_icntl_2": 99},
    {"mat_mumps_icntl_3": 99},
    {"mat_mumps_icntl_4": "4:victim"},
    {"pc_factor_mat_solver_type": "evil"},
    {"pc_hypre_boomeramg_print_debug": 1},
    {"PC_Python_Type": "x.Y"},
    {"-pc_python_type": "x.Y"},
    {"ksp_type cg -pc_python_type": "x.Y"},
    {"ksp_rtol": "1 -log_view :victim"},
    {"ksp_rtol\n-log_view": ":victim"},
    {"wovenfab_1_ksp_view_mat": "ascii:victim"},
    {"newton_ksp_view": "ascii:victim"},
    {"viewer_binary_filename": "victim"},
    {"saws_port_auto_select": True},
    {"prefix_push": "x"},
    {"ksp_rtol": "\u0663"},
    {"ksp_type": "gmres", "ksp_gmres_restart": 999_999_999},
    {"ksp_type": "cg", "pc_type": "eisenstat"},
)


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_a_case_has_no_petsc_option_that_runs_or_writes(
    options: dict[str, str | int], tmp_path: Path
) -> None:
    import yaml

    path = tmp_path / "case.yaml"
    path.write_text(CASE + yaml.safe_dump({"solver": {"petsc": options}}))
    with pytest.raises(CaseError) as refused:
        read_case(path)
    assert {p.key.split(".")[1] for p in refused.value.problems} == {"petsc"}
    assert all(p.line is not None for p in refused.value.problems)


@pytest.mark.parametrize(
    "options",
    [
        {"ksp_type": "gmres", "ksp_rtol": 1e-12, "pc_type": "lu"},
        {"pc_factor_mat_solver_type": "mumps", "mat_mumps_icntl_14": 50, "mat_mumps_cntl_1": 0.1},
        {"snes_monitor": "", "ksp_view": "", "snes_max_it": 7, "snes_type": "newtonls"},
        {"mat_mumps_icntl_7": 5, "mat_mumps_icntl_23": 1000, "mat_mumps_icntl_35": 1},
        {"pc_type": "ilu", "pc_factor_levels": 2, "ksp_gmres_restart": 100},
    ],
    ids=str,
)
def test_a_case_has_options_that_act_on_the_solution(
    options: dict[str, str | int | float], tmp_path: Path
) -> None:
    import yaml

    path = tmp_path / "case.yaml"
    path.write_text(CASE + yaml.safe_dump({"solver": {"petsc": options}}))
    assert read_case(path).solver.petsc == options


def test_results_from_elsewhere_are_not_resumed_with_such_options(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("whole\n")
    folder = tmp_path / "results"
    folder.mkdir()
    case = CASE + f"solver: {{petsc: {{ksp_view_mat: 'ascii:{victim}'}}}}\n"
    (folder / "case.yaml").write_text(case)
    command = [sys.executable, "-m", "wovenfab", "resume", str(folder)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 2 and "solver.petsc.ksp_view_mat" in ended.stderr
    assert "Traceback" not in ended.stderr
    assert victim.read_text() == "whole\n"
    assert [p.name for p in folder.iterdir()] == ["case.yaml"]
