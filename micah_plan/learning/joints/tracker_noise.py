"""Noise of a tracker's poses, white and wandering, and its posterior given what a fit of a joint leaves.

**Error contrasts.** What rows say of a joint where their own configurations cannot reach.

Each row has a configuration of its own, which is estimated with the joint. Combinations of a row's errors that no
change of its configuration can alter ("error contrasts") are free of it, so their likelihood is that of the joint
alone: the many configurations bias no noise scale (the problem of Neyman and Scott, 1948).

All is written in the joint's own frame, where every derivative is a sine, a cosine or a constant.

How real joints deviate from ideal ones: smoothly with the configuration, and the same in every row that comes there.

Rows do not average such a deviation out. It is a random path over the range of configurations,

    b(c) = s · sum over j of z_j / j² · sqrt(2) cos(j π u),    u from 0 to 1 over the range, z_j normal,

about as smooth as an integrated random walk. A fit absorbs its slowest modes, and the joint's parameters are wrong by
them; how large these are (s) is told by the modes that a fit leaves. Source: Wahba, "Bayesian confidence intervals for
the cross-validated smoothing spline", JRSS B 1983.

Noise of a tracker in time, estimated from what a fit leaves: white, an Ornstein-Uhlenbeck wander, a joint's misfit.

The precision of an Ornstein-Uhlenbeck process sampled at any times is tridiagonal (it is Markov), so everything here
costs O(n). Scales come from the restricted likelihood (Patterson and Thompson, 1971), which pays for the parameters.
Their posterior over a grid is kept: what the data cannot tell of the wander then widens the covariance of a fit.

**Covariances whose stds cover.** 1.96 of them hold 95 % of errors that are a mixture of normal distributions.

A rare component of large errors would widen intervals made of the mixture's variance beyond all that ever occurs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import lapack
from scipy.special import ndtr

from micah_plan.arrays import INTERVAL, INTERVAL_STDS, ROUND_OFF, TINY, Floats
from micah_plan.automaton.joint import Joint
from micah_plan.learning.joints.parametrization import FRAME_NUMBERS, PITCH_NUMBER, Seen

_UNLIKELY = 0.05  # of the likeliest correlation time; others add little but time


@dataclass(frozen=True)
class Scales:
    """What is believed of errors before anything is seen.

    Attributes:
        least: smallest stds of noise to believe in, of a rotation [rad] and a position [m].
        misfit: size of a typical misfit of a joint, of both.
    """

    least: tuple[float, float]
    misfit: tuple[float, float]


@dataclass(frozen=True, eq=False)
class NoiseVariances:
    """Variances of a tracker's noise per axis [m², rad²] with a wander of one correlation time, if any."""

    position_white: float
    position_wander: float
    rotation_white: float
    rotation_wander: float
    process: OrnsteinUhlenbeck | None

    @property
    def stds(self) -> tuple[float, float]:
        """Total std of a rotation [rad] and a position [m]."""
        return (
            float(np.sqrt(self.rotation_white + self.rotation_wander)),
            float(np.sqrt(self.position_white + self.position_wander)),
        )

    def of(self, contrast: Contrasts) -> tuple[float, float]:
        """White and wandering variance of contrasts."""
        turns = contrast.reach**2 if contrast.position is not None else 1.0
        white = wander = 0.0
        if contrast.position is not None:
            white, wander = self.position_white, self.position_wander
        if contrast.rotation is not None:
            white, wander = white + turns * self.rotation_white, wander + turns * self.rotation_wander
        return white, wander


@dataclass(frozen=True, eq=False)
class ErrorPosterior:
    """What is known of the errors of poses, given what a fit leaves.

    Attributes:
        noises: probabilities of correlation times, with the tracker's noise there.
        modes: (n, m) of a misfit of the joint at the rows (`misfit_modes`).
        chance: (s,) probabilities of sizes of that misfit.
        position, rotation: (s,) its variances [m², rad²].
    """

    noises: tuple[tuple[float, NoiseVariances], ...]
    modes: Floats
    chance: Floats
    position: Floats
    rotation: Floats

    @property
    def likeliest(self) -> NoiseVariances:
        """The noise of the likeliest correlation time."""
        return max(self.noises, key=lambda pair: pair[0])[1]


