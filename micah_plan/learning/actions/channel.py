"""Estimating the action channel: in which frame, how strongly and how late recorded actions move a joint.

The model is c' = c + g J⁻¹(c) R a(t - delay) + w, measured with white noise (MICAH, equation for the predicted pose,
with the action seen through a channel). Time counts in shares of the run, and w is a random walk in time, so neither
the sampling rate nor the unit of time matters.

Priors: see channel_search for R and g; delay ~ N(0, 0.08²) of the run's duration. Actions before the first and after
the last row are unknown: steps that they would govern count as moving freely. Noise in the actions themselves, other
than what the random walk takes up, makes the gain too small, as in every regression. A gain that varies along
the motion is not in the model: where all actions point along the joint, it passes for a turned frame.

**The linear part.** The steps of a joint's configuration and what was commanded for them: the linear part of the action
channel.

A step between two measured rows is c' - c = g J⁻¹(c) R ΔA + w + v' - v, with ΔA the command given meanwhile, w a random
walk and v the white noise of a row. So the steps of a piece have a tridiagonal covariance (the innovations form of a
scalar Kalman filter), and the model is linear in the nine numbers of g R.

**Relative actions.** Actions that were given relative to a measured pose, turned to where the part really was.

A controller that steps on from what it measures points its command along the motion at the *measured* configuration,
which differs from the true one by the tracker's noise. The noise of a measured step is then known from the direction
of its action, to a channel with a strong gain across the motion: such a channel explains noise, not motion. So what of
the directions follows the rows' own errors is taken out, by regression (Frisch and Waugh, Econometrica 1933).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from micah_plan.arrays import VANISHING, Booleans, Floats
from micah_plan.automaton.graph import ActionChannel
from micah_plan.automaton.joint import Joint, axis_basis
from micah_plan.automaton.kinematics import inverse, jacobian
from micah_plan.learning.actions.channel_search import Posterior, Quadratic, climb, integrate, scan
from micah_plan.learning.joints.joint_arrays import conjugate, rotation_matrix, rotation_vector, times
from micah_plan.learning.track import PartTrack

DELAY_STD = 0.08  # of the run's duration
LEAST_LOG_ODDS = 5.0  # of the channel against none, 150 : 1
_COARSE_STEPS = 128  # per run
_COARSE_DELAYS = np.arange(-22, 23) / 96  # of the run, tried first
_NEAR_ROWS = 8  # on each side of no delay, tried first as well
_SPREADS = (0.0, 0.75)  # rows, std, that actions are smoothed by; with 0.75 errors average out at all delays alike
_AVERAGED = 0.5 * np.log(2.0)  # nats per step: what averaging the errors of two neighbours can explain
_WALK_SHARES = (0.3, 0.01)  # of the mean square of a step, from which the walk is sought
_WALKS = 0.25 ** np.arange(9.0)  # shares of a walk that are tried
_NEGLIGIBLE_WALK = -4.0  # ln probability
_FINE_DELAYS = 13  # tried around the best
_MOST_ROUNDS = 6  # of delays, each closer around the best
_WIDEST = 0.25  # half-width of the delays integrated over, as a share of the run
_MOST_UNKNOWN = 0.04  # share of the run beyond the delay where actions count as unknown at most
_FEWEST_STEPS = 10  # to tell a channel
_FEWEST_DRAWS = 8.0  # effective ones; with fewer nothing is said
_NUMBERS = 5  # rotation, gain, delay
_BLOCKS = 64  # per run, to which `explained` refers


@dataclass(frozen=True, eq=False)
class _Mode:
    """A point of the posterior and what lies around it.

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
    """How the actions of a run move a part along its joint.

    Args:
        joint: fitted; prismatic, revolute or screw.
        pieces: first and last row (inclusive, counted within the track) of the stretches that the joint governs.
        track: of the run, with actions.
        white_std: believed std of one measured configuration [rad or m]; estimated further from the rows.
        inlier: (n,) rows of the track that count; None: all.
        least_log_odds: what the evidence of the channel must exceed that of no channel by [nats].

    Returns:
        The most probable channel. The rotational part of its covariance is that of a small turn e in the base frame,
        exp(e) R(frame_rotation); the gain's is that of ln g, times g². All are second moments of the posterior about
        the estimate. None if there are no actions, fewer than 10 steps, no motion, or if the evidence, integrated over
        rotations, gains and delays, does not speak for a channel, or leaves its gain open.
    """
    if track.action is None or not joint.moves:
        return None
    counted = np.ones(len(track), dtype=bool) if inlier is None else inlier
    command = command_of(with_anchored_actions(joint, pieces, track, counted))
    if command is None:
        return None
    white = max(white_std, 1e-9) ** 2
    steps = configuration_steps(joint, pieces, track, counted, white, None)
    if len(steps) < _FEWEST_STEPS or not np.any(steps.leverage) or not np.any(steps.size):
        return None
    still = fit_noise(steps, steps.size, np.zeros(len(steps)))
    searches = _searches(joint, pieces, track, counted, steps)
    command, delay, rotation, log_gain = _started(steps, command, still.walk, searches)
    mode, noises, extra = _settled(steps, command, still.walk, delay, rotation, log_gain)
    posterior = _integrated(steps, command, noises, mode, still.walk)
    score = posterior.log_evidence - np.log(len(_SPREADS)) - fit_noise(steps, steps.size, extra).log_density
    if score <= least_log_odds:
        return None
    channel = _reported(mode, posterior, track, _explained(steps, command, mode, noises[0][0]))
    # A gain that may as well be none is no estimate.
    return channel if channel.covariance[3][3] < channel.gain**2 else None


