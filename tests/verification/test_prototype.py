"""The throw-away prototype and this program agree on the identical mesh."""

from __future__ import annotations

import numpy as np
import pytest

from tests import scenes


def pulled(names: tuple[str, ...], squares: int, displacements: tuple[float, ...]) -> list[float]:
    """Return the force (N) at each displacement (m), the mesh ``squares`` squares long."""
    model = scenes.model(scenes.sheet(mesh_size=0.9 / squares), names, scenes.PROTOTYPE)
    forces = []
    for d in displacements:
        model.field.x.array[:] = 0
        forces.append(scenes.force(model, scenes.PULL, d)["right"][0])
    return forces


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
    found = pulled(names, squares, tuple(expected))
    print(f"\nfound {np.round(found, 4)} N, prototype {list(expected.values())} N")
    assert np.round(found, 3).tolist() == list(expected.values())
