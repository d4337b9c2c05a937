"""Good cases: what they mean, and that what is written reads as the same."""

from __future__ import annotations

import math
import pickle
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from ruamel.yaml import YAML

from tests.case.reading import WriteCase, again
from wovenfab.case import (
    Case,
    Component,
    CyclesSection,
    Rectangle,
    SheetFile,
    TableSection,
    read_case,
)
from wovenfab.forms import effects
from wovenfab.forms.effect import Parameter

CONFIGS = sorted((Path(__file__).parents[2] / "configs").glob("*.yaml"))


def _equal(a: Case, b: Case) -> bool:
    return a == b and repr(a) == repr(b) and a.name == b.name


def test_the_example_is_read_in_si(example: str, write_case: WriteCase) -> None:
    case = read_case(write_case(example))
    assert case.name == "case"
    assert isinstance(case.sheet, Rectangle)
    assert (case.sheet.length, case.sheet.width) == (0.9, 0.3)
    assert case.sheet.fibres == (math.pi / 4, -math.pi / 4)
    assert case.effects == {
        "stretch": {"stiffness": (1.27e8, 1.27e8)},
        "shear": {"stiffness": 400.0},
        "bending": {"stiffness": (254.1, 254.1)},
        "coupling": {"stiffness": 6e7},
        "slip_friction": {"strength": 199200.0, "slope": 70.0},
    }
    ((left,), (right,)) = case.boundary["left"], case.boundary["right"]
    assert left.components == (Component(), Component())
    assert right.components == (Component(factor=1.0), Component())
    assert not right.rotation
    assert right.families == (1, 2)
    (cycles,) = case.program
    assert isinstance(cycles, CyclesSection)
    assert cycles.amplitudes == (0.02, 0.04, 0.06)
    assert cycles.max_velocity == (0.5,)
    assert (case.discretisation.degree, case.discretisation.mesh_size) == (3, 0.03)
    assert case.output.every == 10


def test_defaults_follow_from_sheet_and_effects(example: str, write_case: WriteCase) -> None:
    text = example[: example.index("discretisation:")]
    for line in ("coupling", "slip_friction", "bending"):
        text = "\n".join(row for row in text.split("\n") if f"  {line}:" not in row)
    case = read_case(write_case(text))
    assert case.discretisation.mesh_size == pytest.approx(0.075)
    assert case.discretisation.mesh == "fibres"
    assert case.output.fields == ("displacement", "shear_angle", "stretch")
    assert not case.needs.second_gradient
    assert case.needs.placements == 1


@pytest.mark.parametrize(
    ("text", "rotation"),
    [
        ("clamp", False),
        ("{clamp: placement}", False),
        ("{clamp: rotation}", True),
        ("{displacement: [0, 0], rotation: held}", True),
        ("{displacement: [0 mm, 0.0], rotation: free}", False),
    ],
)
def test_all_ways_to_clamp_mean_the_same(
    text: str, rotation: bool, example: str, write_case: WriteCase
) -> None:
    case = read_case(write_case(example.replace("left: clamp", f"left: {text}")))
    (left,) = case.boundary["left"]
    assert left.components == (Component(), Component())
    assert left.rotation is rotation


def test_components_are_held_moved_shifted_or_free(example: str, write_case: WriteCase) -> None:
    text = example.replace("left: clamp", "left: {displacement: [-program, 0]}")
    text = text.replace(
        "right: {displacement: [program, 0]}", "right: {displacement: [5 mm, free]}"
    )
    case = read_case(write_case(text))
    ((left,), (right,)) = case.boundary["left"], case.boundary["right"]
    assert left.components == (Component(factor=-1.0), Component())
    assert right.components == (Component(offset=0.005), Component(held=False))


def test_a_table_is_read_from_beside_the_case(example: str, tmp_path: Path) -> None:
    (tmp_path / "u.csv").write_text("note,displacement_m,time_s\na,0,0\nb,1e-3,0.5\nc,0,1\n")
    start, end = example.index("  type: cycles"), example.index("discretisation:")
    text = example[:start] + "  type: table\n  file: u.csv\n" + example[end:]
    path = tmp_path / "measured.yaml"
    path.write_text(text)
    case = read_case(path)
    table = case.program[0]
    assert isinstance(table, TableSection)
    assert table.samples.times == (0.0, 0.5, 1.0)
    assert table.samples.values == (0.0, 1e-3, 0.0)
    assert _equal(again(case, tmp_path / "elsewhere"), case)


def test_a_sheet_from_a_file_keeps_its_edges_and_file(example: str, tmp_path: Path) -> None:
    (tmp_path / "bone.geo").write_text("")
    start, end = example.index("  shape:"), example.index("  fibres:")
    text = example[:start] + "  file: bone.geo\n" + example[end:].replace("left:", "grip:")
    path = tmp_path / "bone.yaml"
    path.write_text(text)
    case = read_case(path)
    assert isinstance(case.sheet, SheetFile)
    assert case.sheet.file == tmp_path / "bone.geo"
    assert set(case.boundary) == {"grip", "right"}
    assert case.discretisation.mesh is None
    assert _equal(again(case, tmp_path / "elsewhere"), case)


@pytest.mark.parametrize("path", CONFIGS, ids=lambda p: p.stem)
def test_the_cases_that_are_shipped_are_good(path: Path, tmp_path: Path) -> None:
    case = read_case(path)
    assert case.name == path.stem
    assert _equal(again(case, tmp_path), case)


def test_there_are_cases_shipped() -> None:
    tests = {"bias-1x3", "uniaxial", "biaxial", "shear", "picture-frame", "pantograph"}
    assert tests <= {p.stem for p in CONFIGS}