def with_delayed_actions(track: PartTrack, delay: float) -> PartTrack:
    """The track with its actions `delay` [s] later: each row's action is what moves the part from it to the next.

    Nothing is commanded before the first and after the last row.
    """
    command = command_of(track)
    if command is None or delay == 0:
        return track
    path = replace(command, before=np.zeros(3), after=np.zeros(3)).at(command.time - delay / track.duration)
    action = np.concatenate([np.diff(path, axis=0), np.zeros((1, 3))])
    if track.quaternion is not None:
        action = Rotation.from_quat(track.quaternion).inv().apply(action)
    return replace(track, action=action)


def _quadratic(steps: ConfigurationSteps, predictors: Floats, noise: StepNoise) -> Quadratic:
    """Likelihood for predictors (d, 9, m) of d delays."""
    solved = noise.solve(predictors.reshape(-1, len(steps))).reshape(predictors.shape)
    return Quadratic(np.matmul(predictors, solved.transpose(0, 2, 1)), np.matmul(solved, steps.size))


def _searches(
    joint: Joint, pieces: Sequence[tuple[int, int]], track: PartTrack, counted: Booleans, steps: ConfigurationSteps
) -> list[tuple[ConfigurationSteps, Floats]]:
    """Steps and delays to look for a channel at: for a motion that is slow compared to a row, and for one that is not.

    Of few rows these are the same.
    """
    if len(steps) <= 1.5 * _COARSE_STEPS:
        return [(steps, _COARSE_DELAYS)]
    thinned = configuration_steps(joint, pieces, track, counted, steps.white, _COARSE_STEPS)
    row = np.median(steps.end - steps.start)
    near = (steps, row * np.arange(-_NEAR_ROWS, _NEAR_ROWS + 1.0))
    return [(thinned if len(thinned) >= _FEWEST_STEPS else steps, _COARSE_DELAYS), near]


def _started(
    steps: ConfigurationSteps, command: CommandPath, walk: float, searches: list[tuple[ConfigurationSteps, Floats]]
) -> tuple[CommandPath, float, Floats, float]:
    """Where to start, and the command as far as the part follows it.

    Actions jitter. If the part follows that, it tells the delay exactly; if it is an error of the log, a delay that
    fits it fits by chance, and halfway between two rows, where neighbours average, every delay seems to explain more.
    So the command is as smooth as explains the steps best, and not smoothed at all only if that explains still more.
    """
    maxima, scores = [], []
    for spread in _SPREADS:
        filtered = command.smoothed(spread) if spread else command
        for subset, delays in searches:
            start = _searched(subset, filtered, walk, delays)
            residual = steps.size - _predicted(steps, filtered, *start)
            maxima.append((filtered, *start))
            scores.append(fit_noise(steps, residual, np.zeros(len(steps))).log_density)
            if not spread:
                scores[-1] -= _AVERAGED * len(steps)
    return maxima[int(np.argmax(scores))]


