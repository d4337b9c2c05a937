"""The mode in which a sheet loses its stability."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from wovenfab.record.fields import StoredFields
from wovenfab.report.deformed import drawn
from wovenfab.report.field_styles import Scale
from wovenfab.report.run_data import RunData
from wovenfab.report.sheet import Sheet, displacements
from wovenfab.report.style import MILLIMETRE, fill, readable
from wovenfab.report.yarns import Triangles

#: Largest displacement by the mode in the picture, over the length of the sheet.
SHOWN = 0.08


def mode(source: RunData, stored: StoredFields) -> Figure:
    """Return the figure: the sheet displaced along the mode of the first loss of stability.

    Args:
        source: The results.
        stored: Displacements and modes at the losses.
    """
    names = displacements(stored)
    states = [stored.field(name, 0) for name in names]
    modes = [stored.field(name.replace("displacement", "mode"), 0) for name in names]
    size = np.hypot(*np.mean(modes, axis=0).T)
    length = float(np.ptp(stored.points(), axis=0).max())
    scale = SHOWN * length / float(size.max())
    shown = tuple(u + scale * m for u, m in zip(states, modes, strict=True))
    sheet = Sheet(Triangles(stored.points(), stored.triangles()), shown, source.fibres)
    label = "displacement in the mode, whose size is arbitrary"
    colours = Scale(label, 1.0, fill(), Normalize(0.0, 1.0), "neither")
    subtitle = _subtitle(source, float(stored.times[0]))
    return drawn(source.title, subtitle, sheet, size / size.max(), colours)


def _subtitle(source: RunData, time: float) -> str:
    """Return where stability is lost, from the last state before that."""
    row = int(np.searchsorted(source.history["time_s"], time))
    u, force = (float(source.history[name][row]) for name in ("displacement_m", "force_N"))
    unit = readable("N", force)
    return (
        f"stability lost at {u * MILLIMETRE.factor:.4g} mm, {force * unit.factor:.4g} {unit.name}"
    )