def white_noise(stds: tuple[float, float]) -> NoiseVariances:
    """Noise without wander, of a std of rotations [rad] and positions [m]."""
    return NoiseVariances(stds[1] ** 2, 0.0, stds[0] ** 2, 0.0, None)


def noise_of(
    contrasts: Sequence[Contrasts],
    within: Floats,
    time: Floats,
    configuration: Floats,
    stds: tuple[float, float],
    scales: Scales,
) -> ErrorPosterior | None:
    """Posterior of the noise and of the joint's misfit; None where rows are too few to tell.

    Args:
        contrasts: what a fit leaves.
        within: (11, p) the parameters that were fitted (`Chart.in_frame`).
        time, configuration: (n,) of the fitted rows [s], [rad or m].
        stds: rough ones, of a rotation [rad] and a position [m].
        scales: what is believed beforehand.
    """
    tried = memories(time)
    modes = misfit_modes(configuration)
    posteriors = _posteriors(contrasts, within, wanders(time), modes, scales)
    if posteriors is None:
        return None
    score = np.sum([posterior.log_likelihood for posterior in posteriors], axis=0)
    probability = np.exp(score - score.max())
    probability[probability < _UNLIKELY] = 0.0
    probability /= probability.sum()
    position, rotation = posteriors[0], posteriors[1] if len(posteriors) > 1 else None
    noises = tuple(
        (
            float(probability[i]),
            NoiseVariances(
                float(position.white[i]),
                float(position.wander[i]),
                float(rotation.white[i]) if rotation else stds[0] ** 2,
                float(rotation.wander[i]) if rotation else 0.0,
                OrnsteinUhlenbeck(time, float(memory)),
            ),
        )
        for i, memory in enumerate(finer(tried))
        if probability[i]
    )
    chance, size = _sizes(position, probability)
    if rotation is None:
        return ErrorPosterior(noises, modes, chance, size, np.zeros_like(size))
    turning_chance, turning_size = _sizes(rotation, probability)
    # A position and a rotation miss by sizes of their own: every pair of these.
    both = np.outer(chance, turning_chance).ravel()
    sizes = np.repeat(size, len(turning_size)), np.tile(turning_size, len(size))
    return ErrorPosterior(noises, modes, both, *sizes)


def _sizes(posterior: NoisePosterior, probability: Floats) -> tuple[Floats, Floats]:
    """(s,) probabilities and variances of a misfit, over correlation times of given probabilities (f,)."""
    chance = posterior.chance @ probability
    return chance, (posterior.chance * posterior.misfit) @ probability / np.maximum(chance, 1e-300)


def wanders(time: Floats) -> list[OrnsteinUhlenbeck]:
    """Wanders worth trying for rows at these times (n,) [s]."""
    return [OrnsteinUhlenbeck(time, memory) for memory in memories(time).tolist()]


def log_evidence(
    contrasts: Sequence[Contrasts],
    within: Floats,
    tried: list[OrnsteinUhlenbeck],
    configuration: Floats,
    scales: Scales,
) -> float:
    """Ln density of what a fit to positions leaves, its numbers (flat) and the noise integrated out; 0 of too few rows.

    Args:
        contrasts, configuration, scales: those of `noise_of`.
        within: (11, r) of the r numbers that were fitted.
        tried: `wanders` at the times of the rows.
    """
    posteriors = _posteriors(contrasts, within, tried, misfit_modes(configuration), scales)
    if posteriors is None:
        return 0.0
    columns = np.concatenate([c.design.reshape(-1, FRAME_NUMBERS) @ within for c in contrasts])
    # The posteriors integrate over orthonormal numbers. What rows tell less of than a metre or a radian has no volume.
    squares = np.linalg.eigvalsh(columns.T @ columns)
    volume = 0.5 * float(np.log(np.maximum(squares, scales.least[1] ** 2)).sum())
    return float(np.logaddexp.reduce(np.sum([posterior.log_likelihood for posterior in posteriors], axis=0))) - volume