def _searched(
    steps: ConfigurationSteps, command: CommandPath, walk: float, tried: Floats
) -> tuple[float, Floats, float]:
    """Where to start: delay, rotation and ln gain, from a grid over some delays and all rotations."""
    log_prior = -0.5 * (tried / DELAY_STD) ** 2
    predictors = steps.predictors(command, tried)
    normals, targets, rotations, gains, delays, densities = [], [], [], [], [], []
    for share in _WALK_SHARES:
        noise = step_noise_of(steps, steps.size, np.zeros(len(steps)), share * walk, steps.white)
        quadratic = _quadratic(steps, predictors, noise)
        index, rotation, log_gain = scan(quadratic, log_prior)
        normals.append(quadratic.normal[index])
        targets.append(quadratic.target[index])
        rotations.append(rotation)
        gains.append(log_gain)
        delays.append(tried[index])
        densities.append(noise.log_density + log_prior[index])
    starts = Quadratic(np.concatenate(normals), np.concatenate(targets))
    channels, _ = climb(starts, np.concatenate(rotations), np.concatenate(gains))
    best = int(np.argmax(channels.score + np.concatenate(densities)))
    return float(np.concatenate(delays)[best]), channels.rotation[best], float(channels.log_gain[best])


def _settled(
    steps: ConfigurationSteps, command: CommandPath, walk: float, delay: float, rotation: Floats, log_gain: float
) -> tuple[_Mode, list[tuple[StepNoise, float]], Floats]:
    """The mode with a grid of delays as wide as their posterior, the noise there, the variance of unknown actions."""
    width, center = 2.0 / _COARSE_STEPS, delay
    for number in range(_MOST_ROUNDS):
        extra = _unknown(steps, delay, min(width, _MOST_UNKNOWN), walk)
        residual = steps.size - _predicted(steps, command, delay, rotation, log_gain)
        white = fit_noise(steps, residual, extra).white
        noises = _noises(steps, command, white, extra, walk, (delay, rotation, log_gain), number > 0)
        noise = max(noises, key=lambda pair: pair[1])[0]
        mode = _explored(steps, command, noise, center + width * np.linspace(-1, 1, _FINE_DELAYS), rotation, log_gain)
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
    """Random walks that matter, with their ln posterior.

    The channel takes up much of what a slow random walk does, so that the walk that fits best with the best channel is
    too small, often 0; with the channel integrated out, and a flat prior of its std (Gelman, Bayesian Analysis 2006),
    it is not.
    """
    noises, density = _weighed(steps, command, white, extra, walk * _WALKS, at)
    i = int(np.argmax(density))
    if closely and 0 < i < len(_WALKS) - 1:
        slope, bend = 0.5 * (density[i + 1] - density[i - 1]), density[i - 1] + density[i + 1] - 2 * density[i]
        if bend < -0.5:  # known to a factor: look closer
            ratio = -np.log(_WALKS[1])
            std, middle = ratio / np.sqrt(-bend), np.log(noises[i].walk) + ratio * slope / bend
            walks = np.exp(middle + 0.9 * std * np.arange(-2.0, 3.0))
            noises, density = _weighed(steps, command, white, extra, walks, at)
    density -= np.logaddexp.reduce(density)
    return [(noise, float(p)) for noise, p in zip(noises, density, strict=True) if p > _NEGLIGIBLE_WALK]


def _weighed(
    steps: ConfigurationSteps,
    command: CommandPath,
    white: float,
    extra: Floats,
    walks: Floats,
    at: tuple[float, Floats, float],
) -> tuple[list[StepNoise], Floats]:
    """Noises with given walks (w,), and their ln posterior, rotation and gain integrated out by Laplace's method."""
    delay, rotation, log_gain = at
    noises = [step_noise_of(steps, steps.size, extra, float(walk), white) for walk in walks]
    predictors = steps.predictors(command, np.array([delay]))[0]
    solved = np.stack([noise.solve(predictors) for noise in noises])
    every = Quadratic(np.matmul(solved, predictors.T), np.matmul(solved, steps.size))
    channels, information = climb(every, np.tile(rotation, (len(noises), 1)), np.full(len(noises), log_gain), 5)
    density = np.array([noise.log_density for noise in noises]) + 0.5 * np.log(walks)
    return noises, density + channels.score - 0.5 * np.linalg.slogdet(information)[1]


