"""Two placements: few unknowns give the force where placements may jump across special fibres."""

from __future__ import annotations

import pytest

from tests import scenes
from tests.samples import SAMPLES

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


def check(name: str, degree: int, mesh_size: float, error: float) -> int:
    """Compare the force of a sample with its limit; return its unknowns."""
    on = SAMPLES[name].sheet(mesh_size)
    unknowns, force = SAMPLES[name].pull(scenes.COUPLED, 0.02, degree, on)
    off = force / LIMITS[name] - 1
    print(f"{name}, P{degree}, {unknowns} unknowns: {force:.4f} N, error {off:.2e}")
    assert force == pytest.approx(LIMITS[name], rel=error)
    return unknowns


@pytest.mark.parametrize("name", LIMITS)
@pytest.mark.parametrize(
    ("degree", "mesh_size", "special", "error", "most"),
    [
        (3, 0.1, {"1:4": 0.15, "30/-60": 0.15}, 5e-3, 2500),
        (4, 0.1, {}, 1e-3, 6000),
        (4, 0.035, {"1:4": 0.04}, 1e-4, 40_000),
    ],
    ids=["half a per cent", "a tenth", "a hundredth"],
)
def test_few_unknowns_give_the_force_of_sliding_yarns(
    name: str, degree: int, mesh_size: float, special: dict[str, float], error: float, most: int
) -> None:
    assert check(name, degree, special.get(name, mesh_size), error) <= most


@pytest.mark.slow
@pytest.mark.parametrize("name", LIMITS)
def test_limits_are_those_of_finer_meshes(name: str) -> None:
    check(name, 4, 0.02, 5e-6)


def test_continuous_placements_are_too_stiff_on_the_same_mesh() -> None:
    limit, sample = LIMITS["1:3"], SAMPLES["1:3"]
    sheets = (sample.sheet(0.1, jumps=jumps) for jumps in (False, True))
    tied, free = (sample.pull(scenes.COUPLED, 0.02, 3, on)[1] for on in sheets)
    print(f"continuous {tied:.3f} N, jumping {free:.3f} N")
    assert tied / limit - 1 > 10 * abs(free / limit - 1)
