"""Whether the sheet can rest under what acts on it from the start."""

from __future__ import annotations

from collections.abc import Iterator

from . import needs
from .boundary import Boundary, conditions_of
from .sampling import Finding
from .scene import Scene

#: A force that follows the program, as a remedy.
GROWING = "'10 N/m * program/40 mm'"


def rest_at_start(scene: Scene, boundary: Boundary) -> Iterator[Finding]:
    """Yield conditions that act from the start where only friction could resist them.

    At rest friction carries nothing, so that there is no state to begin with.
    """
    acting = needs.acting(scene)
    lack = needs.lacking(scene, [e for e in acting if not e.effect.dissipative])
    if not lack or needs.lacking(scene, acting):
        return
    for name, i, condition in conditions_of(boundary):
        if condition.burdens_the_start:
            yield (
                ("boundary", name, i),
                f"acts from the start, but without friction {lack[1]}, so that there is no rest",
                f"Let it follow the program, as in {GROWING} or 'min(program, 5 mm)'.",
            )