def _posteriors(
    contrasts: Sequence[Contrasts],
    within: Floats,
    processes: list[OrnsteinUhlenbeck],
    modes: Floats,
    scales: Scales,
) -> list[NoisePosterior] | None:
    """Of the pure contrasts, positions first."""
    posteriors: list[NoisePosterior] = []
    for contrast in contrasts:
        if contrast.reach:
            continue
        sort = 1 if contrast.rotation is None else 0
        scale = scales.least[sort] ** 2, scales.misfit[sort] ** 2
        posterior = noise_posterior(processes, modes, contrast.error, contrast.design @ within, scale)
        if posterior is None:
            return None
        posteriors.append(posterior)
    return posteriors


# Columns of a design: tilt 0, 1; shift of the centre 2, 3; pitch 4; turn of the origin 5, 6, 7; its shift 8, 9, 10.
_TILT, _SHIFT, _PITCH, _TURN, _MOVE = 0, 2, PITCH_NUMBER, 5, 8


@dataclass(frozen=True, eq=False)
class Contrasts:
    """k error contrasts per row, of equal noise.

    Attributes:
        error: (n, k) [rad or m].
        design: (n, k, 11) derivative of what the model expects there by the frame's numbers (see parametrization).
        position: (n, k, 3) how the contrasts weigh the error of the position, joint's frame; None if they do not.
        rotation: (n, k, 3) the same for the error of the rotation [m/rad where mixed].
        reach: how far a radian of rotation noise counts in metres of position noise; 0 in pure ones.
    """

    error: Floats
    design: Floats
    position: Floats | None
    rotation: Floats | None
    reach: float = 0.0


def contrasts_of(joint: Joint, compared: Seen, stds: tuple[float, float]) -> list[Contrasts]:
    """The contrasts of rows: of positions, of rotations and of both, those that the joint has.

    Args:
        stds: of a rotation [rad] and a position [m].
    """
    if not joint.turns:
        return _straight(joint, compared)
    n, c = len(compared.configuration), compared.configuration
    radius, reach = compared.radius, float(np.hypot(compared.radius, joint.pitch))
    forwards, upwards = (radius / reach, joint.pitch / reach) if reach > ROUND_OFF else (1.0, 0.0)
    cosine, sine = np.cos(c), np.sin(c)
    poses = _turning_design(c, cosine, sine, radius, joint.pitch)
    error = np.empty((n, 2))
    # A configuration that is off by its noise lies outside the circle, by half its variance times the radius.
    information = (reach / stds[1]) ** 2 + (0.0 if compared.rotation_error is None else stds[0] ** -2)
    error[:, 0] = compared.position_error[:, 0] - 0.5 * radius / max(information, ROUND_OFF)
    error[:, 1] = upwards * compared.position_error[:, 1] - forwards * compared.position_error[:, 2]
    design = np.stack([poses[:, 0], upwards * poses[:, 1] - forwards * poses[:, 2]], axis=1)
    weights = np.zeros((n, 2, 3))
    weights[:, 0, 0], weights[:, 0, 1] = cosine, sine
    weights[:, 1, 0], weights[:, 1, 1], weights[:, 1, 2] = -upwards * sine, upwards * cosine, -forwards
    result = [Contrasts(error, design, weights, None)]
    if compared.rotation_error is None:
        return result
    turning = np.zeros((n, 2, FRAME_NUMBERS))
    turning[:, 0, _TILT] = turning[:, 1, _TILT + 1] = 1 - cosine
    turning[:, 0, _TILT + 1], turning[:, 1, _TILT] = sine, -sine
    turning[:, 0, _TURN] = turning[:, 1, _TURN + 1] = cosine
    turning[:, 0, _TURN + 1], turning[:, 1, _TURN] = -sine, sine
    result.append(Contrasts(compared.rotation_error[:, :2], turning, None, np.broadcast_to(np.eye(3)[:2], (n, 2, 3))))
    mixed = forwards * poses[:, 1] + upwards * poses[:, 2]
    mixed[:, _TURN + 2] -= reach
    both = (
        forwards * compared.position_error[:, 1]
        + upwards * compared.position_error[:, 2]
        - reach * compared.rotation_error[:, 2]
    )
    by_position = np.stack([-forwards * sine, forwards * cosine, np.full(n, upwards)], axis=1)[:, None]
    by_rotation = np.broadcast_to([0.0, 0.0, -reach], (n, 1, 3))
    result.append(Contrasts(both[:, None], mixed[:, None], by_position, by_rotation, reach))
    return result


