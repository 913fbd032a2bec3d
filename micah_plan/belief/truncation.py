"""Truncation of Gaussians by half-spaces: split at a boundary, or conditioned on one side.

A state that is still in its mode lies in front of the guards that leave it. So the density that a belief's mean and
covariance describe ends at the guard, and is skewed: a truncated Gaussian (`truncated`) with these moments. `uncut`
finds it.

The state before a step has margin m0 to a guard and the state after it m1; both are Gaussian and correlated. Crossing
is m0 <= 0 and m1 > 0: a state that is outside and comes inside. Only two directions of the noise move the margins:
about their means m0 = s0 ζ0 and m1 = k ζ0 + t ζ1. In the plane of (ζ0, ζ1) the crossing mass is a wedge, whose moments
are known in closed form. Where those lose digits, quadrature over ζ0 with closed forms over ζ1 replaces them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import erfcx, log_ndtr, ndtr

from micah_plan.arrays import SMALLEST_STD, Booleans, Floats, Ints
from micah_plan.belief.gaussian import take_last
from micah_plan.belief.plane_moments import MASS, WHOLE, XX, XY, X, Y, half_planes, wedge

# A share of a belief below this is dropped.
NEGLIGIBLE = 1e-10
# Beyond this many standard deviations a Gaussian counts as zero (mass 1e-19).
REACH = 9.0
# At this many standard deviations a Gaussian underflows to 0.
_BEYOND_ALL_STDS = 40.0
NOTHING = 1e-30
# Closed forms are exact to 1e-16 times what lies beyond the wedge's lines: for shares above this part of it they are as
# good as quadrature, and for those that are dropped. Where the margins move nearly as one, the point is far out.
_CERTAIN = 1e-9
_SINE = 1e-3
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)

# From where half of it is cut off to where a thousandth of a millionth is.
_CUT_PLACES = np.linspace(0.0, 6.0, 8_001)
_NEAREST = 0.05  # nearly all of it lies on the boundary


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
        return Margins(take_last(self.mean, chosen), take_last(self.row, chosen))

    def can_cross(self, probability: Floats) -> Booleans:
        """(p,) whether the crossing share can exceed the filter's threshold, for shares (p,) of beliefs.

        At most the mass that ends inside crosses, and none if all of it stays where it is.
        """
        (start, end), (before, after) = self.mean, self.row
        spread = np.sqrt(np.einsum("kp,kp->p", after, after)) + SMALLEST_STD
        moves = (end > start) | (after != before).any(axis=0)
        return np.asarray((moves & (probability * ndtr(end / spread) >= NEGLIGIBLE)) | (start > SMALLEST_STD))


@dataclass(frozen=True, eq=False)
class Shares:
    """Crossing (first index 0) and remaining (1) shares of p Gaussians.

    Attributes:
        probability: (2, p), of sum 1; 0 for a mass that filters drop, which has the moments of the whole.
        mean, factor: (2, ..., p), (2, ..., k, p) of the shares as Gaussians of their own.
    """

    probability: Floats
    mean: Floats
    factor: Floats


def split(mean: Floats, factor: Floats, margins: Margins) -> Shares:
    """Crossing and remaining shares of Gaussians whose densities end at the half-spaces at the start of the step.

    Moments are exact up to rounding or quadrature (1e-9). If the mean is behind the half-space, the whole mass is
    there: all that is inside crosses.

    Args:
        mean, factor: (..., p) and (..., k, p).
    """
    first, second, plane = _whitened(margins)
    moments = _moments_before(plane)
    probability = np.empty(margins.mean.shape)
    np.minimum(1.0, moments[MASS, 0], out=probability[0])
    # Without any mass to fit moments to, nothing crosses.
    probability[0, moments[MASS, 0] < NOTHING] = 0.0
    np.subtract(1.0, probability[0], out=probability[1])
    lost = ((probability < NEGLIGIBLE) | (moments[MASS] < NOTHING)).nonzero()
    if lost[0].size:
        probability[lost] = 0.0
        moments[:, *lost] = WHOLE
    center, root = _matched_gaussian(moments)
    # The noise along each of the two directions moves the state by as much.
    moved = [np.einsum("...kp,kp->...p", factor, direction) for direction in (first, second)]
    apart = (slice(None), *(None,) * (mean.ndim - 1))
    x, y, (narrowed, slant, rest) = center[0][apart], center[1][apart], root[:, *apart]
    changed = (moved[0] * (narrowed - 1.0) + moved[1] * slant)[..., None, :] * first
    changed += factor
    changed += (moved[1] * (rest - 1.0))[..., None, :] * second
    return Shares(probability, mean + moved[0] * x + moved[1] * y, changed)


def truncated(mean: Floats, factor: Floats, margin: Floats, row: Floats) -> tuple[Floats, Floats]:
    """Means and factors of Gaussians truncated at margin > 0, with their original widths; exact.

    Args:
        mean, factor: (..., p) and (..., k, p).
        margin, row: (p,) its means and (k, p) the rows of its square roots.
    """
    direction, along, z = _along(factor, margin, row)
    mills = np.sqrt(2 / np.pi) / erfcx(-z / np.sqrt(2))
    variance = np.where(z > -100.0, 1.0 - mills * (mills + z), 1.0 / np.minimum(z, -1.0) ** 2)
    return mean + along * mills, factor - (along * (1.0 - np.sqrt(variance)))[..., None, :] * direction


def is_cut(margin: Floats, row: Floats) -> Booleans:
    """(..., p) whether conditioning on margin > 0 truncates a Gaussian with rows (..., k, p)."""
    z = margin / np.sqrt(np.einsum("...kp,...kp->...p", row, row) + SMALLEST_STD**2)
    return np.asarray((z >= 0.0) & (z < _WHOLE))


def uncut(mean: Floats, factor: Floats, margin: Floats, row: Floats) -> tuple[Floats, Floats, Floats]:
    """Inverse of `truncated`: means and factors before truncation at margin > 0.

    A Gaussian truncated at its own mean has a mean `_STEEPEST` stds ahead. Where states pile up on a boundary the mean
    is nearer: then a share of them has that shape, and together with those on it (`onto_boundary`) the mean and the
    std.

    Args:
        mean, factor: (..., p) and (..., k, p).
        margin, row: (p,) means of the margins and (k, p) the rows of their square roots; `is_cut` holds for them.

    Returns:
        means, factors, and the share (p,) of them that does not lie on the boundary.
    """
    direction, along, ahead = _along(factor, margin, row)
    back, wider, share = _untruncated_moments(ahead)
    return mean - along * back, factor + (along * (wider - 1.0))[..., None, :] * direction, share


def onto_boundary(mean: Floats, factor: Floats, margin: Floats, row: Floats) -> tuple[Floats, Floats]:
    """Means and factors of Gaussians conditioned on margin = 0; arguments as in `uncut`."""
    direction, along, ahead = _along(factor, margin, row)
    return mean - along * ahead, factor - along[..., None, :] * direction


def _along(factor: Floats, margin: Floats, row: Floats) -> tuple[Floats, Floats, Floats]:
    """(noise direction (k, p) of the margin, its effect on states (..., p), margin in stds (p,))."""
    std = np.sqrt(np.einsum("kp,kp->p", row, row) + SMALLEST_STD**2)
    direction = row / std
    return direction, np.einsum("...kp,kp->...p", factor, direction), margin / std


def _untruncated_moments(ahead: Floats) -> tuple[Floats, Floats, Floats]:
    """(shift, scale, share) of Gaussians before truncation, relative to their truncated moments.

    Args:
        ahead: (p,) of the cut lies the mean of what is left, in its stds, as the answers are; of what is partly on the
            boundary the mean and std of all of it.
    """
    place, wider = (np.interp(ahead, _CUT_MEANS, values) for values in (_CUT_PLACES, _WIDER))
    share, piled = np.ones(ahead.shape), ahead < _STEEPEST
    if np.count_nonzero(piled):
        z = np.maximum(ahead[piled], _NEAREST)
        share[piled] = (1.0 + 1.0 / _STEEPEST**2) * z**2 / (1.0 + z**2)
        wider[piled] = z / share[piled] / _CUT_DISTANCES[0]
    return ahead - wider * place, wider, share


def _truncated_moments(place: Floats) -> tuple[Floats, Floats]:
    """(mean distance, std) of unit Gaussians with mean `place` truncated at 0."""
    mills = np.sqrt(2 / np.pi) / erfcx(-place / np.sqrt(2))
    return place + mills, np.sqrt(1.0 - mills * (mills + place))


_CUT_DISTANCES, _CUT_STDS = _truncated_moments(_CUT_PLACES)
_WIDER, _CUT_MEANS = 1.0 / _CUT_STDS, _CUT_DISTANCES / _CUT_STDS
_STEEPEST, _WHOLE = float(_CUT_MEANS[0]), float(_CUT_MEANS[-1])


def log_probability(margin: Floats, row: Floats) -> Floats:
    """log P(m > 0) (..., p) of margins with means (..., p) and rows (..., k, p)."""
    z = margin / np.sqrt(np.einsum("...kp,...kp->...p", row, row) + SMALLEST_STD**2)
    result, inside = np.zeros(z.shape), (z < REACH).nonzero()
    if inside[0].size:
        result[inside] = log_ndtr(z[inside])
    return result


def _moments_before(plane: _Plane) -> Floats:
    """Moments (6, 2, p) of crossing and remaining shares, of densities that end at the half-spaces before the step.

    If its mean is in front of a half-space, the whole mass is there: a part lies on it, the rest is a Gaussian
    truncated by it.
    """
    inside = plane.m0 > 0
    is_whole = inside | (plane.s0 == 0)
    ahead = np.where(is_whole, np.inf, -plane.m0 / np.where(is_whole, 1.0, plane.s0))
    near = (ahead < _WHOLE).nonzero()[0]
    if not near.size:
        return _moments_of_shares(plane, inside)
    shift, scale, share = np.zeros(ahead.size), np.ones(ahead.size), np.ones(ahead.size)
    shift[near], scale[near], share[near] = _untruncated_moments(ahead[near])
    m0, m1 = plane.m0 + plane.s0 * shift, plane.m1 + plane.k * shift
    wider = _Plane(m0, plane.s0 * scale, m1, plane.k * scale, plane.t)
    moments = _moments_of_shares(wider, inside)
    moments[..., near] *= share[near] / ndtr(-m0[near] / wider.s0[near])
    moments[XX] = scale**2 * moments[XX] + shift * (2 * scale * moments[X] + shift * moments[MASS])
    moments[XY] = scale * moments[XY] + shift * moments[Y]
    moments[X] = scale * moments[X] + shift * moments[MASS]
    there = share < 1.0
    if there.any():
        on_it = _on_the_boundary(plane.where(there), ahead[there])
        moments[..., there] += np.multiply(1.0 - share[there], on_it)
    return moments


def _on_the_boundary(plane: _Plane, place: Floats) -> Floats:
    """Moments (6, 2, p) of crossing and remaining shares of states with ζ0 = place."""
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = -(plane.m1 + plane.k * place) / plane.t
    upward = half_planes(
        np.clip(
            np.nan_to_num(offset, nan=_BEYOND_ALL_STDS, posinf=_BEYOND_ALL_STDS), -_BEYOND_ALL_STDS, _BEYOND_ALL_STDS
        )
    )
    mass, y, yy = upward[MASS], upward[X], upward[XX]
    return np.stack([mass, place * mass, y, place**2 * mass, place * y, yy])


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
    """Two orthonormal noise directions (k, p), the first along m0, and the margins in them."""
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


def _moments_of_shares(plane: _Plane, inside: Booleans) -> Floats:
    """Moments (6, 2, p) of crossing and remaining shares.

    `inside`: the mass that starts behind the guard crosses; otherwise there is none.
    """
    # The smaller angle between the lines that bound the wedge and where both margins move as one, roughly.
    wedged = plane.t > _SINE * (np.abs(plane.k) + 2 * plane.s0)
    if np.count_nonzero(wedged) == wedged.size:
        moments, sure = _closed_form_moments(plane, inside)
        if np.count_nonzero(sure) == sure.size:
            return moments
        is_open = ~sure
    else:
        moments, is_open = np.empty((6, 2, len(inside))), ~wedged
        is_point = plane.s0 == 0
        if is_point.any():
            moments[..., is_point] = _from_known_start(plane.where(is_point), inside[is_point])
            is_open &= ~is_point
        if wedged.any():
            moments[..., wedged], sure = _closed_form_moments(plane.where(wedged), inside[wedged])
            is_open[wedged] = ~sure
    if is_open.any():
        moments[..., is_open] = _integrate(plane.where(is_open), inside[is_open])
    return moments


def _from_known_start(plane: _Plane, inside: Booleans) -> Floats:
    """Moments (6, 2, p) of crossing and remaining shares for known starts: all that ends inside crosses."""
    moves = plane.k > 0
    offset = np.where(
        moves, -plane.m1 / np.where(moves, plane.k, 1.0), np.where(plane.m1 > 0, -_BEYOND_ALL_STDS, _BEYOND_ALL_STDS)
    )
    return half_planes(np.where(inside, -_BEYOND_ALL_STDS, np.clip(offset, -_BEYOND_ALL_STDS, _BEYOND_ALL_STDS)))


def _closed_form_moments(plane: _Plane, inside: Booleans) -> tuple[Floats, Booleans]:
    """As `_moments_of_shares`, for margins that both move; and whether the closed forms are sure (p,).

    The crossing mass is the wedge of m0 < 0 and m1 > 0.
    """
    place, moments = -plane.m0 / plane.s0, np.empty((6, 2, len(inside)))
    moments[:, 0], beyond = wedge(place, plane.k, plane.t, plane.m1)
    # The mass in front of the guard that does not cross is what stays.
    np.subtract(half_planes(place)[:, 1], moments[:, 0], out=moments[:, 1])
    if np.count_nonzero(inside):
        moments[:, 0, inside] = WHOLE - moments[:, 1, inside]
    crossing, staying = moments[MASS]
    sure = (crossing > _CERTAIN * beyond) | (crossing < 0.9 * NEGLIGIBLE)
    sure &= (staying > _CERTAIN) | (staying < 0.1 * NEGLIGIBLE)
    return moments, sure


def _integrate(plane: _Plane, inside: Booleans) -> Floats:
    """As `_moments_of_shares`, by quadrature over ζ0 and closed forms over ζ1."""
    edges = _quadrature_limits(plane)
    # Only intervals that are not empty: (i, nodes) of them, each with the number of its Gaussian.
    owner, number = np.nonzero(np.diff(edges, axis=1) > 0.0)
    lower, right = edges[owner, number][:, None], edges[owner, number + 1][:, None]
    half = (right - lower) / 2
    zeta = (lower + right) / 2 + half * _NODES
    mass = half * _WEIGHTS * np.exp(-0.5 * zeta**2) / np.sqrt(2 * np.pi)
    m0, s0, m1, k, t = (v[owner, None] for v in (plane.m0, plane.s0, plane.m1, plane.k, plane.t))
    start, reach = m0 + s0 * zeta, m1 + k * zeta
    behind, inner = start > 0, inside[owner, None]
    reach, mass = np.where(behind, np.inf, reach), np.where(behind & ~inner, 0.0, mass)
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = np.clip(-reach / t, -_BEYOND_ALL_STDS, _BEYOND_ALL_STDS)
    limit = np.where(t > 0, spread, np.where(reach > 0, -_BEYOND_ALL_STDS, _BEYOND_ALL_STDS))
    above, density = ndtr(-limit), np.exp(-0.5 * limit**2) / np.sqrt(2 * np.pi)
    first = np.searchsorted(owner, np.arange(len(inside)))
    crossing = _summed_moments(first, mass, zeta, above, density, limit)
    staying = _summed_moments(first, mass, zeta, 1 - above, -density, limit)
    return np.stack([crossing, staying], axis=1)


def _quadrature_limits(plane: _Plane) -> Floats:
    """(p, 13) sorted limits of the quadrature's intervals; unused ones are empty."""
    m0, s0, m1, k, t = plane.m0, plane.s0, plane.m1, plane.k, plane.t
    fixed = np.array([-REACH, -4.0, -1.5, 0.0, 1.5, 4.0, REACH])
    columns = [np.broadcast_to(fixed, (len(k), fixed.size))]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        columns.append(np.where(s0 > 0, -m0 / s0, REACH)[:, None])
        ends = (np.array([-6.0, -2.0, 0.0, 2.0, 6.0]) * t[:, None] - m1[:, None]) / k[:, None]
        columns.append(np.where(np.abs(k)[:, None] * REACH > SMALLEST_STD, ends, REACH))
    return np.sort(np.clip(np.concatenate(columns, axis=1), -REACH, REACH), axis=1)


