"""Noise of a track, estimated from its rows: first from their roughness, then from what joints leave."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from micah_plan.learn.segmenting.noise import MEMORY, NoiseModel, log_peak, predictors
from micah_plan.learn.segmenting.pool import Pool
from micah_plan.learn.settings import LearnSettings
from micah_plan.learn.track import PartTrack

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_STD_PER_MAD = 1.4826
_MISS_VARIANCE = 1.5  # of a row from the middle of its neighbours, for white noise of variance 1
_FINEST_POSITION = 1e-4  # m; no tracker is better, and a std of 0 would make likelihoods infinite
_FINEST_ROTATION = 1e-3  # rad
_WHITE_SHARES = np.array([0.1, 0.3, 0.6, 1.0, 1.5])  # candidate stds, in those of the rows' roughness
# A smooth error that is large against the roughness of the rows is no tracker's: it is motion that a joint misses.
_FAST_SHARES = np.array([0.0, 0.5, 1.0, 2.0, 4.0])
_FAST_DURATIONS = np.array([1 / 100, 1 / 30])  # candidate correlation times of the fast wander, in runs
_CANDIDATES = np.array(list(product(_WHITE_SHARES, _FAST_SHARES, _FAST_DURATIONS))).T
_DOFS = (8.0, 30.0)
_ITERATIONS = 3


def first_noise(track: PartTrack, settings: LearnSettings) -> NoiseModel:
    """White noise from the rows' misses of their neighbours' line, and the wander that is always expected."""
    misses = [track.position[1:-1] - 0.5 * (track.position[:-2] + track.position[2:])]
    if track.rotation is not None:
        steps = (track.rotation[:-1].inv() * track.rotation[1:]).as_rotvec()
        misses.insert(0, 0.5 * (steps[:-1] - steps[1:]))
    white = _rough(np.concatenate(misses, axis=1)) ** 2
    zero = np.zeros(len(white))
    return _model(white, zero, zero, np.eye(len(white)), 8.0, len(track), settings)


def refitted_noise(errors: Floats, along: Floats, free: Floats, settings: LearnSettings) -> NoiseModel:
    """White noise and fast wander of the errors that joints leave, each channel on its own, and their correlation.

    Args:
        errors: (n, d) in time order, none of them along the joint.
        along: (n, d) the noise along it.
        free: (n, d) directions of the joint; 0 where it is rigid.
    """
    across, errors = errors, errors + along
    n, d = errors.shape
    order = min(MEMORY, n - 1)
    rough = _rough(errors[1:-1] - 0.5 * (errors[:-2] + errors[2:]))
    white_shares, fast_shares, durations = _CANDIDATES
    fast_kept = np.exp(-1 / np.maximum(n * durations, 1e-9))
    slow, slow_kept = _slow(n, d, settings)
    # Candidates (d, m) of all channels at once.
    whites = np.maximum(white_shares * rough[:, None], _finest(d)[:, None]) ** 2
    fasts, kept = (fast_shares * rough[:, None]) ** 2, np.tile(fast_kept, d)
    slows = np.repeat(slow, len(fast_kept))
    coefficients, left = predictors(whites.ravel(), fasts.ravel(), slows, kept, slow_kept, order)
    past = np.zeros((d, order, n))
    for lag in range(1, order + 1):
        past[:, lag - 1, lag:] = errors[: n - lag].T
    innovation = errors.T[:, None] - coefficients[-1].reshape(order, d, -1).transpose(1, 2, 0) @ past
    variance = left[-1].reshape(d, -1, 1)
    density = -0.5 * np.log(variance) - 4.5 * np.log1p(innovation**2 / variance / 9.0)
    best, every = density.sum(axis=2).argmax(axis=1), np.arange(d)
    model = _model(whites[every, best], fasts[every, best], fast_kept[best], np.eye(d), 8.0, n, settings)
    correlation, dof = _correlated(model.whitened(across, order), free / np.sqrt(model.left[-1]))
    return replace(model, correlation=correlation, dof=dof)


def misses(pool: Pool, which: Ints) -> tuple[Floats, Floats, Floats]:
    """Errors of every row under the hypothesis (n,) that explains it, the noise along the joint, and its direction.

    All (n, d). Along a joint, noise is what a row misses of the middle of its neighbours.
    """
    rows = np.arange(len(which))
    c, direction = pool.seen.configuration[which, rows], pool.seen.direction[which, rows]
    missed = np.zeros(len(c))
    same = (which[2:] == which[1:-1]) & (which[:-2] == which[1:-1])
    missed[1:-1] = np.where(same, (c[1:-1] - 0.5 * (c[2:] + c[:-2])) * np.sqrt(2 / 3), 0.0)
    return pool.seen.error[which, rows], missed[:, None] * direction, direction


def _correlated(innovation: Floats, free: Floats) -> tuple[Floats, float]:
    """Correlation matrix (with a prior worth d + 2 rows of none) and tails of scaled innovations (n, d).

    Along free directions (n, d) nothing is known; expectation maximisation fills in what the matrix itself expects.
    """
    n, d = innovation.shape
    moving = free.any(axis=1)
    size, peaks = d - moving, np.array([moving.sum(), n - moving.sum()])
    matrix = np.eye(d)
    found = []
    for dof in _DOFS:
        for _ in range(_ITERATIONS):
            inverse = np.linalg.inv(matrix)
            squares = np.einsum("ti,ti->t", innovation @ inverse, innovation)
            weight = (dof + size) / (dof + size + squares)
            hidden = np.einsum("ti,ti->t", free @ inverse, free)
            level = np.sqrt(np.mean(squares / size) / np.maximum(hidden, 1e-300))
            filled = free * (level * moving)[:, None]
            covariance = (innovation * weight[:, None]).T @ innovation + filled.T @ filled + (d + 2) * np.eye(d)
            std = np.sqrt(np.diag(covariance))
            matrix = covariance / std[:, None] / std
        squares = np.einsum("ti,ti->t", innovation @ np.linalg.inv(matrix), innovation)
        score = -0.5 * n * np.linalg.slogdet(matrix)[1] - 0.5 * ((dof + size) * np.log1p(squares / (dof + size))).sum()
        found.append((float(score + peaks @ [log_peak(d - 1, dof), log_peak(d, dof)]), matrix, dof))
    _, matrix, dof = max(found, key=lambda one: one[0])
    return matrix, dof


def _model(
    white: Floats, fast: Floats, fast_kept: Floats, correlation: Floats, dof: float, n: int, settings: LearnSettings
) -> NoiseModel:
    d = len(white)
    for value, index in ((settings.position_std, slice(d - 3, d)), (settings.rotation_std, slice(0, d - 3))):
        if value is not None:
            white[index], fast[index] = value**2, 0.0
    slow, slow_kept = _slow(n, d, settings)
    kept = np.full(d, slow_kept)
    coefficients, left = predictors(white, fast, slow, fast_kept, slow_kept, min(MEMORY, max(n - 1, 0)))
    return NoiseModel(white, fast, slow, fast_kept, kept, correlation, dof, coefficients, left)


def _slow(n: int, d: int, settings: LearnSettings) -> tuple[Floats, float]:
    """Variances (d,) of the slow wander and its correlation in neighbouring rows."""
    stds = np.array([settings.rotation_wander] * (d - 3) + [settings.position_wander] * 3)
    return stds**2, float(np.exp(-1 / max(settings.wander_durations * n, 1e-9)))


def _rough(misses: Floats) -> Floats:
    """Std (d,) of white noise that leaves such misses (k, d) of the middle of the neighbours."""
    finest = _finest(misses.shape[1])
    if not len(misses):
        return finest
    return np.asarray(np.maximum(_STD_PER_MAD * np.median(np.abs(misses), axis=0) / np.sqrt(_MISS_VARIANCE), finest))


def _finest(d: int) -> Floats:
    return np.array([_FINEST_ROTATION] * (d - 3) + [_FINEST_POSITION] * 3)