def _straight(joint: Joint, compared: Seen) -> list[Contrasts]:
    """Contrasts of a joint that does not turn."""
    n, k = len(compared.configuration), 2 if joint.moves else 3
    design = np.zeros((n, k, FRAME_NUMBERS))
    for i in range(k):
        design[:, i, _MOVE + i] = 1.0
    if joint.moves:
        design[:, 0, _TILT + 1], design[:, 1, _TILT] = compared.configuration, -compared.configuration
    frame = np.eye(3)
    result = [Contrasts(compared.position_error[:, :k], design, np.broadcast_to(frame[:k], (n, k, 3)), None)]
    if compared.rotation_error is not None:
        turning = np.zeros((n, 3, FRAME_NUMBERS))
        for i in range(3):
            turning[:, i, _TURN + i] = 1.0
        result.append(Contrasts(compared.rotation_error, turning, None, np.broadcast_to(frame, (n, 3, 3))))
    return result


def _turning_design(c: Floats, cosine: Floats, sine: Floats, radius: float, pitch: float) -> Floats:
    """(n, 3, 11) derivative of positions, along the radius, the tangent and the axis."""
    design = np.zeros((len(c), 3, FRAME_NUMBERS))
    height = pitch * c
    design[:, 0, _TILT], design[:, 0, _TILT + 1] = -height * sine, height * cosine
    design[:, 1, _TILT], design[:, 1, _TILT + 1] = -height * cosine, -height * sine
    design[:, 2, _TILT], design[:, 2, _TILT + 1] = radius * sine, radius * (1 - cosine)
    design[:, 0, _SHIFT] = design[:, 1, _SHIFT + 1] = cosine - 1
    design[:, 0, _SHIFT + 1], design[:, 1, _SHIFT] = sine, -sine
    design[:, 2, _PITCH] = c
    for i in range(3):
        design[:, i, _MOVE + i] = 1.0
    return design


_MODES = 8  # waves along the travel that a misfit is made of
_FACTOR = 8.0  # from one variance of a misfit that is tried to the next
_LARGEST = 1e4  # of these, in units of the white noise of a row; the smallest is that of the mean of all rows
_IDEAL = 0.98  # probability, before anything is seen, of no misfit; less widens what ideal joints leave
_BREADTH = float(np.log(4.0))  # std of ln of its size, where there is one


def misfit_modes(configuration: Floats) -> Floats:
    """(n, m) modes of a misfit of size 1 at configurations (n,); m = 0 where these do not differ."""
    low = configuration.min()
    span = float(configuration.max() - low)
    if span < ROUND_OFF:
        return np.zeros((len(configuration), 0))
    order = np.arange(1, _MODES + 1)
    return np.asarray(np.sqrt(2) * np.cos(np.pi * np.outer((configuration - low) / span, order)) / order**2)


def misfits_tried(modes: Floats) -> Floats:
    """(s,) variances of a misfit with modes (n, m), in units of the white noise; the first is 0."""
    n, m = modes.shape
    if m == 0:
        return np.zeros(1)
    steps = int(np.ceil(np.log(_LARGEST * n) / np.log(_FACTOR)))
    return np.append(0.0, _FACTOR ** np.arange(steps + 1) / n)