def _explored(
    steps: ConfigurationSteps, command: CommandPath, noise: StepNoise, delays: Floats, rotation: Floats, log_gain: float
) -> _Mode:
    """The mode over a grid of delays, starting everywhere at one rotation and gain."""
    d = len(delays)
    quadratic = _quadratic(steps, steps.predictors(command, delays), noise)
    channels, information = climb(quadratic, np.tile(rotation, (d, 1)), np.full(d, log_gain))
    score = channels.score - 0.5 * (delays / DELAY_STD) ** 2 - 0.5 * np.linalg.slogdet(information)[1]
    log_weight = score - np.logaddexp.reduce(score)
    weight = np.exp(log_weight)
    delay = float(weight @ delays)
    near = int(np.argmin(np.abs(delays - delay) - 1e-3 * weight))
    at = _quadratic(steps, steps.predictors(command, np.array([delay])), noise)
    best, there = climb(at, channels.rotation[near : near + 1], channels.log_gain[near : near + 1], 4)
    turns = rotation_vector(times(channels.rotation, conjugate(best.rotation)))
    return _Mode(delay, best.rotation[0], float(best.log_gain[0]), there[0], delays, log_weight, turns)


def _integrated(
    steps: ConfigurationSteps, command: CommandPath, noises: list[tuple[StepNoise, float]], mode: _Mode, none: float
) -> Posterior:
    """Over rotations, gains, delays and random walks."""
    delays = mode.delays[::2]
    spacing = delays[1] - delays[0]
    log_prior = -0.5 * (delays / DELAY_STD) ** 2 + np.log(spacing / (DELAY_STD * np.sqrt(2 * np.pi)))
    predictors = steps.predictors(command, delays)
    quadratics = [_quadratic(steps, predictors, noise) for noise, _ in noises]
    walks = np.array([noise.walk for noise, _ in noises])
    log_walk = 0.5 * np.log(walks) + np.log(_spacings(walks)) - np.log(2 * np.sqrt(none))
    density = np.array([noise.log_density for noise, _ in noises]) + log_walk
    likely = int(np.argmax([p for _, p in noises]))
    weight = np.exp(mode.log_weight)
    covariance = np.linalg.inv(mode.information)[:3, :3] + (mode.turns * weight[:, None]).T @ mode.turns
    every = Quadratic(
        np.concatenate([quadratic.normal for quadratic in quadratics]),
        np.concatenate([quadratic.target for quadratic in quadratics]),
    )
    log_weight = (density[:, None] + log_prior).ravel()
    return integrate(every, log_weight, mode.rotation, mode.log_gain, covariance, len(noises), likely)


def _reported(mode: _Mode, posterior: Posterior, track: PartTrack, explained: float) -> ActionChannel:
    covariance = np.zeros((_NUMBERS, _NUMBERS))
    weight, square = posterior.delays, posterior.square
    offset = mode.delays[::2] - mode.delay
    cross = (weight * offset) @ posterior.mean
    if posterior.effective < _FEWEST_DRAWS:
        covariance[:4, :4] = np.linalg.inv(mode.information)
    else:
        covariance[:4, :4] = square
        covariance[:4, 4] = covariance[4, :4] = cross
    covariance[4, 4] = weight @ offset**2
    gain = float(np.exp(mode.log_gain))
    units = np.array([1.0, 1.0, 1.0, gain, track.duration])
    covariance *= np.outer(units, units)
    x, y, z = (float(v) for v in rotation_vector(mode.rotation))
    rows = tuple(tuple(float(v) for v in row) for row in covariance)
    return ActionChannel((x, y, z), gain, mode.delay * track.duration, rows, explained)


def _spacings(walks: Floats) -> Floats:
    """(w,) share of the ln-axis that each of evenly spaced walks stands for."""
    return np.full(len(walks), abs(np.log(walks[1] / walks[0])) if len(walks) > 1 else 1.0)


def _predicted(
    steps: ConfigurationSteps, command: CommandPath, delay: float, rotation: Floats, log_gain: float
) -> Floats:
    m = np.exp(log_gain) * rotation_matrix(rotation).ravel()
    return np.asarray(m @ steps.predictors(command, np.array([delay]))[0])