def test_a_case_cannot_be_changed_and_can_be_sent(example: str, write_case: WriteCase) -> None:
    case = read_case(write_case(example))
    with pytest.raises(ValidationError):
        case.time.scheme = "midpoint"
    assert _equal(pickle.loads(pickle.dumps(case)), case)


def test_what_is_written_names_every_default(example: str, write_case: WriteCase) -> None:
    text = example[: example.index("discretisation:")]
    written = YAML(typ="safe").load(read_case(write_case(text)).to_yaml())
    newton = {"max_iterations", "tolerance", "tangent", "predictor", "factor", "petsc"}
    assert set(written["solver"]) == newton | {"stability", "seed"}
    assert written["solver"]["stability"] == "stop"
    assert set(written["time"]) == {"steps_per_cycle", "scheme", "smallest_step", "extra_times"}
    assert set(written["output"]) == {"fields", "every", "pictures", "checkpoint", "probes"}
    assert written["discretisation"]["penalty"] == "auto"
    assert written["sheet"]["length"] == "0.9 m"
    assert written["effects"]["slip_friction"]["slope"] == "70 s/m"


POSITIVE = st.floats(min_value=1e-6, max_value=1e12)
ANY = st.floats(-9, 9).filter(lambda value: value == 0 or abs(value) > 1e-49)
SMALL = st.floats(min_value=1e-6, max_value=0.1)
SPEED = st.sampled_from(["max_velocity", "frequency"])


def _cycles(amplitudes: list[float], speed: str, value: float) -> dict[str, Any]:
    return {"type": "cycles", "amplitudes": amplitudes, speed: value}


SEGMENTS = st.one_of(
    st.builds(_cycles, st.lists(SMALL, min_size=1, max_size=3), SPEED, POSITIVE),
    st.builds(
        lambda time, steps: {"type": "hold", "duration": time, "steps": steps},
        POSITIVE,
        st.integers(1, 9),
    ),
)
LEFT = st.sampled_from(["clamp", {"clamp": "rotation"}, {"displacement": ["-program", 0]}])
RIGHT = st.builds(
    lambda y, rotation: {"displacement": ["program", y], "rotation": rotation},
    ANY | st.sampled_from(["free", "y/10 + program^2/1 m"]),
    st.sampled_from(["free", "held"]),
)
TOP = st.builds(
    lambda x, y, held: {"force": [x, y], "rotation": held},
    ANY.map("{!r} N/m".format) | st.just("9 Pa*program"), st.just("10 N/m*sin(x/1 m)"),
    st.sampled_from(["free", "held"]),
)  # fmt: skip


def _value(p: Parameter) -> st.SearchStrategy[Any]:
    """Return numbers and formulas above 1, which every parameter may be."""
    least = st.floats(min_value=2, max_value=1e12)
    unit = "" if p.unit == "1" else p.unit
    formula = least.map(lambda v: f"{v!r} {unit} * (1 + x/1 m)")
    if not p.per_family:
        return least | formula
    written = least.map(lambda v: f"{v!r} {unit}") | formula  # in a list all have units, or none
    return st.lists(least, min_size=2, max_size=2) | st.lists(written, min_size=2, max_size=2)


PARAMETERS: dict[str, st.SearchStrategy[Any]] = {
    name: st.fixed_dictionaries({p.name: _value(p) for p in effect.parameters})
    for name, effect in effects().items()
}
#: With these a sheet comes to rest under any load.
SOUND = ("stretch", "bending", "coupling")
DATA: st.SearchStrategy[dict[str, Any]] = st.fixed_dictionaries(
    {
        "title": st.text(),
        "sheet": st.fixed_dictionaries({
            "length": st.floats(0.5, 100), "width": st.floats(0.5, 100),
            "fibres": st.tuples(st.floats(0.1, 3), st.floats(-3, -0.1)).filter(
                lambda a: abs(math.sin(a[1] - a[0])) > 2e-3).map(list),
        }),
        "effects": st.fixed_dictionaries(
            {n: PARAMETERS[n] for n in SOUND},
            optional={n: PARAMETERS[n] for n in effects() if n not in SOUND}),
        "boundary": st.fixed_dictionaries({"left": LEFT, "right": RIGHT}, optional={"top": TOP}),
        "program": st.lists(SEGMENTS, min_size=1, max_size=3),
    },
    optional={
        "discretisation": st.fixed_dictionaries({}, optional={
            "degree": st.integers(2, 4), "mesh_size": st.floats(0.05, 0.5),
            "penalty": st.just("auto") | POSITIVE, "quadrature_degree": st.integers(1, 20)}),
        "time": st.fixed_dictionaries({}, optional={
            "scheme": st.sampled_from(["bdf2", "midpoint"]), "smallest_step": st.floats(1e-9, 1)}),
        "solver": st.fixed_dictionaries({}, optional={
            "tolerance": st.floats(1e-15, 1),
            "petsc": st.dictionaries(st.sampled_from(["ksp_max_it", "pc_factor_fill", "ksp_rtol"]),
                                     st.booleans() | st.integers()
                                     | st.floats(allow_nan=False, allow_infinity=False))}),
        "output": st.just({"fields": [], "pictures": False}),
    },
)  # fmt: skip


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=DATA)
def test_any_case_is_written_and_read_as_the_same(data: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "any.yaml"
    with path.open("w", encoding="utf-8") as stream:
        YAML(typ="safe", pure=True).dump(data, stream)
    case = read_case(path)
    assert _equal(again(case, tmp_path), case)