def misfit_prior(variance: Floats, typical: float) -> Floats:
    """(s, ...) probabilities of the variances (s, ...) of `misfits_tried`.

    Args:
        typical: variance of a misfit.
    """
    if len(variance) == 1:
        return np.ones_like(variance)
    away = 0.5 * np.log(np.maximum(variance[1:] / typical, 1e-300)) / _BREADTH
    density = np.exp(-0.5 * away**2) / np.sqrt(2 * np.pi) / _BREADTH * 0.5 * np.log(_FACTOR)
    return np.concatenate([np.full_like(variance[:1], _IDEAL), (1 - _IDEAL) * density])


def without_misfit(products: Floats, contrasts: list[slice], tried: Floats) -> tuple[Floats, Floats]:
    """Products of columns with the misfit integrated out, and what that costs.

    Args:
        products: (g, k, k) of the columns of all contrasts and, behind them, of the modes.
        contrasts: which columns are those of each of equally many; each has a misfit of its own.
        tried: (s,) variances.

    Returns:
        (s, g, r, r) products of a contrast's columns, summed over the contrasts, and (s, g) ln det.
    """
    behind = slice(contrasts[-1].stop, None)
    # Eigenvectors of the modes' products serve all variances.
    values, vectors = np.linalg.eigh(products[:, behind, behind])
    values = np.maximum(values, 0.0)
    plain = sum(products[:, contrast, contrast] for contrast in contrasts)
    on_modes = np.concatenate(
        [vectors.swapaxes(1, 2) @ products[:, behind, contrast] for contrast in contrasts], axis=1
    )
    weight = tried[:, None, None] / (1 + tried[:, None, None] * values)
    wide = np.tile(weight, len(contrasts))[..., None]
    residual = plain - on_modes.swapaxes(1, 2) @ (wide * on_modes)
    return residual, len(contrasts) * np.log1p(tried[:, None, None] * values).sum(axis=2)


_TIMES = 5  # correlation times tried
_LONGEST = 0.4  # of the duration; a slower wander looks like another joint
_RATIOS = (1.0, 6.0, 36.0, 216.0, 1296.0, 7776.0)  # noise a wander adds at slow frequencies, in units of the white
_LEANING = 0.2  # power of the correlation time in its prior
_FINE = 13  # correlation times, and ratios, that likelihoods are interpolated at
_CALM = 0.65  # probability, before anything is seen, that a tracker does not wander
_FASTEST = 2.0  # rows; a wander of shorter memory is white noise
_LEAST_INNOVATION = 1e-6  # of an Ornstein-Uhlenbeck step; rows at the same time would make it 0
_GAP = 10.0  # rows; a longer pause counts as one of this length


class OrnsteinUhlenbeck:
    """A wander of variance 1 at given times."""

    def __init__(self, time: Floats, memory: float) -> None:
        """Times (n,) [s], not decreasing; memory is the correlation time [s]."""
        kept = np.exp(-np.diff(time) / memory)
        gain = 1 / np.maximum(1 - kept**2, _LEAST_INNOVATION)
        self.memory = memory
        self.diagonal = np.concatenate([[1.0], gain])
        self.diagonal[:-1] += kept**2 * gain
        self.beside = -kept * gain
        self.log_precision = float(np.log(gain).sum())

    def covariance_times(self, columns: Floats) -> Floats:
        """K X for columns (n, m)."""
        diagonal, beside, _ = lapack.dpttrf(self.diagonal, self.beside)
        return _solved(diagonal, beside, columns)

    def smoothed(self, ratio: float, columns: Floats) -> tuple[Floats, float]:
        """(K⁻¹ + ratio I)⁻¹ X for columns (n, m), and log det (I + ratio K)."""
        diagonal, beside, _ = lapack.dpttrf(self.diagonal + ratio, self.beside)
        return _solved(diagonal, beside, columns), float(np.log(diagonal).sum()) - self.log_precision

    def whiten(self, ratio: float, columns: Floats) -> Floats:
        """(I + ratio K)⁻¹ X for columns (n, m)."""
        return columns - ratio * self.smoothed(ratio, columns)[0]