def _unknown(steps: ConfigurationSteps, delay: float, width: float, walk: float) -> Floats:
    """(m,) variance of steps whose actions, at some delay of interest, are not recorded."""
    outside = (steps.start < max(delay + width, 0.0)) | (steps.end > 1.0 + min(delay - width, 0.0))
    return np.where(outside, walk * (steps.end - steps.start), 0.0)


def _explained(steps: ConfigurationSteps, command: CommandPath, mode: _Mode, noise: StepNoise) -> float:
    """Share of the mean squared step, between blocks of the run, that the channel predicts; less measurement noise."""
    predicted = _predicted(steps, command, mode.delay, mode.rotation, mode.log_gain)
    block = np.minimum((0.5 * (steps.start + steps.end) * _BLOCKS).astype(np.int64), _BLOCKS - 1)
    moved = np.bincount(block, steps.size, _BLOCKS)
    missed = np.bincount(block, steps.size - predicted, _BLOCKS)
    by_noise = 2 * noise.white * len(np.unique(block))
    motion = float(moved @ moved) - by_noise
    if motion <= 0:
        return 0.0
    return float(np.clip(1.0 - max(float(missed @ missed) - by_noise, 0.0) / motion, 0.0, 1.0))


_WHITE_SPREAD = 0.4  # std of ln r about what the caller believes of the white variance r
_WALK_DECADES = np.arange(-9.0, 1.1)  # ln-grid of the random walk's variance, of the mean squared step
_REFINEMENTS = 4
_BETWEEN = 4  # points per row that it is smoothed at
_LONGEST_GAPS = 16  # mean rows per median row


@dataclass(frozen=True, eq=False)
class CommandPath:
    """The running sum of the actions of a run as a path in time, base frame; beyond its ends it goes on as there.

    Attributes:
        time: (n,) of the points that are known, as a share of the run's duration: rows are at 0 to 1.
        path: (n, 3) what was commanded until then [m].
        before, after: (3,) rates before the first and after the last of them [m per run].
    """

    time: Floats
    path: Floats
    before: Floats
    after: Floats

    def at(self, time: Floats) -> Floats:
        """(..., 3) what was commanded until the given times (...)."""
        path = np.stack([np.interp(time, self.time, self.path[:, i]) for i in range(3)], axis=-1)
        early, late = np.minimum(time - self.time[0], 0.0), np.maximum(time - self.time[-1], 0.0)
        if early.min(initial=0.0) < 0:
            path += early[..., None] * self.before
        if late.max(initial=0.0) > 0:
            path += late[..., None] * self.after
        return path

    def smoothed(self, rows: float) -> CommandPath:
        """The same, each action spread over time by a normal distribution, its std so many rows."""
        row = max(float(np.median(np.diff(self.time))), 1 / (_LONGEST_GAPS * len(self.time)))
        # Four standard deviations beyond the ends, so that the path is what it is at the ends.
        edge = 4 * rows * row
        fine = np.arange(-edge, 1 + edge, row / _BETWEEN)
        inside = (fine > -row) & (fine < 1 + row)
        path = gaussian_filter1d(self.at(fine), rows * _BETWEEN, axis=0)
        return replace(self, time=fine[inside], path=path[inside])


@dataclass(frozen=True, eq=False)
class ConfigurationSteps:
    """m steps of the configuration between measured rows.

    Attributes:
        start, end: (m,) when they begin and end, as shares of the run's duration.
        size: (m,) measured c' - c [rad or m].
        leverage: (m, 3) J⁻¹ halfway, of displacements in the base frame [rad or m per m].
        linked: (m - 1,) whether a step begins with the row that the one before it ends with.
        white: believed white variance of one row [rad² or m²].
    """

    start: Floats
    end: Floats
    size: Floats
    leverage: Floats
    linked: Booleans
    white: float

    def __len__(self) -> int:
        return len(self.size)

    def predictors(self, command: CommandPath, delays: Floats) -> Floats:
        """(d, 9, m) what the entries of g R (row by row) make of the steps, for each delay (d,) [share of the run]."""
        ends = np.concatenate([self.start, self.end])
        path = command.at(ends - delays[:, None])
        commanded = path[:, len(self) :] - path[:, : len(self)]
        product = self.leverage.T[None, :, None, :] * commanded.transpose(0, 2, 1)[:, None, :, :]
        return product.reshape(len(delays), 9, len(self))


