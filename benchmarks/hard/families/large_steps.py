"""Large steps from rest: rotations of stiff yarns that Newton's method takes for stretches."""

from __future__ import annotations

from benchmarks.hard.measurement import measured
from benchmarks.hard.pictures import draw_large_steps
from benchmarks.hard.row import Bound, Family, Row, Setting

PULL = Setting(
    "bonded-1x3", ("program.to=100 mm", "program.steps=1", "discretisation.penalty=auto")
)
BOUNDS = (Bound("worst", most=10), Bound("cutbacks", most=0), Bound("margin", least=0.1))


def _row(degree: int, size: str, corner: str | None = None) -> Row:
    """Return a row of one degree, with cells of a size, finer at the corners with a corner size."""
    graded = (
        ()
        if corner is None
        else ("discretisation.mesh=unstructured", f"discretisation.corner_size={corner}")
    )
    mesh = f"{corner} at the corners" if corner else f"cells of {size}"
    return Row(
        name=f"large-p{degree}-{size.replace(' ', '')}" + ("-graded" if corner else ""),
        title=f"bonded 1:3, 100 mm in one step, P{degree}, {mesh}",
        hard="yarns turn by 20° in one step and hardly stretch"
        + (", the mesh spans four decades" if corner else ""),
        remedy="mixed-integration-point tangent",
        setting=PULL.but(
            f"discretisation.degree={degree}", f"discretisation.mesh_size={size}", *graded
        ),
        measure=measured,
        bounds=BOUNDS,
        quick=(f"discretisation.mesh_size={'100 mm' if corner else '150 mm'}",),
    )


FAMILY = Family(
    number=1,
    title="Large steps",
    text="At most 10 iterations and no cut-back, from 2 000 to 200 000 unknowns.",
    rows=(
        _row(2, "50 mm"),
        _row(2, "4.8 mm"),
        _row(2, "6 mm", "0.1 mm"),
        _row(3, "50 mm"),
        _row(3, "7 mm"),
        _row(3, "10 mm", "0.1 mm"),
        _row(4, "50 mm"),
        _row(4, "9.4 mm"),
        _row(4, "12 mm", "0.1 mm"),
    ),
    draw=draw_large_steps,
)
