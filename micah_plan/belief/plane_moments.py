"""Moments of a standard Gaussian in the plane over half-planes and wedges, in closed form, many at once.

Moments are arrays whose first index is the moment: 1, x, y, xx, xy, yy (`MASS` to `YY`), not normalised. A wedge lies
on the left of an upright line, above a line that crosses it.

Sources: Rosenbaum, "Moments of a truncated bivariate normal distribution", JRSS B 1961, written here with Stokes'
theorem; Owen, "Tables for computing bivariate normal probabilities", Annals of Mathematical Statistics 1956.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr, owens_t

from micah_plan.arrays import Floats

MASS, X, Y, XX, XY, YY = range(6)
# Of the whole plane.
WHOLE = np.array([[1.0], [0.0], [0.0], [1.0], [0.0], [1.0]])

_TINY, _ASIDE = 1e-200, np.sqrt(2.0)
_ROOT = 1.0 / np.sqrt(2 * np.pi)
_SIDES = np.array([[-1.0], [1.0]])


def half_planes(offset: Floats) -> Floats:
    """(6, 2, p) moments over ζ0 > offset (p,), and over the rest; exact also far out."""
    moments = np.zeros((6, 2, offset.size))
    density = _ROOT * np.exp(-0.5 * offset**2)
    moments[MASS] = moments[YY] = ndtr(_SIDES * offset)
    moments[X] = -_SIDES * density
    moments[XX] = moments[MASS] - _SIDES * (offset * density)
    return moments


def wedge(place: Floats, slope: Floats, spread: Floats, offset: Floats) -> tuple[Floats, Floats]:
    """Moments (6, p) left of the upright line ζ0 = place, over slope * ζ0 + spread * ζ1 + offset > 0.

    Args:
        place, slope, spread, offset: (p,), spreads above 0.

    Returns:
        moments, and (p,) the probability beyond the two lines, seen from the origin: masses are exact to
        1e-16 times it.
    """
    # Owen's T wants to know on which side of the origin a line runs: the point is moved by a negligible amount, along a
    # direction that no line has.
    place, offset = place + _TINY, offset - (slope + _ASIDE * spread) * _TINY
    squared = slope**2 + spread**2
    size = np.sqrt(squared)
    # Distances from the origin: of the upright line and the other, and along them from the foot points to the point.
    at = np.stack([place, offset / size])
    along = np.stack([(slope * place + offset) / -spread, -(place * squared + slope * offset) / (spread * size)])
    signs, tails, ends = np.sign(at), ndtr(-np.abs(at)), ndtr(-along)
    density = _ROOT * np.exp(-0.5 * at**2)
    sectors = owens_t(at, along / at)
    # Seen from the point, a wedge is the plane's sector between two lines; T is that between a line and its foot point.
    mass = sectors[1] + sectors[0] - 0.5 * signs[0] * tails[0] - 0.5 * signs[1] * tails[1]
    mass += (signs[0] > 0) & (signs[1] > 0)
    moments = np.empty((6, place.size))
    mass = np.maximum(mass, 0.0, out=moments[MASS])
    # Stokes' theorem: both edges, and what their ends at the point add.
    across, upward = slope / size, spread / size
    above, edge = -density[0] * ends[0], density[1] * ends[1]
    end = -density[0] * _ROOT * np.exp(-0.5 * along[0] ** 2)
    bent = end * slope / spread
    straight = edge * at[1] + bent
    tilted = straight * across
    moments[X] = above + across * edge
    moments[Y] = upward * edge
    moments[XX] = mass + at[0] * above + bent - tilted * across
    moments[XY] = end - tilted * upward
    moments[YY] = mass - straight * upward**2
    return moments, tails[0] + tails[1]