@dataclass(frozen=True, eq=False)
class NoisePosterior:
    """What is known of the noise of contrasts, for each of the `finer` correlation times.

    Attributes:
        log_likelihood: (f,) restricted, the ratios of wander and misfit to white noise integrated out.
        white, wander: (f,) mean variances, given each correlation time.
        chance, misfit: (s, f) probabilities of the sizes of a misfit that were tried, and mean variances there.
    """

    log_likelihood: Floats
    white: Floats
    wander: Floats
    chance: Floats
    misfit: Floats


def memories(time: Floats) -> Floats:
    """Correlation times worth trying for rows at these times (n,) [s]: from two rows to the whole duration."""
    steps = np.diff(time)
    typical = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
    duration = float(np.minimum(steps, _GAP * typical).sum())
    return np.geomspace(_FASTEST * typical, max(_LONGEST * duration, 2 * _FASTEST * typical), _TIMES)


def noise_posterior(
    processes: list[OrnsteinUhlenbeck], modes: Floats, error: Floats, design: Floats, scale: tuple[float, float]
) -> NoisePosterior | None:
    """Posterior of the noise that contrasts share, given what a fit leaves of them.

    Args:
        processes: one per correlation time.
        modes: (n, m) of a misfit of size 1 (`misfit_modes`).
        error: (n, k) of k contrasts of equal and independent noise.
        design: (n, k, p) their derivative by the parameters that were fitted, of any rank.
        scale: smallest variance to believe in, and that of a typical misfit.

    Returns:
        the posterior; None where the rows are too few to tell noise from parameters.
    """
    n, k = error.shape
    columns = _independent(design.reshape(n * k, -1))
    rank = columns.shape[1]
    degrees = n * k - rank
    if degrees < 3:
        return None
    both = np.concatenate([columns, error.reshape(n * k, 1)], axis=1)
    slowness = np.array([process.memory for process in processes]) / processes[0].memory
    products, log_dets = _products(processes, slowness, np.concatenate([both.reshape(n, -1), modes], axis=1))
    sizes = misfits_tried(modes)
    contrasts = [slice(i * (rank + 1), (i + 1) * (rank + 1)) for i in range(k)]
    grams, log_misfits = without_misfit(products, contrasts, sizes)
    residual, log_information = _left(grams, scale[0] * degrees)
    scores = -0.5 * (degrees * np.log(residual) + log_information + k * log_dets + log_misfits)
    # The first column is the likelihood without wander, which no correlation time changes.
    score, white = (
        _finer(scores, len(processes)),
        np.exp(_finer(np.log(residual), len(processes))) / max(degrees - 2, 1),
    )
    fine = np.exp(np.linspace(0, np.log(slowness[-1]), _FINE))
    level = np.append(0.0, np.exp(np.linspace(np.log(_RATIOS[0]), np.log(_RATIOS[-1]), _FINE)))
    wander = white * level / (2 * _FASTEST * fine[:, None])
    misfit = white * sizes[:, None, None]
    top = score.max()
    weight = np.exp(score - top) * _prior(fine) * misfit_prior(misfit, scale[1])
    total = np.maximum(weight.sum(axis=(0, 2)), 1e-300)
    of_size = np.maximum(weight.sum(axis=2), 1e-300)
    return NoisePosterior(
        log_likelihood=top + np.log(total),
        white=(weight * white).sum(axis=(0, 2)) / total,
        wander=(weight * wander).sum(axis=(0, 2)) / total,
        chance=of_size / total,
        misfit=(weight * misfit).sum(axis=2) / of_size,
    )


def _products(processes: list[OrnsteinUhlenbeck], slowness: Floats, columns: Floats) -> tuple[Floats, Floats]:
    """(g, m, m) products of columns (n, m) under every wander and, last, none; and (g,) log dets of the noise."""
    # Side by side, so that one tridiagonal solve serves all contrasts.
    beside = np.asfortranarray(columns)
    whole = beside.T @ beside
    products, log_dets = [], []
    for process, slow in zip(processes, slowness.tolist(), strict=True):
        for level in _RATIOS:
            ratio = level / (2 * _FASTEST * slow)
            solved, log_det = process.smoothed(ratio, beside)
            products.append(whole - ratio * (beside.T @ solved))
            log_dets.append(log_det)
    return np.array([*products, whole]), np.array([*log_dets, 0.0])


