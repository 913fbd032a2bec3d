"""Noise of a track, estimated from its rows: first from their roughness, then from what joints leave."""

from __future__ import annotations

from collections.abc import Sequence
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
    zero = np.zeros((1, len(white)))
    return _model(white[None], zero, zero.copy(), len(track), settings)


def noises_left(answers: Sequence[tuple[Pool, Ints]], settings: LearnSettings) -> list[NoiseModel]:
    """The noise that each of some answers for a track leaves: white and fast wander of every channel, and correlation.

    Args:
        answers: joints as they see the rows, and which of them (n,) explains a row.
    """
    missed = [misses(pool, which) for pool, which in answers]
    errors, along, free = (np.stack(some) for some in zip(*missed, strict=True))
    model = _channels(errors + along, settings)
    correlation, dof = _correlated(model.whitened(errors), free / np.sqrt(model.left[:, None, -1]))
    noise = replace(model, correlation=correlation, dof=dof)
    return [noise.take([i]) for i in range(len(noise))]


def _channels(errors: Floats, settings: LearnSettings) -> NoiseModel:
    """The likeliest noise of every channel of errors (m, n, d), as if they were independent."""
    m, n, d = errors.shape
    order = min(MEMORY, n - 1)
    rough = _rough(errors[:, 1:-1] - 0.5 * (errors[:, :-2] + errors[:, 2:])).ravel()
    white_shares, fast_shares, durations = _CANDIDATES
    fast_kept = np.exp(-1 / np.maximum(n * durations, 1e-9))
    slow, slow_kept = _slow(n, d, settings)
    # Candidates (m d, c) of all channels at once.
    whites = np.maximum(white_shares * rough[:, None], np.tile(_finest(d), m)[:, None]) ** 2
    fasts, kept = (fast_shares * rough[:, None]) ** 2, np.tile(fast_kept, m * d)
    slows = np.repeat(np.tile(slow, m), len(fast_kept))
    coefficients, left = predictors(whites.ravel(), fasts.ravel(), slows, kept, slow_kept, order)
    channels = errors.swapaxes(1, 2).reshape(m * d, n)
    past = np.zeros((m * d, order, n))
    for lag in range(1, order + 1):
        past[:, lag - 1, lag:] = channels[:, : n - lag]
    innovation = channels[:, None] - coefficients[-1].reshape(order, m * d, -1).transpose(1, 2, 0) @ past
    variance = left[-1].reshape(m * d, -1, 1)
    density = -0.5 * np.log(variance) - 4.5 * np.log1p(innovation**2 / variance / 9.0)
    best, every = density.sum(axis=2).argmax(axis=1), np.arange(m * d)
    white, fast, likeliest = (x.reshape(m, d) for x in (whites[every, best], fasts[every, best], fast_kept[best]))
    return _model(white, fast, likeliest, n, settings)


def misses(pool: Pool, which: Ints) -> tuple[Floats, Floats, Floats]:
    """Errors of every row under the hypothesis (n,) that explains it, the noise along the joint, and its direction.

    All (n, d). Along a joint, noise is what a row misses of the middle of its neighbours.
    """
    rows = np.arange(len(which))
    c, direction = pool.seen.configuration[which, rows], pool.seen.direction[which, :, rows]
    missed = np.zeros(len(c))
    same = (which[2:] == which[1:-1]) & (which[:-2] == which[1:-1])
    missed[1:-1] = np.where(same, (c[1:-1] - 0.5 * (c[2:] + c[:-2])) * np.sqrt(2 / 3), 0.0)
    return pool.seen.error[which, :, rows], missed[:, None] * direction, direction


