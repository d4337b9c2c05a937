"""Which standard test a case is."""

from __future__ import annotations

from math import cos

from wovenfab.case.boundary import Boundary, Component
from wovenfab.case.case import Case
from wovenfab.case.schema import Rectangle
from wovenfab.record.bias_extension import BiasExtension
from wovenfab.record.picture_frame import PictureFrame

#: Edges across x and across y, first the one at the lower coordinate.
_EDGES = (("left", "right"), ("bottom", "top"))


#: A test whose shear angle follows from its displacement.
ShearTest = BiasExtension | PictureFrame


def shear_test_of(case: Case) -> ShearTest | None:
    """Return the specimen if the case is a bias extension or a picture frame, else None."""
    return bias_extension_of(case) or picture_frame_of(case)


def picture_frame_of(case: Case) -> PictureFrame | None:
    """Return the test if the case is one: a rectangle whose four edges one frame holds."""
    sheet = case.sheet
    frames = [c.frame for conditions in case.boundary.values() for c in conditions]
    if not isinstance(sheet, Rectangle) or set(case.boundary) != {e for p in _EDGES for e in p}:
        return None
    frame = frames[0]
    if frame is None or any(other != frame for other in frames):
        return None
    return PictureFrame(frame.length, sheet.length * sheet.width)


def bias_extension_of(case: Case) -> BiasExtension | None:
    """Return the specimen if the case is a bias-extension test, else None.

    It is one if the sheet is a rectangle at least twice as long as wide with both families
    at 45 degrees to its sides, both short edges are held along and across for both families
    without a formula, the program parts them along the long side, and other edges are free.
    """
    sheet = case.sheet
    if not isinstance(sheet, Rectangle):
        return None
    axis = int(sheet.width > sheet.length)
    width, length = sorted((sheet.length, sheet.width))
    slanted = all(abs(cos(2 * angle)) < 1e-6 for angle in sheet.fibres)
    if length < 2 * width * (1 - 1e-9) or not slanted or set(case.boundary) != set(_EDGES[axis]):
        return None
    near, far = (_grip(case.boundary, edge) for edge in _EDGES[axis])
    if near is None or far is None:
        return None
    factors, offsets = (
        [getattr(far[i], of) - getattr(near[i], of) for i in (axis, 1 - axis)]
        for of in ("factor", "offset")
    )
    if not factors[0] or factors[1] or offsets[1]:
        return None
    return BiasExtension(length, width, axis, factors[0], offsets[0])


def _grip(boundary: Boundary, edge: str) -> tuple[Component, Component] | None:
    """Return the motion of an edge if both families are held alike without a formula."""
    conditions = boundary[edge]
    components = conditions[0].components
    families = sorted(family for c in conditions for family in c.families)
    alike = families == [1, 2] and all(c.components == components for c in conditions)
    plain = all(c.held and c.expression is None for c in components)
    return components if alike and plain else None