def finer(tried: Floats) -> Floats:
    """The correlation times that a `NoisePosterior` speaks of, from those tried."""
    return np.geomspace(tried[0], tried[-1], _FINE)


def _finer(values: Floats, times: int) -> Floats:
    """(s, f, 1 + f) values on the finer grid, from those tried (s, t r + 1) of which the last is without wander."""
    over_times, over_ratios = _spline(times), _spline(len(_RATIOS))
    wandering = over_times @ values[:, :-1].reshape(len(values), times, -1) @ over_ratios.T
    calm = np.broadcast_to(values[:, -1:, None], (len(values), _FINE, 1))
    return np.concatenate([calm, wandering], axis=2)


@lru_cache(maxsize=8)
def _spline(points: int) -> Floats:
    """(f, points) matrix that interpolates values at even points, by a cubic spline."""
    return np.asarray(CubicSpline(np.linspace(0, 1, points), np.eye(points))(np.linspace(0, 1, _FINE)))


def _prior(slowness: Floats) -> Floats:
    """(f, 1 + f) what is believed of correlation times and ratios before anything is seen.

    Likelihoods underrate slow wander, for a fit absorbs it: the prior leans that way, as reference priors of
    autoregressions do (Berger and Yang, 1994).
    """
    slow = slowness**_LEANING
    prior = np.outer(slow / slow.sum(), np.full(_FINE + 1, (1 - _CALM) / _FINE))
    prior[:, 0] = _CALM / _FINE
    return np.asarray(prior)


def _left(grams: Floats, least: float) -> tuple[Floats, Floats]:
    """Squares (...) that fits leave and log det of their information; grams (..., r + 1, r + 1) of columns, errors."""
    rank = grams.shape[-1] - 1
    lower = np.linalg.cholesky(grams[..., :rank, :rank])
    pulled = np.linalg.solve(lower, grams[..., :rank, rank:])[..., 0]
    squares = np.maximum(grams[..., rank, rank] - np.sum(pulled**2, axis=-1), least)
    return squares, 2 * np.log(np.diagonal(lower, axis1=-2, axis2=-1)).sum(axis=-1)


def _independent(columns: Floats) -> Floats:
    """An orthonormal basis of the columns (m, p), without directions that are nothing but round-off."""
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    real = values > 1e-10 * max(float(values[-1]), 1e-300)
    return np.asarray(scaled @ (vectors[:, real] / np.sqrt(values[real])))


def _solved(diagonal: Floats, beside: Floats, columns: Floats) -> Floats:
    return np.asarray(lapack.dpttrs(diagonal, beside, columns)[0])


_BISECTIONS = 30


def conservative_covariance(matrix: Floats, chance: Floats, off: Floats, std: Floats) -> Floats:
    """(k, k) covariance with the correlations of a matrix (k, k), and stds that cover.

    Args:
        chance: (m,) probabilities of the components.
        off, std: (m, k) their means and stds.
    """
    scale = _half_width(chance, off, std) / INTERVAL_STDS / np.maximum(np.sqrt(np.diag(matrix)), 1e-300)
    return np.asarray(matrix * scale[:, None] * scale)


def _half_width(chance: Floats, off: Floats, std: Floats) -> Floats:
    """(k,) half width of the interval about 0 that holds 95 % of a mixture of normals (m, k)."""
    std = np.maximum(std, TINY)
    low, high = np.zeros(off.shape[1]), (np.abs(off) + 4 * std).max(axis=0)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        inside = chance @ (ndtr((middle - off) / std) - ndtr((-middle - off) / std))
        low, high = np.where(inside < INTERVAL, middle, low), np.where(inside < INTERVAL, high, middle)
    return np.asarray(high)
