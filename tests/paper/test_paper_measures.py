"""The measures of the claims against loops and fields whose measures are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from paper.claims import Claim, above, between, digits, falling, sheared_zone
from paper.measures import Field, Loop, likeness, loops_of, profile
from tests.report.sample import LENGTH, SLIP, WIDTH, make
from wovenfab.case import Rectangle

Values = np.ndarray


def loop(force, amplitude: float = 0.08, period: float = 0.5) -> Loop:
    """Return the loop of a force that depends on displacement (m) and velocity (m/s)."""
    t = np.linspace(0, period, 2001)
    u = amplitude / 2 * (1 - np.cos(2 * np.pi * t / period))
    v = amplitude * np.pi / period * np.sin(2 * np.pi * t / period)
    power = np.concatenate([[0], np.cumsum(np.diff(u) * (force(u, v)[1:] + force(u, v)[:-1]) / 2)])
    history = {
        "time_s": t, "displacement_m": u, "force_N": force(u, v), "dissipated_J": power,
    }  # fmt: skip
    (result,) = loops_of(history, [(0.0, period)])
    return result


def test_a_viscous_loop_is_an_ellipse() -> None:
    """Its width at a share s of the way is 4 pi c A/T sqrt(s(1-s)), its area pi^2 c A^2/(2T)."""
    k, c, amplitude, period = 1e4, 50.0, 0.08, 0.5
    viscous = loop(lambda u, v: k * u + c * v, amplitude, period)
    assert viscous.amplitude == pytest.approx(amplitude)
    for share in (0.05, 0.5, 0.95):
        width = 4 * np.pi * c * amplitude / period * np.sqrt(share * (1 - share))
        assert viscous.width(share) == pytest.approx(width, rel=1e-3)
    assert viscous.dissipated == pytest.approx(np.pi**2 * c * amplitude**2 / (2 * period), rel=1e-4)
    assert viscous.nonlinearity == pytest.approx(1, abs=1e-6)


def test_nonlinearity_is_that_of_the_middle() -> None:
    """Of u + a u^3 with friction: (1 + 7/4 a A^2)/(1 + 1/4 a A^2)."""
    a, amplitude = 80.0, 0.08
    viscous = loop(lambda u, v: 1e4 * (u + a * u**3) + 60 * np.tanh(30 * v), amplitude)
    x = a * amplitude**2
    assert viscous.nonlinearity == pytest.approx((1 + 1.75 * x) / (1 + 0.25 * x), rel=1e-3)


def test_distance_is_the_largest_difference_over_the_peak() -> None:
    one, other = loop(lambda u, v: 1e4 * u), loop(lambda u, v: 0.9e4 * u)
    assert one.distance(other) == pytest.approx(0.1)
    assert one.distance(one) == 0


def field(values, length: float = 0.9, cells: int = 300) -> Field:
    """Return a field of x and y (m) on a grid of a sheet that is 0.3 m wide."""
    x, y = np.meshgrid(
        (np.arange(cells) + 0.5) / cells * length, (np.arange(100) + 0.5) / 100 * 0.3
    )
    centres = np.column_stack([x.ravel(), y.ravel()])
    return Field(centres, np.full(x.size, length * 0.3 / x.size), values(x.ravel(), y.ravel()))


def test_sizes_of_a_field() -> None:
    ramp = field(lambda x, y: x)
    assert ramp.mean() == pytest.approx(0.45)
    assert ramp.size() == pytest.approx(0.995 * 0.9, abs=0.005)


def test_shares_of_the_sheet() -> None:
    """Within 10 % of x = 0.45 m are 0.09 of 0.9 m; x^2 has 90 % above x = 0.1^(1/3) 0.9 m."""
    ramp = field(lambda x, y: x)
    assert ramp.share_near_centre(0.1) == pytest.approx(0.1, abs=0.005)
    assert ramp.share_with_most(0.9) == pytest.approx(1 - 0.1 ** (1 / 3), abs=0.005)
    assert field(lambda x, y: 1 + 0 * x).share_with_most(0.9) == pytest.approx(0.9, abs=0.005)


def test_likeness_depends_on_the_pattern_and_not_on_the_size() -> None:
    short = field(lambda x, y: np.exp(-x / 0.1) * y, 0.6, 200)
    assert likeness(short, field(lambda x, y: 5 * np.exp(-x / 0.1) * y), 0.3, 0.3) > 0.9999
    assert likeness(short, field(lambda x, y: -np.exp(-x / 0.1) * y), 0.3, 0.3) < -0.9999
    assert abs(likeness(short, field(lambda x, y: np.cos(9e3 * x * y)), 0.3, 0.3)) < 0.1


def test_a_share_near_the_mean_is_that_of_a_part() -> None:
    """Of x from 0.3 to 0.6 m, 0.405 to 0.495 m are within 10 % of 0.45 m."""
    ramp = field(lambda x, y: x)
    middle = (ramp.centres[:, 0] > 0.3) & (ramp.centres[:, 0] < 0.6)
    assert ramp.share_near_mean(0.1, middle) == pytest.approx(0.3, abs=0.01)


def test_the_jump_across_the_yarn_through_a_corner_is_measured(tmp_path: Path) -> None:
    """Of the made-up run, whose family 1 jumps there by 0.3 of its slip, and nowhere else."""
    results = make(tmp_path / "run", [0.06])
    sheet = Rectangle(length=LENGTH, width=WIDTH, fibres=[np.pi / 4, -np.pi / 4])
    place = 0.3
    along = (place / np.sqrt(2) - WIDTH / 2) / (LENGTH - WIDTH)
    line = profile(results, sheet, place)
    assert line.jump == pytest.approx(-0.3 * SLIP * np.sin(np.pi * along) ** 2, rel=0.05)
    assert abs(profile(results, sheet, 0.2).jump) < 2e-6  # where that slip is none


@pytest.mark.parametrize(("length", "zone"), [(0.6, 0.25), (0.9, 0.5), (1.2, 0.625)])
def test_the_zone_that_is_sheared_uniformly(length: float, zone: float) -> None:
    """Counted on a grid: points whose yarns both run free of the grips."""
    x, y = np.meshgrid(np.linspace(0, length, 1201), np.linspace(0, 0.3, 601))
    free = np.ones_like(x, dtype=bool)
    for sign in (1, -1):
        at_left, at_right = y - sign * x, y + sign * (length - x)
        for end in (at_left, at_right):  # where the yarn would meet the line of the grip
            free &= (end < 0) | (end > 0.3)
    assert free.mean() == pytest.approx(zone, abs=0.01)
    sheet = Rectangle(length=length, width=0.3, fibres=[0, 1])
    assert sheared_zone(sheet) == pytest.approx(zone)


def test_verdicts() -> None:
    assert above("", 1.1, 1).holds
    assert not above("", 1.0, 1).holds
    assert between("", 0.2, 0.1, 0.5).holds
    assert not between("", 0.6, 0.1, 0.5).holds
    assert falling("", [3, 2, 1], factor=2).holds
    assert not falling("", [3, 2, 1], factor=3).holds
    assert not falling("", [3, 1, 2]).holds
    good, bad = above("a", 2, 1), above("b", 1, 2)
    assert Claim(1, "3", "x", (good,), "Because.").verdict == "Holds."
    assert Claim(1, "3", "x", (good, bad), "Because.").verdict == "Does not hold. Because."


def test_numbers_are_shown_with_three_digits() -> None:
    assert [digits(v) for v in (5201.3, 0.12345, 1.0, 99.96)] == ["5200", "0.123", "1", "100"]
    assert falling("", [0.5, 0.25], "%").shown == "50 %, 25 %"
