"""Maximum-likelihood fits of a joint under white and drifting noise, with the covariance of its parameters.

Generalized least squares over error contrasts, by Gauss-Newton with Levenberg's damping. The covariance
is that of this estimator under the whole posterior of the noise (a sandwich), not only under the likeliest noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import VANISHING, Floats
from micah_plan.automaton.joint import Joint, ParameterCovariance
from micah_plan.learning.joints.conservative_covariance import conservative_covariance
from micah_plan.learning.joints.error_contrasts import Contrasts, contrasts_of
from micah_plan.learning.joints.gauss_newton import UNKNOWN, descended
from micah_plan.learning.joints.parametrization import PITCH_NUMBER, JointChart, Seen, chart_of, seen_by, stepped
from micah_plan.learning.joints.tracker_noise import ErrorPosterior, NoiseVariances

_STEPS = 25


@dataclass(frozen=True, eq=False)
class JointFit:
    """A joint with the rows of its fit, in its frame."""

    joint: Joint
    chart: JointChart
    seen: Seen
    contrasts: list[Contrasts]


def seen_with(joint: Joint, position: Floats, quaternion: Floats | None, noise: NoiseVariances) -> JointFit:
    """A joint as given, with rows (n, 3), (n, 4)."""
    rotation_std, position_std = noise.stds
    compared = seen_by(joint, position, quaternion, position_std / rotation_std)
    return JointFit(joint, chart_of(joint, quaternion is not None), compared, contrasts_of(joint, compared, noise.stds))


def fit_likelihood(
    joint: Joint, position: Floats, quaternion: Floats | None, noise: NoiseVariances, converged: float = 1e-6
) -> JointFit:
    """The maximum-likelihood joint for rows (n, 3), (n, 4), from a start of the same kind.

    Args:
        converged: it stops where the next step promises less than that [nats].
    """

    def look(trial: Joint) -> _DescentState:
        fit = seen_with(trial, position, quaternion, noise)
        return _DescentState(fit, *normal_equations(fit, noise), look)

    return descended(look(joint), _STEPS, converged).fit


@dataclass(frozen=True, eq=False)
class _DescentState:
    """State of the descent of a joint, with its residuals and derivatives."""

    fit: JointFit
    information: Floats
    pull: Floats
    cost: float
    look: Callable[[Joint], _DescentState]

    def moved(self, step: Floats) -> _DescentState | None:
        joint = stepped(self.fit.joint, self.fit.chart, step)
        return None if joint is None else self.look(joint)


def parameter_covariance(fit: JointFit, noise: NoiseVariances, posterior: ErrorPosterior) -> ParameterCovariance:
    """Covariance of a fitted joint's parameters: weights of one noise, errors of the posterior of errors.

    What the rows do not determine has a std of about 1 rad, 1 m or 1 m/rad.
    """
    information, _, _ = normal_equations(fit, noise)
    prior = np.eye(len(information)) / UNKNOWN**2
    spread = np.linalg.inv(information + prior)
    # In the joint's frame, independent of the base's.
    gain = fit.chart.in_frame @ spread
    matrix = fit.chart.turn.T @ error_covariance(fit, noise, posterior, gain, gain @ prior @ gain.T) @ fit.chart.turn
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    matrix = (vectors * np.maximum(values, 0.0)) @ vectors.T
    rows = (0.5 * (matrix + matrix.T)).tolist()
    return ParameterCovariance(fit.chart.names, tuple(tuple(row) for row in rows))


def error_covariance(
    fit: JointFit, noise: NoiseVariances, posterior: ErrorPosterior, gain: Floats, besides: Floats
) -> Floats:
    """(k, k) conservative covariance of quantities that errors change by a gain (k, p) times the gradient.

    Args:
        besides: (k, k) covariance that they have anyway.
    """
    noisy, missed, sizes = _errors(fit, noise, posterior, gain)
    noisy = noisy + besides
    mean = sizes @ posterior.chance
    matrix = noisy + mean[0] * missed[0] + mean[1] * missed[1]
    variances = np.diag(noisy) + sizes.T @ np.stack([np.diag(variance) for variance in missed])
    std = np.sqrt(np.maximum(variances, 0.0))
    return conservative_covariance(matrix, posterior.chance, np.zeros_like(std), std)


def pitch_log_odds(fit: JointFit, posterior: ErrorPosterior, typical: float) -> float:
    """Log odds of the fitted screw against the hinge with pitch 0, at even prior odds [nats].

    Both share the other parameters and the errors, so the odds are the ratio of the densities of pitch 0 before and
    after the rows (Dickey, Annals of Mathematical Statistics 1971).

    Args:
        fit: under the likeliest noise of the posterior.
        typical: prior std of the pitch of a screw [m/rad].
    """
    noise = posterior.likeliest
    information, _, _ = normal_equations(fit, noise)
    prior = np.eye(len(information)) / UNKNOWN**2
    gain = (fit.chart.in_frame @ np.linalg.inv(information + prior))[PITCH_NUMBER][None]
    noisy, missed, sizes = _errors(fit, noise, posterior, gain)
    noisy = noisy + gain @ prior @ gain.T
    variances = noisy[0, 0] + sizes[0] * missed[0][0, 0] + sizes[1] * missed[1][0, 0]

    def log_density(variance: Floats) -> float:
        weighed = posterior.chance * np.exp(-0.5 * (fit.joint.pitch**2 / variance)) / np.sqrt(variance)
        return float(np.log(max(weighed.sum(), VANISHING)))

    return log_density(variances + typical**2) - log_density(variances)


def _errors(
    fit: JointFit, noise: NoiseVariances, posterior: ErrorPosterior, gain: Floats
) -> tuple[Floats, list[Floats], Floats]:
    """(k, k) covariances of quantities with gain (k, p), and (2, s) variances of misfits.

    By noise, and by misfits of variance 1 of positions and of rotations.
    """
    by_position, by_rotation = _sensitivities(fit, noise)
    within = gain @ fit.chart.in_frame.T
    noisy = within @ _noise_pull(by_position, by_rotation, posterior) @ within.T
    missed = [within @ _misfit_pull(pull, posterior.modes) @ within.T for pull in (by_position, by_rotation)]
    return noisy, missed, np.stack([posterior.position, posterior.rotation])


def normal_equations(fit: JointFit, noise: NoiseVariances) -> tuple[Floats, Floats, float]:
    """Information (p, p) and gradient (p,) of the free parameters, and the cost [nats]."""
    size = fit.contrasts[0].design.shape[2] + 1
    gram = np.zeros((size, size))
    for contrast in fit.contrasts:
        both = np.concatenate([contrast.design, contrast.error[:, :, None]], axis=2)
        gram += both.reshape(-1, size).T @ _weighted(both, contrast, noise).reshape(-1, size)
    within = fit.chart.in_frame
    return within.T @ gram[:-1, :-1] @ within, within.T @ gram[:-1, -1], 0.5 * float(gram[-1, -1])


def _weighted(columns: Floats, contrast: Contrasts, noise: NoiseVariances) -> Floats:
    """Σ⁻¹ times columns (n, k, m)."""
    white, wander = noise.of(contrast)
    if noise.process is None or wander <= 0:
        return columns / white
    flat = columns.reshape(len(columns), -1)
    return np.asarray(noise.process.whiten(wander / white, flat).reshape(columns.shape) / white)


def _sensitivities(fit: JointFit, noise: NoiseVariances) -> tuple[Floats, Floats]:
    """(n, 3, 11) weighted sensitivities of the parameters to errors of positions and of rotations."""
    n, _, p = fit.contrasts[0].design.shape
    by_position, by_rotation = np.zeros((n, 3, p)), np.zeros((n, 3, p))
    for contrast in fit.contrasts:
        weighted = _weighted(contrast.design, contrast, noise)
        if contrast.position is not None:
            by_position += contrast.position.transpose(0, 2, 1) @ weighted
        if contrast.rotation is not None:
            by_rotation += contrast.rotation.transpose(0, 2, 1) @ weighted
    return by_position, by_rotation


def _noise_pull(by_position: Floats, by_rotation: Floats, posterior: ErrorPosterior) -> Floats:
    """(p, p) covariance of the gradient due to the tracker's noise."""
    n, _, p = by_position.shape
    total = np.zeros((p, p))
    for probability, noise in posterior.noises:
        for columns, white, wander in (
            (by_position, noise.position_white, noise.position_wander),
            (by_rotation, noise.rotation_white, noise.rotation_wander),
        ):
            flat = columns.reshape(-1, p)
            total += probability * white * (flat.T @ flat)
            if noise.process is not None and wander > 0:
                wandered = noise.process.covariance_times(columns.reshape(n, -1))
                total += probability * wander * (flat.T @ wandered.reshape(-1, p))
    return total


def _misfit_pull(columns: Floats, modes: Floats) -> Floats:
    """(p, p) covariance of the gradient (n, 3, p) due to a misfit of variance 1 in every direction."""
    pulled = np.tensordot(modes, columns, axes=(0, 0)).reshape(-1, columns.shape[2])
    return np.asarray(pulled.T @ pulled)
