"""Estimation of the action channel: frame, gain and delay of recorded actions along a joint.

The model is c' = c + g J⁻¹(c) R a(t - delay) + w, measured with white noise (MICAH, equation for the predicted pose,
with the action seen through a channel). Time is a share of the run, and w is a random walk in time, so neither the
sampling rate nor the unit of time matters. A first-order servo carries out each action gradually: then a is the
filtered action, and the reported delay includes the mean of its lag.

Commanded places are in the frame of the poses, and the command of a row is the displacement from its place to the next
one.

Priors: see channel_search for R and g; delay ~ N(0, 0.08²) of the run's duration. Actions before the first and after
the last row are unknown: steps that they would govern are modelled as free motion. Noise in the actions themselves,
beyond the random walk, makes the gain too small, as in every regression. A gain that varies along the motion is not in
the model: where all actions point along the joint, it is mistaken for a rotated frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from micah_plan.arrays import VANISHING, Booleans, Floats
from micah_plan.automaton.certainty import ActionChannel
from micah_plan.automaton.joint import Joint
from micah_plan.learning.actions.anchored_actions import with_anchored_actions
from micah_plan.learning.actions.channel_search import Posterior, Quadratic, climb, integrate, scan
from micah_plan.learning.actions.command_path import CommandPath, command_of, commanded_places
from micah_plan.learning.actions.configuration_steps import (
    INEXACT,
    ConfigurationSteps,
    StepNoise,
    configuration_steps,
    fit_noise,
    inexact,
    step_noise_of,
)
from micah_plan.learning.joints.quaternions import conjugate, rotation_matrix, rotation_vector, times
from micah_plan.learning.track import PartTrack
from micah_plan.recording.commands import Meaning

DELAY_STD = 0.08  # of the run's duration
LEAST_LOG_ODDS = 5.0  # of the channel against none, 150 : 1
_COARSE_STEPS = 128  # per run
_COARSE_DELAYS = np.arange(-22, 23) / 96  # of the run, tried first
_NEAR_ROWS = 8  # on each side of no delay, tried first as well
_SPREAD = 0.75  # rows, std, that actions are smoothed by: errors average out at all delays alike
_FIRST_LAGS = (0.5, 1.0, 2.0, 4.0, 8.0)  # rows, time constants of servos
_NEARER = (1.4, 1.2, 1.1, 1.05, 1.025)  # times the best so far
# Rows around the best delay of places so far: a delay compensates for a lag.
_AROUND = (0.5, 0.25, 0.12, 0.06, 0.03)
_BESIDE = np.linspace(-1.0, 1.0, 5)
_WITHIN_A_ROW = 0.1  # rows: how a command acts from one row to the next is in no log
_LAG_ODDS = 5.0  # nats by which a lag must be ahead to be considered: it has its own parameter, and an initial state
_RIDGE = 1e-9  # of the trace: maps of actions that these steps do not determine are ignored
_LEFT_BY_LAGS = np.arange(-8.0, 2.5, 0.5)  # rows around the delay without a lag
_AVERAGED = 0.5 * np.log(2.0)  # nats per step: what averaging the errors of two neighbours can explain
_WALK_SHARES = (0.3, 0.01)  # of the mean square of a step, from which the walk is sought
_WALKS = 0.25 ** np.arange(9.0)  # shares of a walk that are tried
_NEGLIGIBLE_WALK = -4.0  # ln probability
_FINE_DELAYS = 13  # tried around the best
_MOST_ROUNDS = 6  # of delays, each closer around the best
_WIDEST = 0.25  # half-width of the delays integrated over, as a share of the run
_MOST_UNKNOWN = 0.04  # share of the run beyond the delay where actions count as unknown at most
_FEWEST_STEPS = 10  # to identify a channel
_FEWEST_DRAWS = 8.0  # effective ones; with fewer there is no estimate
_NUMBERS = 5  # rotation, gain, delay
_BLOCKS = 64  # per run, to which `explained` refers

_Start = tuple[CommandPath, float, Floats, float]
"""Command, delay, rotation and ln gain to begin with."""


@dataclass(frozen=True, eq=False)
class _Mode:
    """A posterior mode of the channel with its neighbourhood.

    Attributes:
        delay, rotation, log_gain: the point; the delay is a share of the run, the rotation a quaternion (4,).
        information: (4, 4) of (e, ln g) there.
        delays: (d,) grid around it.
        log_weight: (d,) ln posterior of these by Laplace's method.
        turns: (d, 3) modes of e from the point, per delay.
    """

    delay: float
    rotation: Floats
    log_gain: float
    information: Floats
    delays: Floats
    log_weight: Floats
    turns: Floats


def estimate_channel(
    joint: Joint,
    pieces: Sequence[tuple[int, int]],
    track: PartTrack,
    white_std: float,
    inlier: Booleans | None = None,
    least_log_odds: float = LEAST_LOG_ODDS,
) -> ActionChannel | None:
    """The channel from a run's actions to its motion along a joint.

    Args:
        joint: fitted; prismatic, revolute or screw.
        pieces: first and last row (inclusive, counted within the track) of the stretches that the joint governs.
        track: of the run, with actions.
        white_std: assumed std of one measured configuration [rad or m]; refined from the rows.
        inlier: (n,) rows of the track that count; None: all.
        least_log_odds: least evidence of the channel over no channel [nats].

    Returns:
        The most probable channel. The rotational part of its covariance is that of a small turn e in the base frame,
        exp(e) R(frame_rotation); the gain's is that of ln g, times g². All are second moments of the posterior about
        the estimate. None if there are no actions, fewer than 10 steps, no motion, or if the evidence, integrated over
        rotations, gains and delays, does not speak for a channel, or leaves its gain open.
    """
    if track.action is None or not joint.moves:
        return None
    counted = np.ones(len(track), dtype=bool) if inlier is None else inlier
    command = commanded_places(joint, track) or command_of(with_anchored_actions(joint, pieces, track, counted))
    if command is None:
        return None
    white = max(white_std, 1e-9) ** 2
    steps = configuration_steps(joint, pieces, track, counted, white, None)
    if len(steps) < _FEWEST_STEPS or not np.any(steps.leverage) or not np.any(steps.size):
        return None
    still = fit_noise(steps, steps.size, inexact(steps))
    searches = _searches(joint, pieces, track, counted, steps)
    command, delay, rotation, log_gain = _initial_channels(steps, command, still.walk, searches)
    mode, noises, extra = _refined_mode(steps, command, still.walk, delay, rotation, log_gain)
    posterior = _marginalised(steps, command, noises, mode, still.walk)
    score = posterior.log_evidence - np.log(2 + len(_FIRST_LAGS)) - fit_noise(steps, steps.size, extra).log_density
    if score <= least_log_odds:
        return None
    channel = _reported(mode, posterior, track, command, _explained(steps, command, mode, noises[0][0]))
    # A gain that may as well be none is no estimate.
    return channel if channel.covariance[3][3] < channel.gain**2 else None


def _quadratic(steps: ConfigurationSteps, predictors: Floats, noise: StepNoise, frame_std: float) -> Quadratic:
    """Likelihood for predictors (d, 9, m) of d delays."""
    solved = noise.solve(predictors.reshape(-1, len(steps))).reshape(predictors.shape)
    return Quadratic(np.matmul(predictors, solved.transpose(0, 2, 1)), np.matmul(solved, steps.size), frame_std)


def _searches(
    joint: Joint, pieces: Sequence[tuple[int, int]], track: PartTrack, counted: Booleans, steps: ConfigurationSteps
) -> list[tuple[ConfigurationSteps, Floats]]:
    """(steps, delays) to search a channel with, for a motion that is slow relative to a row, and for one that is not.

    Of few rows these are the same.
    """
    if len(steps) <= 1.5 * _COARSE_STEPS:
        return [(steps, _COARSE_DELAYS)]
    thinned = configuration_steps(joint, pieces, track, counted, steps.white, _COARSE_STEPS)
    row = np.median(steps.end - steps.start)
    near = (steps, row * np.arange(-_NEAR_ROWS, _NEAR_ROWS + 1.0))
    return [(thinned if len(thinned) >= _FEWEST_STEPS else steps, _COARSE_DELAYS), near]


def _initial_channels(
    steps: ConfigurationSteps, command: CommandPath, walk: float, searches: list[tuple[ConfigurationSteps, Floats]]
) -> _Start:
    """Initial channels, and the command up to where the part follows it.

    Actions jitter. If the part follows the jitter, it determines the delay exactly; if it is an error of the log, a
    delay fits it by chance, and halfway between two rows, where neighbours average, every delay seems to explain more.
    So the command is smoothed as explains the steps best, and not smoothed at all only if that explains still more. A
    servo reaches its place gradually: that is a delay too, but without the lag an arc along which it lags would be
    mistaken for another frame.
    """

    def found(filtered: CommandPath, subset: ConfigurationSteps, delays: Floats) -> tuple[float, _Start]:
        start = _searched(subset, filtered, walk, delays)
        residual = steps.size - _predicted(steps, filtered, *start)
        return fit_noise(steps, residual, inexact(steps)).log_density, (filtered, *start)

    tried = []
    for subset, delays in searches:
        score, start = found(command, subset, delays)
        tried += [(score - _AVERAGED * len(steps), start), found(command.smoothed(_SPREAD), subset, delays)]
    # A log begins in the middle of a motion, or at rest.
    begun = [command, replace(command, before=np.zeros_like(command.before))]
    # What is not laid to the lag is a delay that is shorter than without one.
    delays = max(tried, key=_score)[1][1] + command.row * _LEFT_BY_LAGS
    if command.is_of_places or _may_lag(steps, begun, delays[::2], walk):
        score, start = max(
            (found(each.lagging(lag), steps, delays) for each in begun for lag in _FIRST_LAGS), key=_score
        )
        for further, around in zip(_NEARER, _AROUND, strict=True):
            lag, before = start[0].lag / command.row, replace(command, before=start[0].before)
            lags, closer = [lag * further, lag / further], delays
            if command.is_of_places:  # displacements do not determine by which part of a row they are late
                lags, closer = [*lags, lag], start[1] + command.row * around * _BESIDE
            nearer = [found(before.lagging(rows), steps, closer) for rows in lags]
            score, start = max((score, start), *nearer, key=_score)
        tried.append((score - _AVERAGED * len(steps), start))
    return max(tried, key=_score)[1]


def _score(tried: tuple[float, _Start]) -> float:
    return tried[0]


def _may_lag(steps: ConfigurationSteps, begun: Sequence[CommandPath], delays: Floats, walk: float) -> bool:
    """Whether a first-order lag of the commands explains the steps clearly better than the first of `begun`.

    All linear maps of actions are allowed, not only turns with a gain, so that no rotations need be searched.
    """
    noise = step_noise_of(steps, steps.size, inexact(steps), _WALK_SHARES[-1] * walk, steps.white)

    def explained(filtered: CommandPath) -> float:
        """Log density of the steps with the best linear map, above that with none [nats]."""
        quadratic = _quadratic(steps, steps.predictors(filtered, delays), noise, filtered.frame_std)
        ridge = np.eye(9) * (_RIDGE * np.trace(quadratic.normal, axis1=1, axis2=2)[:, None, None] + VANISHING)
        best = np.linalg.solve(quadratic.normal + ridge, quadratic.target[:, :, None])[:, :, 0]
        return float(0.5 * np.einsum("di,di->d", best, quadratic.target).max())

    return max(explained(each.lagging(lag)) for each in begun for lag in _FIRST_LAGS) > explained(begun[0]) + _LAG_ODDS


def _searched(
    steps: ConfigurationSteps, command: CommandPath, walk: float, tried: Floats
) -> tuple[float, Floats, float]:
    """Initial channels (delay, rotation, ln gain) from a grid over delays and all rotations."""
    log_prior = -0.5 * (tried / DELAY_STD) ** 2
    predictors = steps.predictors(command, tried)
    normals, targets, rotations, gains, delays, densities = [], [], [], [], [], []
    for share in _WALK_SHARES:
        noise = step_noise_of(steps, steps.size, inexact(steps), share * walk, steps.white)
        quadratic = _quadratic(steps, predictors, noise, command.frame_std)
        index, rotation, log_gain = scan(quadratic, log_prior)
        normals.append(quadratic.normal[index])
        targets.append(quadratic.target[index])
        rotations.append(rotation)
        gains.append(log_gain)
        delays.append(tried[index])
        densities.append(noise.log_density + log_prior[index])
    starts = Quadratic(np.concatenate(normals), np.concatenate(targets), command.frame_std)
    channels, _ = climb(starts, np.concatenate(rotations), np.concatenate(gains))
    best = int(np.argmax(channels.score + np.concatenate(densities)))
    return float(np.concatenate(delays)[best]), channels.rotation[best], float(channels.log_gain[best])


def _refined_mode(
    steps: ConfigurationSteps, command: CommandPath, walk: float, delay: float, rotation: Floats, log_gain: float
) -> tuple[_Mode, list[tuple[StepNoise, float]], Floats]:
    """The refined mode with a grid of delays as wide as their posterior, the noise, and the variance of unknown
    actions.
    """
    width, center = 2.0 / _COARSE_STEPS, delay
    for number in range(_MOST_ROUNDS):
        extra = _unexplained_variance(steps, delay, min(width, _MOST_UNKNOWN), walk)
        residual = steps.size - _predicted(steps, command, delay, rotation, log_gain)
        white = fit_noise(steps, residual, extra).white
        noises = _noises(steps, command, white, extra, walk, (delay, rotation, log_gain), number > 0)
        noise = max(noises, key=lambda pair: pair[1])[0]
        mode = _optimised_over_delays(
            steps, command, noise, center + width * np.linspace(-1, 1, _FINE_DELAYS), rotation, log_gain
        )
        delay, rotation, log_gain = mode.delay, mode.rotation, mode.log_gain
        weight = np.exp(mode.log_weight)
        spacing = 2 * width / (_FINE_DELAYS - 1)
        std = float(np.sqrt(weight @ (mode.delays - delay) ** 2))
        if number == _MOST_ROUNDS - 1:
            break
        if max(weight[0], weight[-1]) > 0.02 and width < _WIDEST:
            center, width = float(mode.delays[np.argmax(weight)]), min(2.5 * width, _WIDEST)
        elif std < 1.2 * spacing and width > 1e-5:
            center, width = delay, max(3.5 * std, 0.8 * spacing)
        elif number > 0:
            break
    return mode, noises, extra


def _noises(
    steps: ConfigurationSteps,
    command: CommandPath,
    white: float,
    extra: Floats,
    walk: float,
    at: tuple[float, Floats, float],
    closely: bool,
) -> list[tuple[StepNoise, float]]:
    """Relevant random walks with their log posterior.

    The channel absorbs much of a slow random walk, so that the walk that fits best with the best channel is too small,
    often 0; with the channel integrated out, and a flat prior of its std (Gelman, Bayesian Analysis 2006), it is not.
    """
    noises, density = _noise_posterior(steps, command, white, extra, walk * _WALKS, at)
    i = int(np.argmax(density))
    if closely and 0 < i < len(_WALKS) - 1:
        slope, bend = 0.5 * (density[i + 1] - density[i - 1]), density[i - 1] + density[i + 1] - 2 * density[i]
        if bend < -0.5:  # known to a factor: look closer
            ratio = -np.log(_WALKS[1])
            std, middle = ratio / np.sqrt(-bend), np.log(noises[i].walk) + ratio * slope / bend
            walks = np.exp(middle + 0.9 * std * np.arange(-2.0, 3.0))
            noises, density = _noise_posterior(steps, command, white, extra, walks, at)
    density -= np.logaddexp.reduce(density)
    return [(noise, float(p)) for noise, p in zip(noises, density, strict=True) if p > _NEGLIGIBLE_WALK]


def _noise_posterior(
    steps: ConfigurationSteps,
    command: CommandPath,
    white: float,
    extra: Floats,
    walks: Floats,
    at: tuple[float, Floats, float],
) -> tuple[list[StepNoise], Floats]:
    """Noises of given random walks (w,) with their log posterior; the channel is marginalised by Laplace's method."""
    delay, rotation, log_gain = at
    noises = [step_noise_of(steps, steps.size, extra, float(walk), white) for walk in walks]
    predictors = steps.predictors(command, np.array([delay]))[0]
    solved = np.stack([noise.solve(predictors) for noise in noises])
    every = Quadratic(np.matmul(solved, predictors.T), np.matmul(solved, steps.size), command.frame_std)
    channels, information = climb(every, np.tile(rotation, (len(noises), 1)), np.full(len(noises), log_gain), 5)
    density = np.array([noise.log_density for noise in noises]) + 0.5 * np.log(walks)
    return noises, density + channels.score - 0.5 * np.linalg.slogdet(information)[1]


