"""Values with units."""

from __future__ import annotations

import math
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from wovenfab.case import units

FINITE = st.floats(allow_nan=False, allow_infinity=False)
#: Text, SI unit and how many SI units it is, from the definitions of the units.
SCALES = [
    ("mm", "m", 1e-3),
    ("cm", "m", 1e-2),
    ("µm", "m", 1e-6),
    ("kN/m", "N/m", 1e3),
    ("N/mm", "N/m", 1e3),
    ("kN/m^2", "N/m^2", 1e3),
    ("kN/m2", "N/m^2", 1e3),
    ("MPa", "N/m^2", 1e6),
    ("N/mm**2", "N/m^2", 1e6),
    ("N/mm³", "N/m^3", 1e9),
    ("N*mm", "N*m", 1e-3),
    ("N m", "N*m", 1.0),
    ("N·m", "N*m", 1.0),
    ("J", "N*m", 1.0),
    ("s/mm", "s/m", 1e3),
    ("ms", "s", 1e-3),
    ("min", "s", 60.0),
    ("mm/s", "m/s", 1e-3),
    ("m/min", "m/s", 1 / 60),
    ("1/s", "Hz", 1.0),
    ("kHz", "Hz", 1e3),
    ("deg", "rad", math.pi / 180),
    ("°", "rad", math.pi / 180),
    ("%", "", 0.01),
    # Of fabric laboratories: a gram-force is 9.80665e-3 N.
    ("gf", "N", 9.80665e-3),
    ("gf/cm", "N/m", 0.980665),
    ("gf/(cm*deg)", "N/m", 0.980665 * 180 / math.pi),
    ("gf/(cm·deg)", "N/m", 0.980665 * 180 / math.pi),
    ("gf/(cm.deg)", "N/m", 0.980665 * 180 / math.pi),
    ("gf/cm/deg", "N/m", 0.980665 * 180 / math.pi),
    ("N/m/rad", "N/m", 1.0),
    ("gf*cm^2/cm", "N*m", 9.80665e-5),
    ("lbf", "N", 4.4482216152605),
    ("lbf/in", "N/m", 4.4482216152605 / 0.0254),
    ("in", "m", 0.0254),
]


@pytest.mark.parametrize(("given_unit", "unit", "scale"), SCALES)
def test_units_scale_as_defined(given_unit: str, unit: str, scale: float) -> None:
    for space in ("", " "):
        assert units.parse(f"-2.5{space}{given_unit}", unit) == pytest.approx(-2.5 * scale, 1e-14)


@given(value=FINITE, unit=st.sampled_from(sorted(units.KINDS)))
def test_what_is_written_reads_as_the_same_float(value: float, unit: str) -> None:
    text = units.write(value, unit)
    assert (units.parse(text, unit) if isinstance(text, str) else text) == value


@given(value=FINITE, unit=st.sampled_from(sorted(units.KINDS)))
def test_a_number_without_unit_is_si(value: float, unit: str) -> None:
    assert units.parse(repr(value), unit) == value


@given(
    one=st.sampled_from(sorted(u for u in units.KINDS if u)),
    other=st.sampled_from(sorted(u for u in units.KINDS if u)),
)
def test_no_unit_passes_for_another(one: str, other: str) -> None:
    assume(one != other)
    with pytest.raises(ValueError, match=one[-1]):
        units.parse(f"1 {one}", other)


@pytest.mark.parametrize(
    "text",
    ["", "mm", "1 2", "1,5 mm", "nan", "inf", "1e400", "1e308 km", "0x10 mm", "1 mm 2", "1 m^^2",
     "1 furlong^99", "9^9^9^9 m", "1 m^9^9^9", "1 (", "1 m)", "1 __import__('os')", "--1 m",
     "1 " + "m*" * 99, "1 degC", "1 dB", "1 /"],
)  # fmt: skip
def test_what_is_no_length_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        units.parse(text, "m")


@pytest.mark.parametrize(
    "text",
    ["9**9**9**9", "9^9^9^9", "(9**9**9**9)*m", "m*(9**9**9**9)", "m**9**9**9**9", "m^(9^9^9^9)",
     "(m**9)**9**9**9", "m*9**9**9**9", "m/9**9**9**9", "m" * 999],
)  # fmt: skip
def test_no_power_is_computed_that_takes_for_ever(text: str) -> None:
    """Any text that stands where a unit may be, such as in the header of a measured file."""
    for read in (units.in_si, partial(units.parse, unit="m"), partial(units.parse_in, unit=1.0)):
        with ended_after(2.0), pytest.raises(ValueError, match=r"."):
            read(text)
    with ended_after(2.0):
        assert not units.measures(f"1 {text}", "N")


def test_a_parameter_may_have_a_broken_power_as_unit() -> None:
    assert units.in_si("N/mm^1.5")[0] == pytest.approx(1e3**1.5)


class TookTooLongError(BaseException):
    """Not caught where any exception of pint is."""


@contextmanager
def ended_after(seconds: float) -> Iterator[None]:
    """Fail what takes longer."""

    def end(*_: object) -> None:
        raise TookTooLongError

    former = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, former)


@given(text=st.text(max_size=20), unit=st.sampled_from(sorted(units.KINDS)))
def test_any_text_is_a_finite_number_or_refused(text: str, unit: str) -> None:
    try:
        value = units.parse(f"1{text}", unit)
    except ValueError as error:
        assert str(error)
    else:
        assert math.isfinite(value)


@pytest.mark.parametrize("unit", ["N/m", "N/m^2", "m"])
def test_newton_metres_without_a_sign_between_are_refused(unit: str) -> None:
    """Versions of pint read ``Nm`` as other units, or not at all: never as newtons or metres."""
    with pytest.raises(ValueError, match="Nm"):
        units.parse("400 Nm", unit)


@pytest.mark.parametrize("given_unit", sorted(units.EVERYDAY))
def test_everyday_units_are_as_pint_has_them(given_unit: str) -> None:
    unit, factor = units.EVERYDAY[given_unit]
    (in_base, kind), (own, own_kind) = units.in_si(given_unit), units.in_si(unit)
    assert in_base / own == factor == units.parse(f"1 {given_unit}", unit)
    assert kind == own_kind
    others = {other for other, _ in units.EVERYDAY.values()} - {unit}
    for other in others:
        with pytest.raises(ValueError, match=re.escape(given_unit)):
            units.parse(f"1 {given_unit}", other)
    assert units.parse(f"1 {given_unit}", given_unit) == 1.0


def test_a_case_in_everyday_units_does_not_import_pint() -> None:
    case = Path(__file__).parents[2] / "configs" / "bias-1x3.yaml"
    code = f"import wovenfab.case as c; c.read_case({str(case)!r}); import sys"
    code += "; sys.exit('pint' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
