"""The curve through a table: its pieces with their coefficients."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from wovenfab.forms.table import COEFFICIENTS, ForceTable

Array = NDArray[np.float64]
#: Slope beyond a table over that of the last two rows, at least: where a curve flattens quickly,
#: the formula for the slope at its end gives zero, with which yarns would yield without bound.
LEAST_SLOPE = 0.1


def pieces_of(table: ForceTable) -> Array:
    """Return the coefficients of the monotone cubic force through a table.

    The slopes at the rows are those of ``scipy.interpolate.PchipInterpolator`` for the table
    continued as an odd function, so that the slope at rest is that of the first two rows. With it
    the force is continued to negative strains, and with the last slope beyond the table.

    Returns:
        Shape (pieces, ``COEFFICIENTS``): for negative strains, between rows, beyond the table; as
        :func:`wovenfab.forms.table.table_energy` takes them.
    """
    x, force = np.array(table.strains), np.array(table.forces)
    odd = PchipInterpolator(*(np.concatenate((-of[:0:-1], of)) for of in (x, force)))
    slopes = odd.derivative()(x)
    secant = (force[-1] - force[-2]) / (x[-1] - x[-2])
    slopes[-1] = max(slopes[-1], LEAST_SLOPE * secant)
    curve = CubicHermiteSpline(x, force, slopes)
    energy = curve.antiderivative()(x)
    pieces = np.zeros((len(x) + 1, COEFFICIENTS))
    pieces[0, 3] = slopes[0]
    pieces[1:, :4] = np.column_stack((x, energy, force, slopes))
    cubic, square = curve.c[:2]
    pieces[1:-1, 4:] = np.column_stack((2 * square, 6 * cubic))
    return pieces
