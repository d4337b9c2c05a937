"""Formulas of x, y and the program: what they mean, and what is refused."""

from __future__ import annotations

import json
import math
import pickle
from pathlib import Path

import basix.ufl
import numpy as np
import pytest
import ufl
from hypothesis import given
from hypothesis import strategies as st

from wovenfab.case.errors import FormulaError
from wovenfab.case.formula import (
    NUMPY_FUNCTIONS,
    Expression,
    coefficients,
    is_formula,
    with_change,
    with_coefficient,
)
from wovenfab.case.objects import UFL_FUNCTIONS

AT = {"x": 0.2, "y": 0.5, "program": 0.03}
#: Formula, SI unit, and its value there by Python's own arithmetic.
VALUES: list[tuple[str, str, float]] = [
    ("400 N/m * (1 + 0.5*sin(2*pi*x/0.3 m))", "N/m", 400 * (1 + 0.5 * math.sin(4 * math.pi / 3))),
    ("if(x < 0.3 m, 400 N/m, 800 N/m)", "N/m", 400),
    ("if(x >= 0.3 m, 400 N/m, 800 N/m)", "N/m", 800),
    ("if(x > 0.1 m and y <= 0.5 m or x > 3 m, x, y)", "m", 0.2),
    ("if(x > 9 m or x > 0.1 m and y > 9 m, x, y)", "m", 0.5),
    ("x*(cos(program/0.3 m) - 1) - y*sin(program/0.3 m)", "m",
     0.2 * (math.cos(0.1) - 1) - 0.5 * math.sin(0.1)),
    ("-x^2/1 m", "m", -0.04),
    ("x**2**3/1 m^7", "m", 0.2**8),
    ("x - 1 mm - 2 mm", "m", 0.197),
    ("1 m / 4 / 2 * x / 1 m", "m", 0.025),
    ("x*2^-1", "m", 0.1),
    ("2 m/s*3 s*x/1 m", "m", 1.2),
    ("10 kN/cm * x/1 m", "N/m", 2e5),
    ("0.3 m^2/x", "m", 1.5),
    ("x*3 m^-1*y", "m", 0.3),
    ("sqrt(x*y)", "m", math.sqrt(0.1)),
    ("x^(1/2)*sqrt(y)", "m", math.sqrt(0.1)),
    ("max(0, x - 0.3 m)", "m", 0),
    ("min(x, y) + abs(x - y)", "m", 0.5),
    ("x*exp(-y/1 m)*log(y/1 m)*tan(x/1 m)*tanh(1)", "m",
     0.2 * math.exp(-0.5) * math.log(0.5) * math.tan(0.2) * math.tanh(1)),
    ("x*sin(30 deg) + x*5 %", "m", 0.11),
    ("pi*x/1 m", "", 0.2 * math.pi),
    ("+x - -x", "m", 0.4),
]  # fmt: skip


@pytest.mark.parametrize(("text", "unit", "value"), VALUES)
def test_formulas_mean_what_they_say(text: str, unit: str, value: float) -> None:
    assert is_formula(text)
    found = Expression(text, unit).evaluate(AT, NUMPY_FUNCTIONS)
    assert found == pytest.approx(value, rel=1e-13)


@pytest.mark.parametrize(("text", "unit", "value"), VALUES)
def test_formulas_have_the_same_value_in_ufl(text: str, unit: str, value: float) -> None:
    assert UFL_FUNCTIONS.keys() == NUMPY_FUNCTIONS.keys()
    at = ufl.SpatialCoordinate(ufl.Mesh(basix.ufl.element("P", "triangle", 1, shape=(2,))))
    variables = {"x": at[0], "y": at[1], "program": AT["program"]}
    found = ufl.as_ufl(Expression(text, unit).evaluate(variables, UFL_FUNCTIONS))
    assert found((AT["x"], AT["y"])) == pytest.approx(value, rel=1e-13)