def _optimised_over_delays(
    steps: ConfigurationSteps, command: CommandPath, noise: StepNoise, delays: Floats, rotation: Floats, log_gain: float
) -> _Mode:
    """The mode optimised over a grid of delays from one rotation and gain."""
    d = len(delays)
    quadratic = _quadratic(steps, steps.predictors(command, delays), noise, command.frame_std)
    channels, information = climb(quadratic, np.tile(rotation, (d, 1)), np.full(d, log_gain))
    score = channels.score - 0.5 * (delays / DELAY_STD) ** 2 - 0.5 * np.linalg.slogdet(information)[1]
    log_weight = score - np.logaddexp.reduce(score)
    weight = np.exp(log_weight)
    delay = float(weight @ delays)
    near = int(np.argmin(np.abs(delays - delay) - 1e-3 * weight))
    at = _quadratic(steps, steps.predictors(command, np.array([delay])), noise, command.frame_std)
    best, there = climb(at, channels.rotation[near : near + 1], channels.log_gain[near : near + 1], 4)
    turns = rotation_vector(times(channels.rotation, conjugate(best.rotation)))
    return _Mode(delay, best.rotation[0], float(best.log_gain[0]), there[0], delays, log_weight, turns)


def _marginalised(
    steps: ConfigurationSteps, command: CommandPath, noises: list[tuple[StepNoise, float]], mode: _Mode, none: float
) -> Posterior:
    """The posterior marginalised over rotations, gains, delays and random walks."""
    delays = mode.delays[::2]
    spacing = delays[1] - delays[0]
    log_prior = -0.5 * (delays / DELAY_STD) ** 2 + np.log(spacing / (DELAY_STD * np.sqrt(2 * np.pi)))
    predictors = steps.predictors(command, delays)
    quadratics = [_quadratic(steps, predictors, noise, command.frame_std) for noise, _ in noises]
    walks = np.array([noise.walk for noise, _ in noises])
    log_walk = 0.5 * np.log(walks) + np.log(_spacings(walks)) - np.log(2 * np.sqrt(none))
    density = np.array([noise.log_density for noise, _ in noises]) + log_walk
    likely = int(np.argmax([p for _, p in noises]))
    weight = np.exp(mode.log_weight)
    covariance = np.linalg.inv(mode.information)[:3, :3] + (mode.turns * weight[:, None]).T @ mode.turns
    every = Quadratic(
        np.concatenate([quadratic.normal for quadratic in quadratics]),
        np.concatenate([quadratic.target for quadratic in quadratics]),
        command.frame_std,
    )
    log_weight = (density[:, None] + log_prior).ravel()
    return integrate(every, log_weight, mode.rotation, mode.log_gain, covariance, len(noises), likely)


