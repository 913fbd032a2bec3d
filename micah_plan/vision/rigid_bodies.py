"""Rigid bodies in tracks of points: which point moves with which, and the pose of each body in each frame.

Points of one body keep their distances. Groups of points whose distances vary least start the bodies; then each body
has a shape and poses, every point is assigned to the body that explains it best, and two bodies that one explains as
well are merged. Noise is Student's t, with the scale of the points in their bodies.

Sources: Yan and Pollefeys, "A general framework for motion segmentation", ECCV 2006 (rigid groups by affinities);
Kabsch, Acta Crystallographica 1976, and Lange, Little and Taylor, JASA 1989 (t distribution by weights).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from micah_plan.arrays import Booleans, Floats, Ints

FEWEST_POINTS = 4
"""Of a body; three are always rigid, and say nothing of it."""
# Frames that two points must be seen in together, and groups that bodies begin with at most.
_TOGETHER, _MOST_GROUPS = 8, 25
# Points of one body vary in distance by so many times the noise at most.
_ONE_BODY = 2.2
_FREEDOM = 4.0
_ROUNDS, _SEARCHES = 12, 30
# Share of measurements that are no point of any body.
_GROSS = 0.1
# A point is of a body if so many of its measurements are within three stds.
_MOSTLY = 0.5
# A point farther from the middle of its body than so many times the median of its points is another's.
_FARTHEST = 5.0
# What is blurred by more than this share of its size has no turns: points that move each by itself.
_BLURRED = 0.3
# Median and mean of the length of a normal vector in space, in stds.
_MEDIAN_LENGTH = 1.538


@dataclass(frozen=True, eq=False)
class RigidBody:
    """Points that move together, with their poses.

    Attributes:
        points: (n,) their numbers.
        shape: (n, 3) in the frame of the body, whose origin is in their middle [m].
        turns: (T, 3, 3) body to camera, NaN where it is not seen. positions: (T, 3) of its origin [m].
        weights: (T, n) how much each measurement counts.
        noise: std of a measurement in each direction [m].
    """

    points: Ints
    shape: Floats
    turns: Floats
    positions: Floats
    weights: Floats
    noise: float

    @property
    def is_seen(self) -> Booleans:
        """(T,) whether it has a pose."""
        return np.isfinite(self.turns[:, 0, 0])

    def covariance(self, frame: int) -> Floats:
        """(6, 6) covariance of position [m] and small rotation [rad] in a frame."""
        arms = self.shape @ self.turns[frame].T
        information = np.zeros((6, 6))
        for arm, weight in zip(arms, self.weights[frame], strict=True):
            x, y, z = arm
            rows = np.hstack([np.eye(3), -np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])])
            information += min(weight, 1.0) * rows.T @ rows
        return np.asarray(self.noise**2 * np.linalg.pinv(information))


def rigid_bodies(tracks: Floats) -> tuple[RigidBody, ...]:
    """The bodies of tracks (N, T, 3) [m], most points first; NaN where a point is not seen.

    Points that belong to none are in no body. Empty if no four points move together.
    """
    seen: Booleans = np.asarray(np.isfinite(tracks).all(axis=2))
    varies = _variation(tracks)
    near = np.sort(np.where(np.isfinite(varies), varies, np.inf), axis=1)[:, :5].mean(axis=1)
    if not np.isfinite(near).any():
        return ()
    noise = max(1.15 * float(np.median(near[np.isfinite(near)])), 1e-6)
    groups = _initial_groups(varies, noise)
    volume = _volume(tracks, noise)
    for _ in range(_SEARCHES):
        if not groups:
            return ()
        bodies = [_fitted(tracks, seen, group, noise) for group in groups]
        after, scale = _regrouped(tracks, seen, bodies, volume)
        is_same = len(after) == len(groups) and all(map(np.array_equal, after, groups))
        is_settled = is_same and abs(scale / noise - 1.0) < 0.05
        groups, noise = after, float(np.clip(scale, 1e-6, 2.0 * noise))
        if is_settled:
            break
    groups = [_compact(tracks, seen, group, noise) for group in groups]
    kept = sorted((group for group in groups if len(group) >= FEWEST_POINTS), key=len, reverse=True)
    found = (_fitted(tracks, seen, group, noise) for group in kept)
    return tuple(body for body in found if noise < _BLURRED * float(np.sqrt(np.mean(body.shape**2))))


def _variation(tracks: Floats) -> Floats:
    """(N, N) how much the distance of two points varies [m], from its quantiles; NaN where rarely seen together."""
    count = len(tracks)
    varies = np.full((count, count), np.nan)
    for i in range(count - 1):
        distance = np.linalg.norm(tracks[i + 1 :] - tracks[i], axis=2)
        able = np.isfinite(distance).sum(axis=1) >= _TOGETHER
        if able.any():
            low, high = np.nanquantile(distance[able], [0.1, 0.9], axis=1)
            varies[i, i + 1 :][able] = (high - low) / 2.563
    return np.asarray(np.fmax(varies, varies.T))


def _initial_groups(varies: Floats, noise: float) -> list[Ints]:
    """Groups of points whose distances vary by no more than noise."""
    filled = np.where(np.isfinite(varies), varies, 3.0 * noise)
    np.fill_diagonal(filled, 0.0)
    label = fcluster(linkage(squareform(filled, checks=False), "average"), _ONE_BODY * noise, "distance")
    groups = [np.flatnonzero(label == number) for number in np.unique(label)]
    return sorted((group for group in groups if len(group) >= FEWEST_POINTS), key=len, reverse=True)[:_MOST_GROUPS]


def _volume(tracks: Floats, noise: float) -> float:
    """Volume of the region of points [m^3], over which gross errors are uniform."""
    low, high = np.nanquantile(tracks.reshape(-1, 3), [0.02, 0.98], axis=0)
    return float(np.prod(high - low + 10.0 * noise))


def _turned(shape: Floats, places: Floats, weights: Floats) -> tuple[Floats, Floats, Floats]:
    """Rotations (T, 3, 3) and translations (T, 3) of a shape (n, 3) onto points (T, n, 3), with singular values
    (Kabsch).
    """
    total = np.maximum(weights.sum(axis=1), 1e-12)[:, None]
    middle = weights @ shape / total
    other = np.einsum("tn,tni->ti", weights, places) / total
    moments = np.einsum("tn,tni,tnj->tij", weights, places - other[:, None], shape[None] - middle[:, None])
    left, sizes, right = np.linalg.svd(moments)
    left[:, :, 2] *= np.linalg.det(left @ right)[:, None]
    turns = left @ right
    return turns, other - np.einsum("tij,tj->ti", turns, middle), sizes


def _weights(squared: Floats, noise: float) -> Floats:
    """Weights of measurements from squared errors: EM of a multivariate t distribution."""
    return np.asarray((_FREEDOM + 3.0) / (_FREEDOM + squared / noise**2))


def _fitted(tracks: Floats, seen: Booleans, group: Ints, noise: float) -> RigidBody:
    places, there = np.nan_to_num(tracks[group]).transpose(1, 0, 2), seen[group].T
    shape, turns, shifts = _grown_shape(places, there, noise)
    for _ in range(_ROUNDS):
        good = np.isfinite(turns[:, 0, 0])
        back = np.einsum(
            "tij,tni->tnj", np.where(good[:, None, None], turns, 0.0), places - np.nan_to_num(shifts)[:, None]
        )
        weights = there * good[:, None] * _weights(((back - shape) ** 2).sum(axis=2), noise)
        shape = np.einsum("tn,tni->ni", weights, back) / np.maximum(weights.sum(axis=0), 1e-9)[:, None]
        weights = there * _weights(((back - shape) ** 2).sum(axis=2), noise)
        turns, shifts, sizes = _turned(shape, places, weights)
        is_known = (there.sum(axis=1) >= 3) & (sizes[:, 1] > 1e-9)
        turns = np.where(is_known[:, None, None], turns, np.nan)
    middle = shape.mean(axis=0)
    return RigidBody(group, shape - middle, turns, shifts + turns @ middle, weights, noise)


def _grown_shape(places: Floats, there: Booleans, noise: float) -> tuple[Floats, Floats, Floats]:
    """Initial shape and poses, propagated from the frame with most points; new points are placed by the poses."""
    frames, count = there.shape
    first = int(there.sum(axis=1).argmax())
    shape = np.full((count, 3), np.nan)
    shape[there[first]] = places[first][there[first]]
    turns, shifts = np.full((frames, 3, 3), np.nan), np.full((frames, 3), np.nan)
    for k in np.argsort(np.abs(np.arange(frames) - first), kind="stable"):
        known = there[k] & np.isfinite(shape[:, 0])
        if known.sum() < 3:
            continue
        weights = np.ones(int(known.sum()))
        for _ in range(5):
            turn, shift, _ = _turned(shape[known], places[k][known][None], weights[None])
            off = np.linalg.norm(shape[known] @ turn[0].T + shift[0] - places[k][known], axis=1)
            weights = 1.0 / (1.0 + (off / (2.5 * max(noise, float(np.median(off))))) ** 2) ** 2
        turns[k], shifts[k] = turn[0], shift[0]
        new = there[k] & ~known
        shape[new] = (places[k][new] - shifts[k]) @ turns[k]
    return np.nan_to_num(shape), turns, shifts


def _explained(tracks: Floats, seen: Booleans, body: RigidBody, volume: float) -> tuple[Floats, Floats]:
    """((N,) log likelihood of each point on a body, fraction of its measurements near it)."""
    good, noise = body.is_seen, body.noise
    there = seen.T & good[:, None]
    shifts = np.nan_to_num(body.positions)[:, None]
    back = np.einsum("tij,tni->tnj", np.nan_to_num(body.turns), np.nan_to_num(tracks).transpose(1, 0, 2) - shifts)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        place = np.nan_to_num(np.nanmedian(np.where(there[..., None], back, np.nan), axis=0))
    for _ in range(3):
        weights = there * _weights(((back - place) ** 2).sum(axis=2), noise)
        place = np.einsum("tn,tni->ni", weights, back) / np.maximum(weights.sum(axis=0), 1e-9)[:, None]
    squared = ((back - place) ** 2).sum(axis=2)
    inside = (1.0 - _GROSS) * np.exp(-0.5 * squared / noise**2) / (2.0 * np.pi * noise**2) ** 1.5
    # Frames in which the body has no pose cost as much as a gross error.
    density = np.where(there, np.log(inside + _GROSS / volume), np.where(seen.T, np.log(_GROSS / volume), 0.0))
    near = (there & (squared < 9.0 * noise**2)).sum(axis=0) / np.maximum(seen.sum(axis=1), 1)
    return density.sum(axis=0), near


def _regrouped(tracks: Floats, seen: Booleans, bodies: Sequence[RigidBody], volume: float) -> tuple[list[Ints], float]:
    """(points grouped by their most likely body after the cheapest merge of two bodies, noise)."""
    pairs = [_explained(tracks, seen, body, volume) for body in bodies]
    density, near = np.array([pair[0] for pair in pairs]), np.array([pair[1] for pair in pairs])
    best = density.argmax(axis=0)
    is_kept = near[best, np.arange(len(tracks))] > _MOSTLY
    groups = [np.flatnonzero((best == number) & is_kept) for number in range(len(bodies))]
    joined = _union(groups, density, bodies)
    if joined is not None:
        less, more = joined
        if more is not None:
            groups[more] = np.union1d(groups[more], groups[less])
        groups = [group for number, group in enumerate(groups) if number != less]
    return [group for group in groups if len(group) >= FEWEST_POINTS], _scale(tracks, seen, bodies)


def _union(groups: Sequence[Ints], density: Floats, bodies: Sequence[RigidBody]) -> tuple[int, int | None] | None:
    """(removed body, remaining body) of the best merge; None if all bodies are needed.

    Removing a body saves its poses, three numbers for position and three for orientation in each frame (half a log of
    its points each; Schwarz, Annals of Statistics 1978).
    """
    found, most = None, 0.0
    for less, group in enumerate(groups):
        if len(group) < FEWEST_POINTS:
            return less, None
        saved = 3.0 * float(bodies[less].is_seen.sum()) * float(np.log(max(len(group), 3)))
        for more, other in enumerate(groups):
            if more != less and len(other) >= len(group):
                gain = saved - float((density[less, group] - density[more, group]).sum())
                if gain > most:
                    found, most = (less, more), gain
    return found


def _scale(tracks: Floats, seen: Booleans, bodies: Sequence[RigidBody]) -> float:
    """Noise of the points in their bodies [m]."""
    lengths = []
    for body in bodies:
        there = seen[body.points].T & body.is_seen[:, None]
        at = np.einsum("tij,nj->tni", np.nan_to_num(body.turns), body.shape) + np.nan_to_num(body.positions)[:, None]
        off = np.linalg.norm(np.nan_to_num(tracks[body.points]).transpose(1, 0, 2) - at, axis=2)
        lengths.append(off[there])
    every = np.concatenate(lengths)
    return float(np.median(every)) / _MEDIAN_LENGTH if len(every) else bodies[0].noise


def _compact(tracks: Floats, seen: Booleans, group: Ints, noise: float) -> Ints:
    """The points without outliers: a distant static point fits a small body as well."""
    if len(group) < FEWEST_POINTS:
        return group
    shape = _fitted(tracks, seen, group, noise).shape
    away = np.linalg.norm(shape - np.median(shape, axis=0), axis=1)
    return np.asarray(group[away <= _FARTHEST * max(float(np.median(away)), noise)])