def test_a_coefficient_changes_in_its_unit() -> None:
    """By a complex step of the change, against the same formula with another number."""
    formula = Expression("if(x < 1 m, 4 kN/m, 1 N/m) * (1 + x/20 cm) + 1e4 N/m^3 * x**2", "N/m")
    assert coefficients(formula) == [
        (1, "m"), (4, "kN/m"), (1, "N/m"), (1, ""), (20, "cm"), (1e4, "N/m^3"), (2, ""),
    ]  # fmt: skip
    for place, (number, unit) in enumerate(coefficients(formula)[:-1], 1):
        changed = with_change(formula, place)
        assert "program" in changed.variables
        slope = changed.evaluate(AT | {"program": 1e-30j}, NUMPY_FUNCTIONS).imag / 1e-30
        more, less = (
            Expression(with_coefficient(formula, place, number * (1 + h)), "N/m").at(0.2, 0.5)
            for h in (1e-6, -1e-6)
        )
        assert slope == pytest.approx((more - less) / (2e-6 * number), rel=1e-7, abs=1e-9), unit
    with pytest.raises(FormulaError, match=r"the exponent in 'x\*\*2' is not a fixed number"):
        with_change(formula, 7)


READ_BEFORE = json.loads(Path(__file__).with_name("formulas.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize(("text", "unit", "values"), READ_BEFORE)
def test_random_formulas_read_as_in_former_versions(
    text: str, unit: str, values: list[float] | None
) -> None:
    """The values are those of a parser with dimensions of its own; None was refused."""
    if values is None:
        with pytest.raises(FormulaError):
            Expression(text, unit)
    else:
        found = Expression(text, unit).at(np.array([0.1, 0.77]), np.array([0.5, 0.3]), 0.03, 0.02)
        assert found == pytest.approx(values, rel=1e-12)


def test_a_formula_takes_arrays() -> None:
    x, y = np.random.default_rng(1).random((2, 50))
    found = Expression("if(x < y, x*y/1 m, 2*y)", "m").evaluate({"x": x, "y": y}, NUMPY_FUNCTIONS)
    assert np.array_equal(found, np.where(x < y, x * y, 2 * y))


_SUMS = st.recursive(
    st.sampled_from(["x", "y", "2", "0.5", "pi"]),
    lambda inner: (
        st.builds("({}{}{})".format, inner, st.sampled_from("+-*"), inner)
        | st.builds("{}{}{}".format, inner, st.sampled_from("+-*"), inner)
        | st.builds("-{}".format, inner)
    ),
    max_leaves=12,
)


@given(text=_SUMS)
def test_operators_bind_as_in_python(text: str) -> None:
    """The reference is Python itself, on texts made of nothing but arithmetic."""
    names = {"x": 0.25, "y": -3.0, "pi": math.pi}
    # Every name becomes a pure number, for sums of anything.
    pure = text.replace("x", "(x/1 m)").replace("y", "(y/1 m)")
    try:
        found = Expression(pure, "").evaluate({"x": 0.25, "y": -3.0}, NUMPY_FUNCTIONS)
    except FormulaError as error:
        assert "nested" in str(error) or "characters" in str(error)
    else:
        assert found == pytest.approx(eval(text, {}, names), rel=1e-12, abs=1e-12)


def test_what_depends_on_nothing_is_a_number() -> None:
    assert Expression("400 N/m*2", "N/m").constant == 800
    assert Expression("if(1 < 2, sqrt(9)*1 m + 1 m, 0)", "m").constant == 4
    assert Expression("1 m + 0*x", "m").constant is None
    assert Expression("x + program", "m").variables == {"x", "program"}


def test_formulas_are_values() -> None:
    one = Expression("x + 1 m", "m")
    assert one == Expression("x + 1 m", "m")
    assert one != Expression("x + 2 m", "m")
    assert len({one, Expression("x + 1 m", "m")}) == 1
    assert pickle.loads(pickle.dumps(one)) == one
    assert pickle.loads(pickle.dumps(one)).evaluate(AT, NUMPY_FUNCTIONS) == 1.2


@pytest.mark.parametrize(
    ("text", "told", "remedy"),
    [
        ("x + 1", "'x + 1' cannot take a length and a plain number", "'x - 0.3 m'"),
        ("min(x, 1)", "'min(x, 1)' cannot take a length and a plain number", "'x - 0.3 m'"),
        ("if(x < 1, x, y)", "'x < 1' cannot take a length and a plain number", "'x - 0.3 m'"),
        ("if(x < y, x, 1 s)", "cannot take a length and a time", "'x - 0.3 m'"),
        ("x < 1 m", "'x < 1 m' is a condition", "if("),
        ("2*x*x", "expected a length such as '40 mm', but the formula gives an area", ""),
        ("x*5 N/m", "but the formula gives a force", ""),
        ("x/1 kg^2", "but the formula gives a value in m*kg^-2", ""),
        ("sin(x)", "'sin(x)' cannot take a length", "'x/1 m'"),
        ("2^x", "'2^x' cannot take a plain number and a length", "'x/1 m'"),
        ("x^(y/1 m)", "the exponent in 'x^(y/1 m)' is not a fixed number", "'x/1 m'"),
        ("if(x, y, x)", "'x' is no condition", "if("),
        ("if(1 m < x < 2 m, x, y)", "'1 m < x < 2 m' compares more than two", " and "),
        ("if(x and y, x, y)", "'x' is no condition", "if("),
        ("min(x < y, x)", "'x < y' is a condition", "if("),
        ("0.3 m^12*x", "it is not clear what the power in '0.3 m^' is of", "'(0.3 m)^...'"),
        ("sinn(x)", "unknown function 'sinn'", "Did you mean 'sin'?"),
        ("besselj(x)", "unknown function 'besselj'", "The functions are sqrt, exp,"),
        ("x*z", "unknown name 'z'", "A unit follows its number"),
        ("progam*2", "unknown name 'progam'", "Did you mean 'program'?"),
        ("x*2 foo", "got the unknown unit 'foo'", ""),
        ("x*2 dB", "got 'dB', which does not start at zero", ""),
        ("sin*x", "the function 'sin' needs a bracket", "'sin(...)'"),
        ("if*x", "the function 'if' needs a bracket", "'if(...)'"),
        ("min(x)", "'min' takes 2 values, got 1", ""),
        ("sin(x/1 m, y/1 m)*x", "'sin' takes 1 value, got 2", ""),
        ("(x", "'(x' at character 1", "'400 N/m * (1 + x/0.3 m)'"),
        ("min(x y)", "at character 5", "'400 N/m * (1 + x/0.3 m)'"),
        ("x*", "its end", "'400 N/m * (1 + x/0.3 m)'"),
        ("x y", "'y' at character 3", "'400 N/m * (1 + x/0.3 m)'"),
        ("2 m (x/1 m)", "'2 m (x/1 m)' means nothing in a formula", "'400 N/m * (1 + x/0.3 m)'"),
        ("x;y", "';' means nothing in a formula", "'400 N/m * (1 + x/0.3 m)'"),
        ("x/(1-1)", "divides by zero", ""),
        ("x*log(0)", "'log(0)' has no finite value", ""),
        ("x*(-8)^0.5", "'(-8)^0.5' has no finite value", ""),
        ("x*1e400", "'1e400' has no finite value", ""),
        ("x*10^400", "'10^400' has no finite value", ""),
        ("x*9**9**9**9", "'9**9**9' has no finite value", ""),
        ("-" * 400 + "x", "nested too deeply", ""),
        ("x" + "+x" * 250, "a formula has at most 500 characters, this has 501", ""),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused_with_the_reason(text: str, told: str, remedy: str) -> None:
    with pytest.raises(FormulaError) as caught:
        Expression(text, "m")
    assert told in str(caught.value)
    assert remedy in caught.value.remedy


@pytest.mark.parametrize(
    "text",
    ["__import__('os').system('true')", "x.__class__", "x if x else y", "lambda: x", "x[0]", "[x]",
     "x==y", "x:=y", "not x", "x@y", "x//1", "x%1", "'x'", "x\n#y", "f'{x}'", "eval(x)", "x!",
     "\N{MATHEMATICAL BOLD DIGIT ONE}*x"],
)  # fmt: skip
def test_nothing_of_python_is_understood(text: str) -> None:
    with pytest.raises(FormulaError):
        Expression(text, "m")


@given(text=st.text(alphabet="xyπ01.,+-*/^()<>= mNiferanodsp²", max_size=30))
def test_any_text_is_a_formula_or_refused(text: str) -> None:
    try:
        expression = Expression(text, "m")
    except FormulaError as error:
        assert str(error)
    else:
        assert expression.variables <= {"x", "y", "program"}
        with np.errstate(all="ignore"):
            expression.evaluate(AT, NUMPY_FUNCTIONS)


@pytest.mark.parametrize("text", ["400 N/m", "soft", "0,90 m", "4 foo", "", "1 m)", "free"])
def test_numbers_with_units_and_words_are_no_formulas(text: str) -> None:
    assert not is_formula(text)