def _summed_moments(first: Ints, mass: Floats, zeta: Floats, zeroth: Floats, density: Floats, limit: Floats) -> Floats:
    """(6, p) moments: sums over the intervals of each Gaussian, which begin at `first`."""

    def total(values: Floats, weights: Floats) -> Floats:
        return np.asarray(np.add.reduceat(np.einsum("ik,ik->i", values, weights), first))

    once = mass * zeta
    firsts = [total(once, zeroth), total(mass, density)]
    seconds = [total(once * zeta, zeroth), total(once, density), total(mass, zeroth + limit * density)]
    return np.stack([total(mass, zeroth), *firsts, *seconds])


def _matched_gaussian(moments: Floats) -> tuple[Floats, Floats]:
    """Means (2, ...) and lower covariance factors (3, ...: 00, 10, 11) of Gaussians with given moments."""
    x, y, xx, xy, yy = center = moments[1:] / moments[MASS]
    root = np.empty((3, *x.shape))
    # Rounding may leave a covariance slightly indefinite.
    root[0] = np.sqrt(np.maximum(xx - x * x, 0.0))
    root[1] = (xy - x * y) / np.where(root[0] > 0, root[0], np.inf)
    root[2] = np.sqrt(np.maximum(yy - y * y - root[1] ** 2, 0.0))
    return center[:2], root