def _correlated(innovation: Floats, free: Floats) -> tuple[Floats, Floats]:
    """Correlation matrices (with a prior worth d + 2 rows of none) and tails of scaled innovations (m, n, d).

    Along free directions (m, n, d) nothing is known; expectation maximisation fills in what the matrix itself expects.
    """
    m, n, d = innovation.shape
    moving = free.any(axis=2)
    size, turns = d - moving, moving.sum(axis=1)
    # Every candidate (k, 1) of the tails beside every answer (m,).
    dof = np.array(_DOFS)[:, None]
    heavy = dof[..., None] + size
    matrix = np.broadcast_to(np.eye(d), (len(dof), m, d, d))
    for _ in range(_ITERATIONS):
        inverse = np.linalg.inv(matrix)
        squares = ((innovation @ inverse) * innovation).sum(axis=3)
        weight = heavy / (heavy + squares)
        hidden = ((free @ inverse) * free).sum(axis=3)
        level = np.sqrt(np.mean(squares / size, axis=2)[..., None] / np.maximum(hidden, 1e-300))
        filled = free * (level * moving)[..., None]
        covariance = (innovation * weight[..., None]).swapaxes(2, 3) @ innovation + filled.swapaxes(2, 3) @ filled
        covariance += (d + 2) * np.eye(d)
        std = np.sqrt(np.einsum("kmii->kmi", covariance))
        matrix = covariance / std[..., :, None] / std[..., None, :]
    squares = ((innovation @ np.linalg.inv(matrix)) * innovation).sum(axis=3)
    score = -0.5 * n * np.linalg.slogdet(matrix)[1] - 0.5 * (heavy * np.log1p(squares / heavy)).sum(axis=2)
    score += turns * log_peak(d - 1, dof) + (n - turns) * log_peak(d, dof)
    best = score.argmax(axis=0)
    return matrix[best, np.arange(m)], dof[best, 0]


def _model(white: Floats, fast: Floats, fast_kept: Floats, n: int, settings: LearnSettings) -> NoiseModel:
    """The noises of given variances and correlations (m, d), channels independent."""
    m, d = white.shape
    for value, index in ((settings.position_std, slice(d - 3, d)), (settings.rotation_std, slice(0, d - 3))):
        if value is not None:
            white[:, index], fast[:, index] = value**2, 0.0
    slow, slow_kept = _slow(n, d, settings)
    flat = white.ravel(), fast.ravel(), np.tile(slow, m), fast_kept.ravel()
    coefficients, left = predictors(*flat, slow_kept, min(MEMORY, max(n - 1, 0)))
    return NoiseModel(
        white=white,
        fast=fast,
        slow=np.tile(slow, (m, 1)),
        fast_kept=fast_kept,
        slow_kept=np.full((m, d), slow_kept),
        correlation=np.tile(np.eye(d), (m, 1, 1)),
        dof=np.full(m, _DOFS[0]),
        coefficients=np.ascontiguousarray(np.moveaxis(coefficients.reshape(*coefficients.shape[:2], m, d), 2, 0)),
        left=np.ascontiguousarray(left.reshape(-1, m, d).swapaxes(0, 1)),
    )


def _slow(n: int, d: int, settings: LearnSettings) -> tuple[Floats, float]:
    """Variances (d,) of the slow wander and its correlation in neighbouring rows."""
    stds = np.array([settings.rotation_wander] * (d - 3) + [settings.position_wander] * 3)
    return stds**2, float(np.exp(-1 / max(settings.wander_durations * n, 1e-9)))


def _rough(misses: Floats) -> Floats:
    """Stds (..., d) of white noise that leaves such misses (..., k, d) of the middle of the neighbours."""
    finest = _finest(misses.shape[-1])
    if not misses.shape[-2]:
        return np.broadcast_to(finest, (*misses.shape[:-2], len(finest)))
    return np.asarray(np.maximum(_STD_PER_MAD * np.median(np.abs(misses), axis=-2) / np.sqrt(_MISS_VARIANCE), finest))


def _finest(d: int) -> Floats:
    return np.array([_FINEST_ROTATION] * (d - 3) + [_FINEST_POSITION] * 3)