def _reported(
    mode: _Mode, posterior: Posterior, track: PartTrack, command: CommandPath, explained: float
) -> ActionChannel:
    covariance = np.zeros((_NUMBERS, _NUMBERS))
    weight, square = posterior.delays, posterior.square
    offset = mode.delays[::2] - mode.delay
    cross = (weight * offset) @ posterior.mean
    if posterior.effective < _FEWEST_DRAWS:
        covariance[:4, :4] = np.linalg.inv(mode.information)
    else:
        covariance[:4, :4] = square
        covariance[:4, 4] = covariance[4, :4] = cross
    covariance[4, 4] = weight @ offset**2 + (_WITHIN_A_ROW / len(track)) ** 2
    if command.is_of_places:  # the same after each of them, so that no number of rows makes up for it
        covariance[3, 3] += (INEXACT + 1.0 - explained) ** 2
    gain = float(np.exp(mode.log_gain))
    units = np.array([1.0, 1.0, 1.0, gain, track.duration])
    covariance *= np.outer(units, units)
    x, y, z = (float(v) for v in rotation_vector(mode.rotation))
    rows = tuple(tuple(float(v) for v in row) for row in covariance)
    commands: Meaning = "position" if command.is_of_places else "displacement"
    return ActionChannel((x, y, z), gain, (mode.delay + command.lag) * track.duration, rows, explained, commands)


