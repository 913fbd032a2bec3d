"""Gaussians cut by half-spaces: those split by one that they move into, and those known to lie within one.

The state before a step has margin m0 to a guard and the state after it m1; both are Gaussian and correlated. Crossing
is m0 <= 0 and m1 > 0: a state that is outside and comes inside. Testing m1 > 0 alone would let mass leak at rest,
because the Gaussian fitted to a density that ends at the guard has a tail behind it. A state of that tail at m0 = y
stands for one as far in front of the guard, at -y, and crosses if the step moves it by more than y.

Only two directions of the noise move the margins: about their means m0 = s0 ζ0 and m1 = k ζ0 + t ζ1. In the plane of
(ζ0, ζ1) what crosses and the tail that does are two `wedges`, whose moments are known in closed form. Where those lose
digits, quadrature over ζ0 with closed forms over ζ1 replaces them.

Moments of a standard Gaussian in the plane over half-planes and wedges, in closed form, many at once.

Moments are arrays whose first index says of what: 1, x, y, xx, xy, yy (`MASS` to `YY`), not normalised. A wedge lies on
one side of an upright line, above a line that crosses it; two of them share the upright line and the point on it: what
crosses into a half-space within a step fills the left one, and the tail behind the half-space the right one.

Sources: Rosenbaum, "Moments of a truncated bivariate normal distribution", JRSS B 1961, written here with Stokes'
theorem; Owen, "Tables for computing bivariate normal probabilities", Annals of Mathematical Statistics 1956.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import erfcx, log_ndtr, ndtr, owens_t

from micah_plan.arrays import Booleans, Floats, Ints
from micah_plan.belief.gaussian import SMALLEST_STD, those

# A share of a belief below this is dropped.
NEGLIGIBLE = 1e-10
# Beyond this many standard deviations a Gaussian counts as zero (mass 1e-19).
REACH = 9.0
# At this many standard deviations a Gaussian underflows to 0.
_SURELY = 40.0
_NOTHING = 1e-30
# Closed forms are exact to 1e-16 times what lies beyond the wedge's lines: for shares above this part of it they are as
# good as quadrature, and for those that are dropped. Where the margins move nearly as one, the point is far out.
_SURE = 1e-9
_SINE = 1e-3
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)


@dataclass(frozen=True, eq=False)
class Margins:
    """How far p Gaussians lie inside a half-space a'x >= c before a step and after it: negative outside.

    Attributes:
        mean: (2, p) a'x - c of the means, before and after.
        row: (2, k, p) a'F of their square roots.
    """

    mean: Floats
    row: Floats

    def where(self, chosen: Ints) -> Margins:
        """Margins of the Gaussians with these numbers."""
        return Margins(those(self.mean, chosen), those(self.row, chosen))

    def can_cross(self, probability: Floats) -> Booleans:
        """(p,) whether of shares (p,) of beliefs more than filters drop can cross.

        No more does than ends inside, and nothing where all of it stays where it is.
        """
        (start, end), (before, after) = self.mean, self.row
        spread = np.sqrt(np.einsum("kp,kp->p", after, after)) + SMALLEST_STD
        moves = (end > start) | (after != before).any(axis=0)
        return np.asarray((moves & (probability * ndtr(end / spread) >= NEGLIGIBLE)) | (start > SMALLEST_STD))


@dataclass(frozen=True, eq=False)
class Shares:
    """What crosses into a half-space (first index 0) and what stays (1) of each of p Gaussians.

    Attributes:
        probability: (2, p), of sum 1; 0 for what filters drop, which has the moments of the whole.
        mean, factor: (2, ..., p), (2, ..., k, p) of the shares as Gaussians of their own.
    """

    probability: Floats
    mean: Floats
    factor: Floats


def split(mean: Floats, factor: Floats, margins: Margins) -> Shares:
    """What crosses into half-spaces and what stays.

    Moments are exact up to rounding or quadrature (1e-9), those of what crosses without the tail behind the guard. Only
    if a mean itself starts behind the guard, the mass there is no tail: it counts as inside, and crosses.

    Args:
        mean, factor: (..., p) and (..., k, p).
    """
    first, second, plane = _whitened(margins)
    moments, tail = _moments_of_shares(plane, plane.m0 > 0)
    probability = np.empty(margins.mean.shape)
    np.minimum(1.0, moments[MASS, 0] + tail, out=probability[0])
    empty = (moments[MASS, 0] < _NOTHING).nonzero()[0]
    if empty.size:
        # Without any mass to fit moments to, nothing crosses.
        probability[0, empty] = 0.0
        moments[..., empty] = WHOLE[:, None]
    np.subtract(1.0, probability[0], out=probability[1])
    lost = ((probability < NEGLIGIBLE) | (moments[MASS] < _NOTHING)).nonzero()
    if lost[0].size:
        probability[lost] = 0.0
        moments[:, *lost] = WHOLE
    center, root = _fitted(moments)
    # The noise along each of the two directions moves the state by as much.
    moved = [np.einsum("...kp,kp->...p", factor, direction) for direction in (first, second)]
    apart = (slice(None), *(None,) * (mean.ndim - 1))
    x, y, (narrowed, slant, rest) = center[0][apart], center[1][apart], root[:, *apart]
    changed = (moved[0] * (narrowed - 1.0) + moved[1] * slant)[..., None, :] * first
    changed += factor
    changed += (moved[1] * (rest - 1.0))[..., None, :] * second
    return Shares(probability, mean + moved[0] * x + moved[1] * y, changed)


def truncated(mean: Floats, factor: Floats, margin: Floats, row: Floats) -> tuple[Floats, Floats]:
    """Means and factors, as wide as they were, of Gaussians given that a margin is above 0; exact.

    Args:
        mean, factor: (..., p) and (..., k, p).
        margin, row: (p,) its means and (k, p) the rows of its square roots.
    """
    std = np.sqrt(np.einsum("kp,kp->p", row, row) + SMALLEST_STD**2)
    z = margin / std
    mills = np.sqrt(2 / np.pi) / erfcx(-z / np.sqrt(2))
    variance = np.where(z > -100.0, 1.0 - mills * (mills + z), 1.0 / np.minimum(z, -1.0) ** 2)
    direction = row / std
    along = np.einsum("...kp,kp->...p", factor, direction)
    return mean + along * mills, factor - (along * (1.0 - np.sqrt(variance)))[..., None, :] * direction


def log_probability(margin: Floats, row: Floats) -> Floats:
    """log P(m > 0) (..., p) of margins with means (..., p) and rows (..., k, p)."""
    z = margin / np.sqrt(np.einsum("...kp,...kp->...p", row, row) + SMALLEST_STD**2)
    result, inside = np.zeros(z.shape), (z < REACH).nonzero()
    if inside[0].size:
        result[inside] = log_ndtr(z[inside])
    return result


@dataclass(frozen=True, eq=False)
class _Plane:
    """The margins m0 + s0 ζ0 and m1 + k ζ0 + t ζ1 over the plane of whitened noise (all p,)."""

    m0: Floats
    s0: Floats
    m1: Floats
    k: Floats
    t: Floats

    def where(self, chosen: Booleans) -> _Plane:
        """The margins that a mask (p,) chooses."""
        return _Plane(self.m0[chosen], self.s0[chosen], self.m1[chosen], self.k[chosen], self.t[chosen])


def _whitened(margins: Margins) -> tuple[Floats, Floats, _Plane]:
    """Two orthonormal directions (k, p) of the noise, of which the first alone moves m0, and the margins over them."""
    row0, row1 = margins.row
    s0 = length = np.sqrt(np.einsum("kp,kp->p", row0, row0))
    is_point = s0 < SMALLEST_STD
    if np.count_nonzero(is_point):
        row0, s0 = np.where(is_point, row1, row0), np.where(is_point, 0.0, s0)
        length = np.sqrt(np.einsum("kp,kp->p", row0, row0))
        length[length == 0.0] = np.inf
    first = row0 / length
    k = np.einsum("kp,kp->p", row1, first)
    rest = row1 - k * first
    t = np.sqrt(np.einsum("kp,kp->p", rest, rest))
    t[t <= 1e-9 * (np.abs(k) + SMALLEST_STD)] = 0.0
    second = rest / np.where(t > 0.0, t, np.inf)
    m0, m1 = margins.mean - SMALLEST_STD
    return first, second, _Plane(m0, s0, m1, k, t)


def _moments_of_shares(plane: _Plane, inside: Booleans) -> tuple[Floats, Floats]:
    """Moments (6, 2, p) of what crosses and of what stays, and the mass of the tail that crosses (p,).

    `inside`: the mass that starts behind the guard is no tail and crosses.
    """
    # The smaller angle between the lines that bound the wedges and where both margins move as one, roughly.
    wedged = plane.t > _SINE * (np.abs(plane.k) + 2 * plane.s0)
    if np.count_nonzero(wedged) == wedged.size:
        moments, tail, sure = _closed(plane, inside)
        if np.count_nonzero(sure) == sure.size:
            return moments, tail
        is_open = ~sure
    else:
        moments, tail, is_open = np.empty((6, 2, len(inside))), np.zeros(len(inside)), ~wedged
        is_point = plane.s0 == 0
        if is_point.any():
            moments[..., is_point] = _from_known_start(plane.where(is_point), inside[is_point])
            is_open &= ~is_point
        if wedged.any():
            moments[..., wedged], tail[wedged], sure = _closed(plane.where(wedged), inside[wedged])
            is_open[wedged] = ~sure
    if is_open.any():
        moments[..., is_open], tail[is_open] = _integrate(plane.where(is_open), inside[is_open])
    return moments, tail


def _from_known_start(plane: _Plane, inside: Booleans) -> Floats:
    """Moments (6, 2, p) of what crosses and of what stays, where the start is known: all that ends inside crosses."""
    moves = plane.k > 0
    offset = np.where(moves, -plane.m1 / np.where(moves, plane.k, 1.0), np.where(plane.m1 > 0, -_SURELY, _SURELY))
    return half_planes(np.where(inside, -_SURELY, np.clip(offset, -_SURELY, _SURELY)))


def _closed(plane: _Plane, inside: Booleans) -> tuple[Floats, Floats, Booleans]:
    """As `_moments_of_shares`, for margins that both move; and whether the closed forms are sure (p,).

    What crosses is the wedge of m0 < 0 and m1 > 0, the tail that does that of m0 > 0 and m1 > 2 m0.
    """
    place, slope, offset = -plane.m0 / plane.s0, np.empty((2, len(inside))), np.empty((2, len(inside)))
    slope[0], slope[1] = plane.k, plane.k - 2 * plane.s0
    offset[0], offset[1] = plane.m1, plane.m1 - 2 * plane.m0
    moments, beyond = wedges(place, slope, plane.t, offset)
    tail = moments[MASS, 1].copy()
    moments[:, 1] += moments[:, 0]
    np.subtract(WHOLE, moments[:, 1], out=moments[:, 1])
    if np.count_nonzero(inside):
        # The mass in front of the guard that does not cross is what stays.
        moments[:, 1, inside] = half_planes(place[inside])[:, 1] - moments[:, 0, inside]
        moments[:, 0, inside] = WHOLE - moments[:, 1, inside]
        tail[inside] = 0.0
    crossing, staying = moments[MASS]
    sure = (crossing > _SURE * beyond[0]) | (crossing + tail < 0.9 * NEGLIGIBLE)
    sure &= (staying > _SURE) | (staying < 0.1 * NEGLIGIBLE)
    return moments, tail, sure


def _integrate(plane: _Plane, inside: Booleans) -> tuple[Floats, Floats]:
    """As `_moments_of_shares`, by quadrature over ζ0 and closed forms over ζ1."""
    edges = _breaks(plane)
    # Only intervals that are not empty: (i, nodes) of them, each with the number of its Gaussian.
    owner, number = np.nonzero(np.diff(edges, axis=1) > 0.0)
    lower, right = edges[owner, number][:, None], edges[owner, number + 1][:, None]
    half = (right - lower) / 2
    zeta = (lower + right) / 2 + half * _NODES
    mass = half * _WEIGHTS * np.exp(-0.5 * zeta**2) / np.sqrt(2 * np.pi)
    m0, s0, m1, k, t = (v[owner, None] for v in (plane.m0, plane.s0, plane.m1, plane.k, plane.t))
    start, reach = m0 + s0 * zeta, m1 + k * zeta
    behind, inner = start > 0, inside[owner, None]
    reach = np.where(behind, np.where(inner, np.inf, reach - 2 * start), reach)
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = np.clip(-reach / t, -_SURELY, _SURELY)
    limit = np.where(t > 0, spread, np.where(reach > 0, -_SURELY, _SURELY))
    above, density = ndtr(-limit), np.exp(-0.5 * limit**2) / np.sqrt(2 * np.pi)
    counted = np.where(inner | ~behind, mass, 0.0)
    first = np.searchsorted(owner, np.arange(len(inside)))
    crossing = _summed(first, counted, zeta, above, density, limit)
    staying = _summed(first, mass, zeta, 1 - above, -density, limit)
    moments = np.stack([crossing, staying], axis=1)
    tail = np.add.reduceat(((mass - counted) * above).sum(axis=1), first)
    return moments, np.asarray(tail)


def _breaks(plane: _Plane) -> Floats:
    """(p, 18) sorted ends of the intervals of quadrature; those that are not needed are empty."""
    m0, s0, m1, k, t = plane.m0, plane.s0, plane.m1, plane.k, plane.t
    fixed = np.array([-REACH, -4.0, -1.5, 0.0, 1.5, 4.0, REACH])
    columns = [np.broadcast_to(fixed, (len(k), fixed.size))]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        columns.append(np.where(s0 > 0, -m0 / s0, REACH)[:, None])
        for offset, slope in ((m1, k), (m1 - 2 * m0, k - 2 * s0)):
            ends = (np.array([-6.0, -2.0, 0.0, 2.0, 6.0]) * t[:, None] - offset[:, None]) / slope[:, None]
            columns.append(np.where(np.abs(slope)[:, None] * REACH > SMALLEST_STD, ends, REACH))
    return np.sort(np.clip(np.concatenate(columns, axis=1), -REACH, REACH), axis=1)


def _summed(first: Ints, mass: Floats, zeta: Floats, zeroth: Floats, density: Floats, limit: Floats) -> Floats:
    """(6, p) moments: sums over the intervals of each Gaussian, which begin at `first`."""

    def total(values: Floats, weights: Floats) -> Floats:
        return np.asarray(np.add.reduceat(np.einsum("ik,ik->i", values, weights), first))

    once = mass * zeta
    firsts = [total(once, zeroth), total(mass, density)]
    seconds = [total(once * zeta, zeroth), total(once, density), total(mass, zeroth + limit * density)]
    return np.stack([total(mass, zeroth), *firsts, *seconds])


def _fitted(moments: Floats) -> tuple[Floats, Floats]:
    """Means (2, ...) and lower factors of the covariances (3, ...: 00, 10, 11) of Gaussians with these moments."""
    x, y, xx, xy, yy = center = moments[1:] / moments[MASS]
    root = np.empty((3, *x.shape))
    # Rounding may leave a covariance slightly indefinite.
    root[0] = np.sqrt(np.maximum(xx - x * x, 0.0))
    root[1] = (xy - x * y) / np.where(root[0] > 0, root[0], np.inf)
    root[2] = np.sqrt(np.maximum(yy - y * y - root[1] ** 2, 0.0))
    return center[:2], root


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


def wedges(place: Floats, slope: Floats, spread: Floats, offset: Floats) -> tuple[Floats, Floats]:
    """Moments left and right of the upright line ζ0 = place, over slope * ζ0 + spread * ζ1 + offset > 0.

    Args:
        place, spread: (p,), spreads above 0.
        slope, offset: (2, p) of the lines on the left and on the right, which meet on the upright line.

    Returns:
        moments (6, 2, p), and (2, p) the probabilities that lie beyond the two lines of each wedge, seen from the
        origin: masses are exact to 1e-16 times them.
    """
    # Owen's T wants to know on which side of the origin a line runs: the point is moved by a negligible amount, along a
    # direction that no line has.
    place, offset = place + _TINY, offset - (slope + _ASIDE * spread) * _TINY
    squared = slope**2 + spread**2
    size = np.sqrt(squared)
    # Distances from the origin: of the upright line and the others, and along them from the foot points to the point.
    at, along = np.empty((2, 3, place.size))
    at[0], at[1:] = place, offset / size
    along[0] = (slope[0] * place + offset[0]) / -spread
    along[1:] = _SIDES * (place * squared + slope * offset) / (spread * size)
    signs, tails, ends = np.sign(at), ndtr(-np.abs(at)), ndtr(-along)
    density = _ROOT * np.exp(-0.5 * at**2)
    sectors = owens_t(at, along / at)
    beyond = tails[0] + tails[1:]
    # Seen from the point, a wedge is the plane's sector between two lines; T is that between a line and its foot point.
    mass = sectors[1:] - _SIDES * (sectors[0] - 0.5 * signs[0] * tails[0]) - 0.5 * signs[1:] * tails[1:]
    mass += (signs[0] == -_SIDES) & (signs[1:] > 0)
    moments = np.empty((6, 2, place.size))
    mass = np.maximum(mass, 0.0, out=moments[MASS])
    # Stokes' theorem: both edges, and what their ends at the point add.
    across, upward = slope / size, spread / size
    above, edge = _SIDES * (density[0] * ends[0]), density[1:] * ends[1:]
    end = _SIDES * (density[0] * _ROOT * np.exp(-0.5 * along[0] ** 2))
    bent = end * slope / spread
    straight = edge * at[1:] + bent
    tilted = straight * across
    moments[X] = above + across * edge
    moments[Y] = upward * edge
    moments[XX] = mass + at[0] * above + bent - tilted * across
    moments[XY] = end - tilted * upward
    moments[YY] = mass - straight * upward**2
    return moments, beyond
