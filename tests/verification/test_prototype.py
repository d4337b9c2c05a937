"""The throw-away prototype and this program agree on the identical mesh."""

from __future__ import annotations

import pytest

from tests import scenes


@pytest.mark.parametrize(
    ("names", "squares", "expected"),
    [
        (scenes.BONDED, 36, {0.02: 309.951, 0.04: 662.751}),
        (scenes.COUPLED, 48, {0.02: 124.685}),
    ],
    ids=["one placement", "two placements"],
)
def test_the_force_is_the_prototypes_to_six_digits(
    names: tuple[str, ...], squares: int, expected: dict[float, float]
) -> None:
    """The mesh is ``squares`` squares long; forces (N) by displacement (m)."""
    model = scenes.model(scenes.sheet(mesh_size=0.9 / squares), names, scenes.PROTOTYPE)
    for displacement, prototype in expected.items():
        model.field.x.array[:] = 0
        force = scenes.pull(model, displacement)
        print(f"\n{force:.4f} N, prototype {prototype} N")
        assert round(force, 3) == prototype
