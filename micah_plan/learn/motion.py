"""How a part moves along its joint: the latent configuration's step, given the action.

c_{t+1} = c_t + h·a_t + w_t, where w_t is 0 with probability ρ and N(μ, q) otherwise. Without actions (CHAMP) h = 0, μ
is the typical step of the demonstration and ρ the prior share of rest; with them μ = 0, w_t is what the action leaves
unexplained, and ρ is how often it explains all. The action channel h is linear in three numbers whatever frame, gain or
side of the joint the actions were given at: in the part's frame every joint's direction of motion is constant, so
J⁻¹ R g is one row vector (MICAH, equation for the predicted pose, with the measured configuration replaced by its
filtered estimate).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micah_plan.learn.hypothesis import JointView

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_STEP_SHARES = np.array([0.01, 0.03, 0.1, 0.3, 1.0, 3.0])  # of the mean squared step, as candidates for E[w²]
_EXPLAINED_SHARES = np.array([0.4, 0.5, 0.6])  # candidates for ρ with actions
_EXPECTATION_STEPS = 12
_MOST_AMPLIFIED = 1.2  # how much longer than J⁻¹ an action channel in another frame may be
_FEWEST_ROWS = 12  # to tell an action channel
_TINY = 1e-16


@dataclass(frozen=True, eq=False)
class MotionModels:
    """The step models of m hypotheses.

    Attributes:
        spread: (m,) mean of w² [rad² or m² per row], by which the filter of the configuration opens.
        mean: (m,) μ [rad or m per row].
        variance: (m,) q [rad² or m² per row].
        rest: (m,) ρ.
        gain: (m, 3) h [rad or m per m of action in the part's frame]; 0 where actions say nothing.
        parameters: (m,) how many numbers were fitted.
    """

    spread: Floats
    mean: Floats
    variance: Floats
    rest: Floats
    gain: Floats
    parameters: Floats

    def log_density(self, innovation: Floats, quiet: Floats) -> Floats:
        """(..., m) ln density of innovations (..., m) whose variance is `quiet` (..., m) where w = 0."""
        return log_step_density(innovation, quiet, self.mean, self.variance, self.rest)


@dataclass(frozen=True, eq=False)
class _Model:
    spread: float
    mean: float
    variance: float
    rest: float
    gain: Floats
    parameters: float
    log_likelihood: float


def fit_motion(
    views: Sequence[JointView], action: Floats | None, inlier: Bools, forgetting: Floats, rest: float
) -> MotionModels:
    """Maximum-likelihood step models of hypotheses, each on the rows it was fitted to.

    Args:
        views: the m hypotheses.
        action: (n, 3) in the part's frame [m]; None for CHAMP.
        inlier: (n,) rows that count.
        forgetting: (n,) share of the wander's variance that is renewed before each row.
        rest: ρ where actions explain nothing.
    """
    models = [_fit_one(one, action, inlier, forgetting, rest) for one in views]
    return MotionModels(
        np.array([m.spread for m in models]),
        np.array([m.mean for m in models]),
        np.array([m.variance for m in models]),
        np.array([m.rest for m in models]),
        np.array([m.gain for m in models]).reshape(-1, 3),
        np.array([m.parameters for m in models]),
    )


def log_step_density(innovation: Floats, quiet: Floats, mean: Floats, variance: Floats, rest: Floats) -> Floats:
    """ln [ρ N(v; 0, S) + (1 - ρ) N(v; μ, S + q)], all broadcast: the density of an innovation v."""
    moving = quiet + variance
    log_rest = np.log(rest) - 0.5 * (np.log(2 * np.pi * quiet) + innovation**2 / quiet)
    log_go = np.log1p(-rest) - 0.5 * (np.log(2 * np.pi * moving) + (innovation - mean) ** 2 / moving)
    return np.logaddexp(log_rest, log_go)


def _fit_one(one: JointView, action: Floats | None, inlier: Bools, forgetting: Floats, rest: float) -> _Model:
    rows = np.arange(one.hypothesis.start, one.hypothesis.end + 1)
    rows = rows[inlier[rows]]
    if len(rows) < 2:
        return _Model(_TINY, 0.0, _TINY, rest, np.zeros(3), 2.0, -np.inf)
    c = one.configuration[rows]
    renewed = one.wander_variance * np.diff(np.cumsum(forgetting)[rows])
    mean_square = max(float(np.mean(np.diff(c) ** 2)), one.white_variance * 1e-3, _TINY)
    grid = mean_square * _STEP_SHARES
    signals = np.column_stack([c, rows - rows[0]])
    if action is not None:
        # What the actions commanded between the rows used: their running sum, as a signal that is filtered alike.
        commanded = np.concatenate([np.zeros((1, 3)), np.cumsum(action, axis=0)])[rows]
        signals = np.column_stack([signals, commanded - commanded[0]])
    innovations, quiet = _innovations(signals, one.white_variance, renewed, grid)
    free = _freely_moving(innovations[..., 0], innovations[..., 1], quiet, grid, rest)
    if action is None or len(rows) < _FEWEST_ROWS:
        return free
    # The action as it is defined, with a gain; or, where that explains less, in any frame.
    along = _led(innovations, quiet, grid, one.leverage[:, None])
    turned = _led(innovations, quiet, grid, np.eye(3))
    # In another frame an action says as much as in the right one, not more. Unbounded, h finds that one push moved the
    # part and another, in much the same direction, did not: a stop would be no evidence of anything any more.
    reach = _MOST_AMPLIFIED * max(float(np.linalg.norm(one.leverage)), float(np.linalg.norm(along.gain)))
    plausible = [free, along, turned] if float(np.linalg.norm(turned.gain)) <= reach else [free, along]
    return max(plausible, key=lambda m: m.log_likelihood - 0.5 * m.parameters * np.log(len(rows)))


def _freely_moving(innovation: Floats, ramp: Floats, quiet: Floats, grid: Floats, rest: float) -> _Model:
    """(μ, q) by expectation maximisation for every E[w²] of the grid; the best of them.

    The filter drifts by its expected step (1 - ρ) μ. Its innovations are those without drift, less the drift times the
    innovations of a ramp, so that under noise a stop shows in the rows that follow.
    """
    expected = 1 - rest
    resting = expected * (ramp - 1)
    going = resting + 1
    mean = np.median(innovation, axis=0)
    variance = grid.copy()
    for _ in range(_EXPECTATION_STEPS):
        moving = quiet + variance
        log_go = np.log1p(-rest) - 0.5 * (np.log(moving) + (innovation - mean * going) ** 2 / moving)
        log_rest = np.log(rest) - 0.5 * (np.log(quiet) + (innovation - mean * resting) ** 2 / quiet)
        share = np.exp(log_go - np.logaddexp(log_go, log_rest))
        weight_go, weight_rest = share / moving, (1 - share) / quiet
        pull = (weight_go * going * innovation + weight_rest * resting * innovation).sum(axis=0)
        mean = pull / np.maximum((weight_go * going**2 + weight_rest * resting**2).sum(axis=0), 1e-300)
        missed = share * ((innovation - mean * going) ** 2 - quiet)
        variance = np.maximum(missed.sum(axis=0) / np.maximum(share.sum(axis=0), 1e-9), 0.01 * grid)
    density = log_step_density(innovation - mean * resting, quiet, mean, variance, np.array(rest)).sum(axis=0)
    i = int(np.argmax(density))
    return _Model(float(grid[i]), float(mean[i]), float(variance[i]), rest, np.zeros(3), 2.0, float(density[i]))


def _led(innovations: Floats, quiet: Floats, grid: Floats, basis: Floats) -> _Model:
    """h in the span of a basis (3, k) for every E[w²] of the grid, and the ρ that goes with it best."""
    gains = np.array([_gain(innovations[:, i], quiet[:, i] + grid[i], basis) for i in range(len(grid))])
    left = innovations[..., 0] - np.einsum("tgk,gk->tg", innovations[..., 2:], gains)
    variance = grid[:, None] / (1 - _EXPLAINED_SHARES)
    density = log_step_density(left[..., None], quiet[..., None], np.zeros(1), variance, _EXPLAINED_SHARES).sum(axis=0)
    i, j = (int(v) for v in np.unravel_index(int(np.argmax(density)), density.shape))
    best = float(density[i, j])
    return _Model(
        float(grid[i]), 0.0, float(variance[i, j]), float(_EXPLAINED_SHARES[j]), gains[i], 2.0 + basis.shape[1], best
    )


def _innovations(signals: Floats, white: float, renewed: Floats, grid: Floats) -> tuple[Floats, Floats]:
    """Innovations (n-1, g, k) of signals (n, k) and their variances without a step (n-1, g), for each E[w²] of (g,)."""
    n = len(signals)
    innovations = np.zeros((n - 1, len(grid), signals.shape[1]))
    variances = np.zeros((n - 1, len(grid)))
    state = np.tile(signals[0], (len(grid), 1))
    spread = np.full(len(grid), white)
    for t in range(1, n):
        quiet = spread + renewed[t - 1] + white
        spread, variance = spread + renewed[t - 1] + grid, quiet + grid
        innovation = signals[t] - state
        trust = spread / variance
        state = state + trust[:, None] * innovation
        spread = spread * (1 - trust)
        innovations[t - 1], variances[t - 1] = innovation, quiet
    return innovations, variances


def _gain(innovations: Floats, variance: Floats, basis: Floats) -> Floats:
    """h (3,) by weighted least squares of the configuration's innovations on those of the commanded signals."""
    commanded = innovations[:, 2:] @ basis / np.sqrt(variance)[:, None]
    measured = innovations[:, 0] / np.sqrt(variance)
    normal = commanded.T @ commanded
    return np.asarray(basis @ np.linalg.pinv(normal, rcond=1e-8, hermitian=True) @ (commanded.T @ measured))
