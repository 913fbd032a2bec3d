"""Paths: curves for rows that no single joint explains, if the part passes along the same curve again.

A path is free motion in the order of its poses along a curve, instead of in the order of time: a row is predicted from
its neighbours on the curve, of any pass. So it wins where the curve was passed more than once and agrees with itself;
for a single pass it is no better than free motion. The curve is a principal curve (Hastie and Stuetzle, JASA 1989) by
smoothing splines, initialised by distances along the rows' neighbourhood graph (Tenenbaum et al., Science 2000).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import splev, splprep
from scipy.linalg import cholesky, solve_triangular
from scipy.sparse.csgraph import dijkstra
from scipy.spatial.distance import cdist

from micah_plan.arrays import EQUAL, Floats, Ints
from micah_plan.automaton.joint import IDENTITY, Joint
from micah_plan.automaton.kinematics import ROTATION_LENGTH
from micah_plan.automaton.path import FEWEST_KNOTS, along_path, closest_on_path, path
from micah_plan.learning.joints.quaternions import conjugate, rotation_vector, times
from micah_plan.learning.roughness import extent
from micah_plan.learning.segmenting.free import (
    FINEST_EXTENT,
    Trend,
    density,
    likeliest_scale,
    price,
    roughness_stds,
    trend_of,
)
from micah_plan.learning.segmenting.noise import NoiseModel
from micah_plan.learning.segmenting.noise_fit import WANDER_DURATIONS
from micah_plan.learning.track import PartTrack

_ROUNDS = 4  # of curve and configurations alternately
_NEIGHBOURS = 3.0  # longest usual steps, or stds of noise, within which rows are neighbours
_MOST_KNOTS = 24
_ROWS_OF_A_KNOT = 3
_FEWEST_ROWS = 12
_PLACES = 17  # along a path, at which passes are counted
_STRIDE = 0.2  # of the path
_SCATTER = np.array([1.0, 4.0, 8.0])  # tried stds of a row's distance from its curve, in the roughness of rows
# Of a Gaussian process around a curve, in the roughness of rows: change of slope, and std of the tracker's wander.
_BENDS = np.geomspace(0.01, 3.0, 6)
_WANDERS = (1.0, 3.0, 9.0)  # sizes, over the white noise


@dataclass(frozen=True, eq=False)
class FoundPath:
    """A path with its evidence.

    Attributes:
        curve: as a joint.
        std: of a row's distance from it [m], rotations taken as lengths: white noise, and the tracker's wander.
        log_probability: of the track along it.
    """

    curve: Joint
    std: float
    log_probability: float


def principal_path(track: PartTrack, std: float, near: Joint | None = None) -> Joint | None:
    """The smooth curve through the rows as a joint; None with too few rows or without motion.

    Args:
        std: of a row's distance from the curve [m], rotations taken as lengths.
        near: a path close to it, from fewer rows; None: rows are ordered by their neighbourhood graph, at quadratic
            cost.
    """
    points = _points(track)
    c = _along_graph(points, std) if near is None else _closest(near, track)
    if len(points) < _FEWEST_ROWS or np.ptp(c) < _FEWEST_ROWS * std:
        return None
    for _ in range(_ROUNDS):
        curve = _smooth(c, points, std)
        if curve is None:
            return None
        c = _closest(curve, track)
    return _smooth(c, points, std)


def likeliest_path(track: PartTrack, noise: NoiseModel, likelihood_power: float) -> FoundPath | None:
    """The likeliest path of a track; None unless one is passed repeatedly and explains it.

    Args:
        noise, likelihood_power: as for free motion.
    """
    curves = [principal_path(track, std) for std in length_std(noise) * _SCATTER]
    candidates = [path_evidence(curve, track, noise, likelihood_power) for curve in curves if curve is not None]
    return max(
        (candidate for candidate in candidates if candidate is not None),
        key=lambda candidate: candidate.log_probability,
        default=None,
    )


def length_std(noise: NoiseModel) -> float:
    """Std of white noise of a row [m], with rotations converted to lengths."""
    return _length(roughness_stds(noise))


def path_evidence(curve: Joint, track: PartTrack, noise: NoiseModel, likelihood_power: float) -> FoundPath | None:
    """The evidence of a path against free motion; None where it is passed only once.

    Any motion follows some curve once. Whether it agrees with itself is seen where it was passed again.

    Args:
        noise, likelihood_power: as for free motion.
    """
    c = _closest(curve, track)
    if _passes(c) <= 1:
        return None
    order = np.argsort(c, kind="stable")
    vectors = _vectors(track, int(order[len(order) // 2]))
    stds = roughness_stds(noise)
    across = [
        _trend_along_curve(vector[order], std, c[order], order) for vector, std in zip(vectors, stds, strict=True)
    ]
    squares = np.sum([trend.squares for trend, _ in across], axis=0)
    sizes = np.sum([trend.sizes for trend, _ in across], axis=0)
    # One direction is told by the row before in time, how far the part came, and not by its neighbours on the curve.
    there = along_path(curve, c)
    moves = np.stack([there.turning, there.velocity])[-len(stds) :]
    std = float(1 / np.sqrt((moves**2).sum(axis=2).mean(axis=1) @ np.array(stds) ** -2))
    along = trend_of(c[:, None], std)
    log_probability = (
        density(squares, sizes, 3 * len(stds) - 1).sum() + density(along.squares, along.sizes - np.log(std), 1).sum()
    )
    priced = (2 * len(across) + 1) * price(len(c)) + np.log(len(_SCATTER))
    return FoundPath(curve, _length([std for _, std in across]), float(likelihood_power * log_probability - priced))


def _trend_along_curve(vector: Floats, std: float, c: Floats, row: Ints) -> tuple[Trend, float]:
    """The likeliest trend along a curve of rows (n, 3) ordered by their configurations c (n,), and their std.

    As for free motion, but in the order of the curve, plus the tracker's wander in time: one Gaussian process of both
    (Rasmussen and Williams, "Gaussian processes for machine learning", 2006, chapters 2 and 6.3).

    Args:
        std: roughness of the rows.
        row: (n,) their numbers in time.
    """
    n, k = vector.shape
    s = (c - c[0]) / (c[-1] - c[0]) * (n - 1)
    first, later = np.minimum.outer(s, s), np.maximum.outer(s, s)
    bent = first**2 * (3 * later - first) / 6
    begun = (max(extent(vector), FINEST_EXTENT) / std) ** 2 * (1 + np.outer(s, s) / (n - 1) ** 2)
    apart = np.abs(np.subtract.outer(row, row))
    wanders = [np.zeros((n, n))]
    wanders += [w**2 * np.exp(-apart / (tau * n)) for tau in WANDER_DURATIONS for w in _WANDERS]
    away, white = vector - vector.mean(axis=0), np.eye(n)
    tried = []
    for wander in wanders:
        for bends in _BENDS:
            lower = cholesky(begun + bends**2 * bent + wander + white, lower=True, check_finite=False)
            squares = (solve_triangular(lower, away, lower=True, check_finite=False) ** 2).sum(axis=1)
            scale = likeliest_scale(squares, k)
            trend = Trend(squares / scale, k * (np.log(np.diagonal(lower)) + 0.5 * np.log(scale)), 0.0)
            tried.append((trend, std * float(np.sqrt(scale * (1 + wander[0, 0])))))
    return max(tried, key=lambda pair: float(density(pair[0].squares, pair[0].sizes, k).sum()))


def _closest(curve: Joint, track: PartTrack) -> Floats:
    """(n,) configurations on a curve closest to the poses."""
    return closest_on_path(curve, track.position, track.quaternion, ROTATION_LENGTH)


def _passes(c: Floats) -> float:
    """Median number of passes over the places of a path, from configurations c (n,).

    In strides: that noise carries it to and fro at a place is no pass.
    """
    least = _STRIDE * float(np.ptp(c))
    kept = [float(c[0])]
    for value in c.tolist():
        if abs(value - kept[-1]) >= least:
            kept.append(value)
    ends = np.sort(np.stack([kept[:-1], kept[1:]]), axis=0)
    places = np.quantile(c, np.linspace(0.1, 0.9, _PLACES))
    by = ((ends[0] < places[:, None]) & (ends[1] >= places[:, None])).sum(axis=1)
    return float(np.median(by))


def _length(stds: Sequence[float]) -> float:
    """A combined length from stds of rotation [rad], if measured, and position [m]."""
    return float(np.linalg.norm(np.multiply(stds, [ROTATION_LENGTH, 1.0][-len(stds) :])))


def _points(track: PartTrack) -> Floats:
    """(n, 7) position [m] and quaternion, of which the distance is half the angle, scaled to lengths [m]."""
    quaternion = np.tile(IDENTITY, (len(track), 1)) if track.quaternion is None else track.quaternion
    return np.concatenate([track.position, 2 * ROTATION_LENGTH * quaternion], axis=1)


def _vectors(track: PartTrack, middle: int) -> list[Floats]:
    """Rotation from the pose of one row [rad], if it was measured, and position [m], (n, 3) each."""
    if track.quaternion is None:
        return [track.position]
    turned = times(track.quaternion, conjugate(track.quaternion[middle : middle + 1]))
    return [rotation_vector(turned), track.position]


def _along_graph(points: Floats, std: float) -> Floats:
    """(n,) geodesic distances [m] of points (n, k) from an end of their curve, by neighbours."""
    apart = cdist(points, points)
    steps = np.diagonal(apart, 1)
    reach = _NEIGHBOURS * max(float(np.quantile(steps, 0.9)), std)
    graph = np.where(apart <= reach, apart, 0.0)
    rows = np.arange(len(steps))
    graph[rows, rows + 1] = np.maximum(steps, EQUAL)
    first = dijkstra(graph, directed=False, indices=0)
    return np.asarray(dijkstra(graph, directed=False, indices=int(np.argmax(first))))


def _smooth(c: Floats, points: Floats, std: float) -> Joint | None:
    """The smoothing spline through points (n, 7) at c (n,), parameterised by length.

    None where the points are at too few places.
    """
    order = np.argsort(c, kind="stable")
    sorted_c, where = c[order], points[order]
    # Rows at nearly the same place are one, so that the spline has distinct places.
    finest = max(float(np.ptp(c)), 1e-12) / (4 * len(c))
    cell = np.cumsum(np.append(0.0, np.diff(sorted_c) > finest)).astype(int)
    count = np.bincount(cell)
    if len(count) <= FEWEST_KNOTS:
        return None
    x = np.bincount(cell, sorted_c) / count
    y = np.stack([np.bincount(cell, column) / count for column in where.T], axis=1)
    # There is noise in three directions, of positions and of rotations alike. Asked for its full output, it does not
    # warn where rows are rougher than that: the curve then has as many knots as it may.
    (curve, _), *_ = splprep(y.T, w=np.sqrt(count) / std, u=x, s=3.0 * len(x), full_output=True)
    fine = np.stack(splev(np.linspace(x[0], x[-1], 8 * _MOST_KNOTS), curve), axis=1)
    length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(fine, axis=0), axis=1)))
    if not length[-1] > 0:
        return None
    knots = int(np.clip(len(x) // _ROWS_OF_A_KNOT, FEWEST_KNOTS, _MOST_KNOTS))
    at = np.linspace(0.0, length[-1], knots)
    values = np.stack([np.interp(at, length, column) for column in fine.T], axis=1)
    return path(np.column_stack([at, values]))
