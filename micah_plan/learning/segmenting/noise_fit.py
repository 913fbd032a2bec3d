"""Noise of a track: first from second differences of its rows, then from the residuals of joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from micah_plan.arrays import ROUND_OFF, Floats, Ints
from micah_plan.learning.roughness import bends, std_of_bends
from micah_plan.learning.segmenting.noise import MEMORY, NoiseModel, log_peak, predictors
from micah_plan.learning.segmenting.pool import Pool
from micah_plan.learning.settings import LearnSettings
from micah_plan.learning.track import PartTrack

_FINEST_POSITION = 1e-4  # m; no tracker is better, and a std of 0 would make likelihoods infinite
_FINEST_ROTATION = 1e-3  # rad
_WHITE_SHARES = np.array([0.1, 0.3, 0.6, 1.0, 1.5])  # candidate stds, in those of the rows' roughness
# A smooth error that is large against the roughness of the rows is no tracker's: it is motion that a joint misses.
_FAST_SHARES = np.array([0.0, 0.5, 1.0, 2.0, 4.0])
# Candidate correlation times of the fast wander, in runs; the slow one is next, with more than a run.
WANDER_DURATIONS = np.array([1 / 100, 1 / 30, 1 / 10])
_FAST_MOST = 1.75  # stds of the slow wander; more is motion as well
# The slow wander is as large as is expected; or, where answers are doubted, as small as the rows tell it.
_ANY_SLOW = np.array([1.0, 0.25, 0.0625])
_DOFS = (8.0, 30.0)  # of Student's distribution, tried
_ITERATIONS = 3


def initial_noise(track: PartTrack, settings: LearnSettings) -> NoiseModel:
    """Initial noise: white from second differences of rows, and the assumed drift."""
    missed = [bends(track.position)]
    if track.rotation is not None:
        steps = (track.rotation[:-1].inv() * track.rotation[1:]).as_rotvec()
        missed.insert(0, 0.5 * (steps[:-1] - steps[1:]))
    white = _white_stds(np.stack(missed)[None]) ** 2
    slow, slow_kept = _slow(len(track), 3 * white.shape[1], settings)
    none = np.zeros_like(white)
    return _model(white, none, slow[None], none, slow_kept, len(track), settings)


def fit_noise_to_residuals(
    answers: Sequence[tuple[Pool, Ints]], settings: LearnSettings, any_slow: bool = False
) -> list[NoiseModel]:
    """Noise estimated from the residuals of each answer for a track: white, fast drift, correlation and tails.

    Args:
        answers: joints with their errors, and which of them (n,) explains a row.
        any_slow: whether the slow wander may be smaller than it is expected to be.
    """
    shares = _ANY_SLOW if any_slow else _ANY_SLOW[:1]
    errors, free = (np.stack(part) for part in zip(*(misses(pool, which) for pool, which in answers), strict=True))
    m, _, d = errors.shape
    correlation = np.tile(np.eye(d), (m, 1, 1))
    # Scales again in the axes that a tracker turns out to have.
    for _ in range(2):
        model = _scales(errors, free, correlation, shares, settings)
        correlation, dof = correlated(model.whitened(errors), free / np.sqrt(model.left[:, None, -1]))
    noise = replace(model, correlation=correlation, dof=dof)
    return [noise.take([i]) for i in range(len(noise))]


def _scales(
    errors: Floats, free: Floats, correlation: Floats, slow_shares: Floats, settings: LearnSettings
) -> NoiseModel:
    """Maximum-likelihood scales of errors (m, n, d), isotropic for rotations and for positions.

    Args:
        free: (m, n, d) directions of the motion, in which errors are unknown.
        correlation: (m, d, d) current estimate.
        slow_shares: tried stds of the slow wander, relative to the expected one.
    """
    m, n, d = errors.shape
    order = min(MEMORY, n - 1)
    # Every 3-vector on its own, in the axes and units that its correlation has.
    blocks = np.stack([correlation[:, i : i + 3, i : i + 3] for i in range(0, d, 3)], axis=1)
    scaling = np.linalg.inv(np.linalg.cholesky(blocks))
    vectors, along = (scaling @ block.reshape(m, n, d // 3, 3).transpose(0, 2, 3, 1) for block in (errors, free))
    missed = (vectors[..., 1:-1] - 0.5 * (vectors[..., 2:] + vectors[..., :-2])).swapaxes(2, 3)
    share = (along**2).sum(axis=2) / _white_stds(missed, 3.0)[..., None] ** 2
    size = 3 - share / np.maximum(share.sum(axis=1, keepdims=True), 1e-300)
    roughness_stds = _white_stds(missed, size.mean(axis=2))
    tried = product(_WHITE_SHARES, _FAST_SHARES, WANDER_DURATIONS, slow_shares)
    white_shares, fast_shares, durations, slow_shares = np.array(list(tried)).T
    fast_kept = np.exp(-1 / np.maximum(n * durations, 1e-9))
    slow, slow_kept = _slow(n, d, settings)
    # Candidates (m, d / 3, c) of all scales at once.
    whites = np.maximum(white_shares * roughness_stds[..., None], finest_stds(d)[:, None]) ** 2
    fasts = np.minimum(fast_shares * roughness_stds[..., None], _FAST_MOST * np.sqrt(slow)[:, None]) ** 2
    kept = np.broadcast_to(fast_kept, whites.shape)
    slows = np.broadcast_to(slow[:, None] * slow_shares**2, whites.shape)
    coefficients, innovation = predictors(whites.ravel(), fasts.ravel(), slows.ravel(), kept.ravel(), slow_kept, order)
    past = np.zeros((*vectors.shape[:3], order, n))
    for lag in range(1, order + 1):
        past[..., lag - 1, lag:] = vectors[..., : n - lag]
    weights = coefficients[-1].reshape(order, *whites.shape).transpose(1, 2, 3, 0)[:, :, None] @ past
    squares = ((vectors[..., None, :] - weights) ** 2).sum(axis=2)
    variance, size = innovation[-1].reshape(*whites.shape, 1), size[:, :, None]
    heavy = _DOFS[0] + size
    density = -0.5 * (size * np.log(variance) + heavy * np.log1p(squares / variance / heavy))
    best = density.sum(axis=3).argmax(axis=2)[..., None]
    white, fast, slow, kept = (
        np.take_along_axis(parameter, best, axis=2)[..., 0] for parameter in (whites, fasts, slows, kept)
    )
    return _model(white, fast, slow, kept, slow_kept, n, settings)


def misses(pool: Pool, which: Ints) -> tuple[Floats, Floats]:
    """Errors (n, d) of every row under the hypothesis (n,) that explains it, and the direction of its motion (n, d)."""
    rows = np.arange(len(which))
    return pool.seen.error[which, :, rows], pool.seen.direction[which, :, rows]


def correlated(innovation: Floats, free: Floats) -> tuple[Floats, Floats]:
    """Regularised correlation matrices and tails of scaled innovations (m, n, d).

    Their scale is that of a whole vector: a tracker's own axes are in the matrix. Along free directions (m, n, d)
    errors are unknown; expectation maximisation fills in their expectation under the matrix.
    """
    m, n, d = innovation.shape
    length = np.sqrt((free**2).sum(axis=2))
    # The position of a part whose origin is on its axis is uninformative in some direction.
    moving = length > ROUND_OFF
    free = moving[..., None] * free / np.maximum(length, ROUND_OFF)[..., None]
    size, turns = d - moving, moving.sum(axis=1)
    # Every candidate (k, 1) of the tails with every answer (m,).
    dof = np.array(_DOFS)[:, None]
    heavy = dof[..., None] + size
    matrix = np.broadcast_to(np.eye(d), (len(dof), m, d, d))
    for _ in range(_ITERATIONS):
        inverse = np.linalg.inv(matrix)
        squares = ((innovation @ inverse) * innovation).sum(axis=3)
        weight = heavy / (heavy + squares)
        hidden = ((free @ inverse) * free).sum(axis=3)
        level = np.sqrt(np.mean(squares / size, axis=2)[..., None] / np.maximum(hidden, ROUND_OFF))
        filled = free * level[..., None]
        covariance = (innovation * weight[..., None]).swapaxes(2, 3) @ innovation + filled.swapaxes(2, 3) @ filled
        covariance += (d + 2) * np.eye(d)
        std = np.sqrt(np.einsum("kmii->kmi", covariance).reshape(len(dof), m, -1, 3).mean(axis=3)).repeat(3, axis=2)
        matrix = covariance / std[..., :, None] / std[..., None, :]
    squares = ((innovation @ np.linalg.inv(matrix)) * innovation).sum(axis=3)
    score = -0.5 * n * np.linalg.slogdet(matrix)[1] - 0.5 * (heavy * np.log1p(squares / heavy)).sum(axis=2)
    score += turns * log_peak(d - 1, dof) + (n - turns) * log_peak(d, dof)
    best = score.argmax(axis=0)
    return matrix[best, np.arange(m)], dof[best, 0]


def _model(
    white: Floats, fast: Floats, slow: Floats, fast_kept: Floats, slow_kept: float, n: int, settings: LearnSettings
) -> NoiseModel:
    """The noises of given variances and correlations (m, d / 3), channels independent."""
    m, vectors = white.shape
    d = 3 * vectors
    for value, index in ((settings.position_std, vectors - 1), (settings.rotation_std, slice(0, vectors - 1))):
        if value is not None:
            white[:, index], fast[:, index] = value**2, 0.0
    flat = white.ravel(), fast.ravel(), slow.ravel(), fast_kept.ravel()
    coefficients, innovation = (
        np.moveaxis(part.reshape(*part.shape[:-1], m, vectors).repeat(3, axis=-1), -2, 0)
        for part in predictors(*flat, slow_kept, min(MEMORY, max(n - 1, 0)))
    )
    return NoiseModel(
        white=white.repeat(3, axis=1),
        fast=fast.repeat(3, axis=1),
        slow=slow.repeat(3, axis=1),
        fast_kept=fast_kept.repeat(3, axis=1),
        slow_kept=np.full((m, d), slow_kept),
        correlation=np.tile(np.eye(d), (m, 1, 1)),
        dof=np.full(m, _DOFS[0]),
        coefficients=np.ascontiguousarray(coefficients),
        left=np.ascontiguousarray(innovation),
    )


def _slow(n: int, d: int, settings: LearnSettings) -> tuple[Floats, float]:
    """Variances (d / 3,) of the slow drift, and its lag-1 correlation."""
    stds = np.array([settings.rotation_wander, settings.position_wander])[-d // 3 :]
    return stds**2, float(np.exp(-1 / max(settings.wander_durations * n, 1e-9)))


def _white_stds(missed: Floats, size: ArrayLike = 3.0) -> Floats:
    """Stds (m, d / 3) of white noise that leaves such misses (m, d / 3, k, 3) of the middle of the neighbours."""
    finest = finest_stds(3 * missed.shape[1])
    if not missed.shape[2]:
        return np.broadcast_to(finest, missed.shape[:2])
    return np.maximum(std_of_bends(missed, size), finest)


def finest_stds(d: int) -> Floats:
    """Lower bounds of white noise in d channels: of rotations [rad], if there are any, and of positions [m]."""
    return np.array([_FINEST_ROTATION, _FINEST_POSITION])[-d // 3 :]
