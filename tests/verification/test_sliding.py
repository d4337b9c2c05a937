"""Two placements: few unknowns give the force where placements may jump across special fibres."""

from __future__ import annotations

import pytest

from tests import scenes
from tests.samples import SAMPLES
from wovenfab.model.model import Numerics

#: Forces (N) at 20 mm, elastic, P4 with cells of 13 mm (150k to 300k unknowns); with 20 mm they
#: are the same to 2e-6.
LIMITS = {
    "1:3": 122.1105,
    "1:2": 481.8744,
    "1:4": 51.1288,
    "30/-60": 553.1664,
    "soft": 32.9688,
    "stiff": 195.2981,
}


def pulled(name: str, degree: int, mesh_size: float, jumps: bool = True) -> tuple[int, float]:
    """Return unknowns and force (N) of a sample at 20 mm."""
    sample = SAMPLES[name]
    on = sample.sheet(mesh_size, jumps=jumps)
    model = scenes.model(on, scenes.COUPLED, Numerics(degree), sample.values)
    return model.unknowns, scenes.force(model, scenes.PULL, 0.02)["right"][0]


def check(name: str, degree: int, mesh_size: float, error: float) -> int:
    """Compare the force of a sample with its limit; return its unknowns."""
    unknowns, force = pulled(name, degree, mesh_size)
    off = force / LIMITS[name] - 1
    print(f"{name}, P{degree}, {unknowns} unknowns: {force:.4f} N, error {off:.2e}")
    assert force == pytest.approx(LIMITS[name], rel=error)
    return unknowns


@pytest.mark.parametrize("name", LIMITS)
def test_half_a_per_cent_takes_2500_unknowns(name: str) -> None:
    assert check(name, 3, 0.15 if name in ("1:4", "30/-60") else 0.1, 5e-3) <= 2500


@pytest.mark.parametrize("name", LIMITS)
def test_a_tenth_of_a_per_cent_takes_6000_unknowns(name: str) -> None:
    assert check(name, 4, 0.1, 1e-3) <= 6000


@pytest.mark.parametrize("name", LIMITS)
def test_a_hundredth_of_a_per_cent_takes_40_000_unknowns(name: str) -> None:
    assert check(name, 4, 0.04 if name == "1:4" else 0.035, 1e-4) <= 40_000


@pytest.mark.slow
@pytest.mark.parametrize("name", LIMITS)
def test_limits_are_those_of_finer_meshes(name: str) -> None:
    check(name, 4, 0.02, 5e-6)


def test_continuous_placements_are_too_stiff_on_the_same_mesh() -> None:
    limit = LIMITS["1:3"]
    tied, free = (pulled("1:3", 3, 0.1, jumps)[1] for jumps in (False, True))
    print(f"continuous {tied:.3f} N, jumping {free:.3f} N")
    assert tied / limit - 1 > 10 * abs(free / limit - 1)