@dataclass(frozen=True, eq=False)
class StepNoise:
    """Covariance of the steps, factored.

    Attributes:
        walk: variance of the random walk per run [rad² or m²].
        white: variance of the white noise of a row [rad² or m²].
        log_density: of the steps it was fitted to, with the prior of `white` [nats].
    """

    walk: float
    white: float
    log_density: float
    diagonal: Floats
    below: Floats

    def solve(self, signals: Floats) -> Floats:
        """(k, m) signals multiplied by the inverse covariance."""
        # LAPACK wants columns: the transpose of rows is that without a copy.
        return np.asarray(lapack.dpttrs(self.diagonal, self.below, signals.T)[0].T)


def command_of(track: PartTrack) -> CommandPath | None:
    """What the run's actions command; None where there are none."""
    if track.action is None or track.duration <= 0 or not np.any(track.action):
        return None
    action = track.action if track.quaternion is None else Rotation.from_quat(track.quaternion).apply(track.action)
    time = (track.time - track.time[0]) / track.duration
    path = np.concatenate([np.zeros((1, 3)), np.cumsum(action[:-1], axis=0)])
    edge = min(max(3, len(time) // 32), len(time) - 1)
    return CommandPath(
        time,
        path,
        (path[edge] - path[0]) / (time[edge] - time[0]),
        (path[-1] - path[-1 - edge]) / (time[-1] - time[-1 - edge]),
    )


def configuration_steps(
    joint: Joint, pieces: Sequence[tuple[int, int]], track: PartTrack, inlier: Booleans, white: float, most: int | None
) -> ConfigurationSteps:
    """Steps of the rows of pieces that count; with `most`, about that many per run, between averages of rows.

    Args:
        white: variance of one measured configuration [rad² or m²].
    """
    configuration = configurations_along(joint, pieces, track, inlier)
    time = (track.time - track.time[0]) / track.duration
    group = 1 if most is None else max(1, round(len(track) / most))
    blocks = [
        (_averaged(time[rows], group), _averaged(c, group), _averaged(calm, group)) for rows, c, calm in configuration
    ]
    start = np.concatenate([t[:-1] for t, _, _ in blocks])
    end = np.concatenate([t[1:] for t, _, _ in blocks])
    size = np.concatenate([np.diff(c) for _, c, _ in blocks])
    # Noise of the configuration that a direction is taken at would weaken what is explained.
    halfway = np.concatenate([0.5 * (calm[:-1] + calm[1:]) for _, _, calm in blocks])
    lengths = np.array([max(len(t) - 1, 0) for t, _, _ in blocks])
    linked = np.ones(max(len(size) - 1, 0), dtype=bool)
    ends = np.cumsum(lengths)[:-1]
    linked[ends[(ends > 0) & (ends < len(size))] - 1] = False
    return ConfigurationSteps(start, end, size, _leverage(joint, halfway), linked, white / group)


def fit_noise(steps: ConfigurationSteps, residual: Floats, extra: Floats) -> StepNoise:
    """The most probable random walk and white noise behind what is left (m,) of the steps.

    Args:
        extra: (m,) variance known besides [rad² or m²].
    """
    scale = max(float(np.mean(residual**2 / (steps.end - steps.start))), steps.white * 1e-6, 1e-24)

    def tried(walk: float, white: float) -> StepNoise:
        return step_noise_of(steps, residual, extra, np.exp(walk) * scale, np.exp(white) * steps.white)

    best, at = max(((tried(w, 0.0), (w, 0.0)) for w in _WALK_DECADES), key=lambda pair: pair[0].log_density)
    width = np.array([0.5, 0.4])
    for _ in range(_REFINEMENTS):
        for i in range(2):
            for sign in (1.0, -1.0):
                moved = list(at)
                moved[i] += sign * width[i]
                trial = tried(moved[0], moved[1])
                if trial.log_density > best.log_density:
                    best, at = trial, (moved[0], moved[1])
                    break
        width *= 0.6
    return best


def step_noise_of(steps: ConfigurationSteps, residual: Floats, extra: Floats, walk: float, white: float) -> StepNoise:
    """Given noise (variances, see StepNoise), with its density of what is left (m,) of the steps."""
    diagonal = walk * (steps.end - steps.start) + extra + 2 * white * (1 + 1e-9)
    below = np.where(steps.linked, -white, 0.0)
    pivots, factor, _ = lapack.dpttrf(diagonal, below)
    solved = lapack.dpttrs(pivots, factor, residual[:, None])[0][:, 0]
    misfit = (
        float(residual @ solved)
        + float(np.sum(np.log(np.maximum(pivots, VANISHING))))
        + len(residual) * np.log(2 * np.pi)
    )
    prior = (np.log(white / steps.white) / _WHITE_SPREAD) ** 2
    return StepNoise(walk, white, -0.5 * (misfit + prior), pivots, factor)


def _averaged(value: Floats, group: int) -> Floats:
    """Means of groups of rows; a last group that is not full is left out."""
    full = len(value) // group * group
    return np.asarray(value[:full].reshape(-1, group).mean(axis=1))


def _leverage(joint: Joint, c: Floats) -> Floats:
    """(m, 3) rows that J⁻¹ multiplies a displacement by; 0 where the part's origin is on the axis."""
    if joint.kind == "prismatic":
        return np.broadcast_to(np.array(joint.axis), (len(c), 3))
    direction = jacobian(joint, c)[:, 3:]
    squared = np.sum(direction**2, axis=1, keepdims=True)
    return np.asarray(direction / np.maximum(squared, 1e-12))


Rows = NDArray[np.intp]

_CALM = 64  # windows per run that configurations are averaged over
_NEAR = 4  # rows on each side that a direction is compared with


def configurations_along(
    joint: Joint, pieces: Sequence[tuple[int, int]], track: PartTrack, inlier: Booleans
) -> list[tuple[Rows, Floats, Floats]]:
    """Per piece its rows that count, their measured configurations, and these without most of their noise.

    A row counts in its average no more than its neighbours do, so what noise is left has nothing to do with that of a
    step from row to row.
    """
    steps_of_pieces = []
    half = max(1, round(len(track) / (2 * _CALM)))
    for first, last in pieces:
        rows = np.arange(first, last + 1)[inlier[first : last + 1]]
        rotation = None if track.quaternion is None else Rotation.from_quat(track.quaternion[rows])
        measured = inverse(joint, track.position[rows], rotation)
        if joint.turns:
            measured = np.unwrap(measured)
        steps_of_pieces.append((rows, measured, _running_mean(measured, half)))
    return steps_of_pieces


def with_anchored_actions(
    joint: Joint, pieces: Sequence[tuple[int, int]], track: PartTrack, inlier: Booleans
) -> PartTrack:
    """The track with the actions of the pieces' rows turned back by what follows the rows' own errors."""
    if not joint.turns or track.action is None:
        return track
    configuration = configurations_along(joint, pieces, track, inlier)
    rows, error = (
        np.concatenate([r for r, _, _ in configuration]),
        np.concatenate([c - calm for _, c, calm in configuration]),
    )
    if not len(rows):
        return track
    world = None if track.quaternion is None else Rotation.from_quat(track.quaternion[rows])
    action = track.action[rows] if world is None else world.apply(track.action[rows])
    axis, (first, second) = np.array(joint.axis), axis_basis(joint.axis)
    local = (action @ first + 1j * (action @ second)) * np.exp(
        -1j * np.concatenate([calm for _, _, calm in configuration])
    )
    # A push and a pull have one direction: angles are doubled.
    doubled = local**2 / np.maximum(np.abs(local), 1e-300)
    around = np.convolve(doubled, np.ones(2 * _NEAR + 1))[_NEAR : _NEAR + len(doubled)]
    turned, weight = 0.5 * np.angle(doubled * around.conj()), np.abs(doubled) * np.abs(around)
    power = float(weight @ error**2)
    share = 0.0 if power == 0.0 else float(np.clip((weight * error) @ turned / power, 0.0, 1.0))
    action = Rotation.from_rotvec(-share * error[:, None] * axis).apply(action)
    actions = np.array(track.action)
    actions[rows] = action if world is None else world.inv().apply(action)
    return replace(track, action=actions)


def _running_mean(value: Floats, half: int) -> Floats:
    """Means over as many rows before as after, `half` at most."""
    n = len(value)
    total = np.concatenate([[0.0], np.cumsum(value)])
    reach = np.minimum(np.minimum(np.arange(n), np.arange(n)[::-1]), half)
    at = np.arange(n)
    return np.asarray((total[at + reach + 1] - total[at - reach]) / (2 * reach + 1))