def _spacings(walks: Floats) -> Floats:
    """(w,) quadrature weights of evenly spaced walks on the log axis."""
    return np.full(len(walks), abs(np.log(walks[1] / walks[0])) if len(walks) > 1 else 1.0)


def _predicted(
    steps: ConfigurationSteps, command: CommandPath, delay: float, rotation: Floats, log_gain: float
) -> Floats:
    """(k,) predicted steps [rad or m]."""
    m = np.exp(log_gain) * rotation_matrix(rotation).ravel()
    return np.asarray(m @ steps.predictors(command, np.array([delay]))[0])


def _unexplained_variance(steps: ConfigurationSteps, delay: float, width: float, walk: float) -> Floats:
    """(m,) variance of steps that are inexact, or whose actions lie outside the recording at some delay."""
    outside = (steps.start < max(delay + width, 0.0)) | (steps.end > 1.0 + min(delay - width, 0.0))
    return inexact(steps) + np.where(outside, walk * (steps.end - steps.start), 0.0)


def _explained(steps: ConfigurationSteps, command: CommandPath, mode: _Mode, noise: StepNoise) -> float:
    """Fraction of the mean squared step, across folds, that the channel predicts, without measurement noise."""
    predicted = _predicted(steps, command, mode.delay, mode.rotation, mode.log_gain)
    block = np.minimum((0.5 * (steps.start + steps.end) * _BLOCKS).astype(np.int64), _BLOCKS - 1)
    moved = np.bincount(block, steps.size, _BLOCKS)
    missed = np.bincount(block, steps.size - predicted, _BLOCKS)
    by_noise = 2 * noise.white * len(np.unique(block))
    motion = float(moved @ moved) - by_noise
    if motion <= 0:
        return 0.0
    return float(np.clip(1.0 - max(float(missed @ missed) - by_noise, 0.0) / motion, 0.0, 1.0))
