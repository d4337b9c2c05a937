"""Where the error of the elements comes from."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from wovenfab.record.fields import StoredFields
from wovenfab.report.run_data import RunData
from wovenfab.report.style import MILLIMETRE, WIDTH, fill

#: Smallest share in the picture over the largest.
SHOWN = 1e-3


def error(source: RunData, stored: StoredFields) -> Figure:
    """Return the figure: each cell of the sheet at rest by its share of the error.

    Args:
        source: The results.
        stored: Shares and densities of the cells.
    """
    x, y = (stored.points() * MILLIMETRE.factor).T
    triangles = stored.triangles()
    share = stored.field("error_share", -1)[triangles[:, 0]]
    half = int(np.searchsorted(np.cumsum(np.sort(share)[::-1]), 0.5)) + 1
    figure = Figure(figsize=(WIDTH, WIDTH * 0.62))
    axes = figure.add_subplot(aspect="equal")
    largest = float(share.max()) or 1.0
    painted = axes.tripcolor(
        x,
        y,
        triangles,
        facecolors=np.maximum(share, SHOWN * largest),
        norm=LogNorm(SHOWN * largest, largest),
        cmap=fill(),
        edgecolors="0.7",
        linewidth=0.2,
    )
    label = "share of each cell in the energy of the error"
    figure.colorbar(painted, label=label, shrink=0.7, aspect=36, location="bottom")
    axes.set_title(source.title, pad=22)
    axes.annotate(
        f"error of the elements at the largest force: half of it in {half} of {len(share)} cells",
        (0, 1),
        xycoords="axes fraction",
        xytext=(0, 8),
        textcoords="offset points",
    )
    axes.set_xlabel("x (mm)")
    axes.set_ylabel("y (mm)")
    axes.grid(visible=False)
    return figure
