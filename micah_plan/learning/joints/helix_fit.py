"""Final fit of a screw from positions only, marginalised over the lead angle.

A short arc of a helix is hardly distinguishable from a circle, or from a tight helix that follows the tracker's wander:
the likelihood of the lead angle is wide and has several peaks, and each alone would be overconfident. So the other
parameters are fitted at each of many angles, and these are compared with the noise integrated out: one angle's wander
is another's motion. The result is the median angle; its covariance includes all others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from micah_plan.arrays import Floats
from micah_plan.automaton.joint import Joint, ParameterCovariance
from micah_plan.learning.joints.conservative_covariance import conservative_covariance
from micah_plan.learning.joints.gauss_newton import UNKNOWN, descended
from micah_plan.learning.joints.helix import NUMBERS, Helix, chart_slopes, helix_of
from micah_plan.learning.joints.likelihood import JointFit, error_covariance, normal_equations, seen_with
from micah_plan.learning.joints.parametrization import JointChart, chart_of, cross, seen_by
from micah_plan.learning.joints.tracker_noise import NoiseVariances, Scales, log_evidence, noise_of, wanders
from micah_plan.learning.joints.tracker_wander import OrnsteinUhlenbeck

_LEADS = np.radians(np.linspace(-84.0, 84.0, 9))  # rad; lead angles tried all over the range
_STDS = (-2.6, -1.5, -0.7, 0.0, 0.7, 1.5, 2.6)  # around the likeliest angle
_BETWEEN = 10  # angles for each that was tried, interpolated
_STEPS = 6  # of Gauss and Newton at one angle
_FIRST_STEPS = 25  # from the start
_CONVERGED = 0.01  # nats
_LARGEST_TURN = 0.5  # rad, of one step
_LEAST_CURVATURE = 0.3  # of what it was, after one step


@dataclass(frozen=True, eq=False)
class _HelixAtLead:
    """A helix fitted at a fixed lead angle, with derivatives (p, 7) of its joint's parameters."""

    helix: Helix
    fit: JointFit
    slopes: Floats
    information: Floats
    cost: float


@dataclass(frozen=True, eq=False)
class _Rows:
    position: Floats
    wanders: list[OrnsteinUhlenbeck]
    scales: Scales
    like: Joint


def fit_helix(
    start: Joint, position: Floats, time: Floats, noise: NoiseVariances, scales: Scales
) -> tuple[Joint, NoiseVariances] | None:
    """The screw of the median lead angle with its covariance and noise; None for a straight path.

    Args:
        start: a screw near the rows, of any lead angle; the answer counts from where it counts.
        position, time: (n, 3) [m] and (n,) [s] of rows without outliers.
        noise: rough one.
        scales: of noise and misfit.
    """
    compared = seen_by(start, position, None, 1.0)
    middle = float(np.mean(compared.configuration)) * float(np.hypot(compared.radius, start.pitch))
    helix, rows = helix_of(start, middle), _Rows(position, wanders(time), scales, start)
    if helix is None:
        return None
    first = _fitted(helix, rows, noise, NUMBERS, _FIRST_STEPS)
    tried = _over_leads(first, rows, noise)
    log_density = [_log_density(trial, rows) for trial in tried]
    highest = int(np.argmax(log_density))
    likelier = log_density[highest] > _log_density(first, rows)
    best = _fitted(tried[highest].helix, rows, noise, NUMBERS) if likelier else first
    std = float(np.linalg.inv(best.information + np.eye(NUMBERS) / UNKNOWN**2)[-1, -1]) ** 0.5
    tried += _at(best, best.helix.lead + std * np.array(_STDS), rows, noise)
    log_density += [_log_density(trial, rows) for trial in tried[len(log_density) :]]
    leads, order = np.unique([trial.helix.lead for trial in tried], return_index=True)
    tried = [tried[i] for i in order]
    lead, chance = _lead_probabilities(leads, np.array(log_density)[order])
    middle = float(np.interp(0.5, np.cumsum(chance) - 0.5 * chance, lead))
    nearest = min(tried, key=lambda trial: abs(trial.helix.lead - middle))
    (median,) = _at(nearest, np.array([middle]), rows, noise)
    posterior = noise_of(
        median.fit.contrasts, median.fit.chart.in_frame, time, median.fit.seen.configuration, noise.stds, scales
    )
    if posterior is None:
        return None
    noise = posterior.likeliest
    median = _fitted(median.helix, rows, noise, NUMBERS - 1)
    slopes, prior = median.slopes[:, :-1], np.eye(NUMBERS - 1) / UNKNOWN**2
    spread = np.linalg.inv(median.information[:-1, :-1] + prior)
    spread = error_covariance(median.fit, noise, posterior, spread @ slopes.T, spread @ prior @ spread)
    return _over_all_leads(median, tried, chance, spread, start), noise


def _over_leads(start: _HelixAtLead, rows: _Rows, noise: NoiseVariances) -> list[_HelixAtLead]:
    """Helices fitted over the range of lead angles, each started from its neighbour."""
    upwards = start.helix.lead < _LEADS
    return _at(start, _LEADS[upwards], rows, noise) + _at(start, _LEADS[~upwards][::-1], rows, noise)


def _at(start: _HelixAtLead, leads: Floats, rows: _Rows, noise: NoiseVariances) -> list[_HelixAtLead]:
    """Helices fitted at given lead angles, each started from the previous one."""
    trials: list[_HelixAtLead] = []
    for lead in leads.tolist():
        before = trials[-1] if trials else start
        away = lead - before.helix.lead
        # Where the others go as the angle goes: along the valley of the likelihood.
        others = np.linalg.lstsq(before.information[:-1, :-1], -away * before.information[:-1, -1], rcond=1e-12)[0]
        step = np.append(_shortened(others, before.helix), away)
        helix = before.helix.moved(step) or before.helix.moved(np.append(np.zeros(NUMBERS - 1), away))
        if helix is not None:
            trials.append(_fitted(helix, rows, noise, NUMBERS - 1))
    return trials


def _fitted(helix: Helix, rows: _Rows, noise: NoiseVariances, free: int, steps: int = _STEPS) -> _HelixAtLead:
    """The helix after Gauss-Newton steps of the first parameters."""
    return descended(_Descent(*_with_gradient(helix, rows, noise), rows, noise, free), steps, _CONVERGED).tried


@dataclass(frozen=True, eq=False)
class _Descent:
    """State of the descent of a helix towards maximum likelihood, with some parameters free."""

    tried: _HelixAtLead
    whole_pull: Floats
    rows: _Rows
    noise: NoiseVariances
    free: int

    @property
    def information(self) -> Floats:
        return self.tried.information[: self.free, : self.free]

    @property
    def pull(self) -> Floats:
        return self.whole_pull[: self.free]

    @property
    def cost(self) -> float:
        return self.tried.cost

    def moved(self, step: Floats) -> _Descent | None:
        """The descent after a step, if it lowers the cost; else None."""
        helix = self.tried.helix.moved(_shortened(step, self.tried.helix))
        if helix is None:
            return None
        return _Descent(*_with_gradient(helix, self.rows, self.noise), self.rows, self.noise, self.free)


def _shortened(step: Floats, helix: Helix) -> Floats:
    """A step limited to the valid range of the frame's parameters."""
    share = min(1.0, _LARGEST_TURN / max(float(np.linalg.norm(step[:3])), 1e-12))
    if step[5] < 0:
        share = min(share, (1 - _LEAST_CURVATURE) * helix.curvature / -float(step[5]))
    return share * step


def _with_gradient(helix: Helix, rows: _Rows, noise: NoiseVariances) -> tuple[_HelixAtLead, Floats]:
    """A helix with its gradient (7,) on the rows."""
    joint = helix.joint(0.0, rows.like)
    fit = seen_with(joint, rows.position, None, noise)
    information, pull, cost = normal_equations(fit, noise)
    slopes = chart_slopes(helix, 0.0, joint, fit.chart)
    return _HelixAtLead(helix, fit, slopes, slopes.T @ information @ slopes, cost), slopes.T @ pull


def _log_density(trial: _HelixAtLead, rows: _Rows) -> float:
    """Log density of the lead angle, with other parameters and noise marginalised."""
    within = trial.fit.chart.in_frame @ trial.slopes[:, :-1]
    return log_evidence(trial.fit.contrasts, within, rows.wanders, trial.fit.seen.configuration, rows.scales)


def _lead_probabilities(leads: Floats, log_density: Floats) -> tuple[Floats, Floats]:
    """(f,) angles between the candidates (m,), sorted, and their probabilities under a flat prior."""
    fine = _interpolation(len(leads)) @ leads
    log_fine = PchipInterpolator(leads, log_density)(fine)
    chance = np.gradient(fine) * np.exp(log_fine - log_fine.max())
    return fine, np.asarray(chance / chance.sum())


def _interpolation(points: int) -> Floats:
    """(f, m) matrix that interpolates values between neighbours, evenly."""
    at = np.linspace(0, points - 1, _BETWEEN * points)
    return np.asarray(np.maximum(1 - np.abs(at[:, None] - np.arange(points)), 0.0))


def _over_all_leads(
    median: _HelixAtLead, tried: Sequence[_HelixAtLead], chance: Floats, spread: Floats, start: Joint
) -> Joint:
    """A fitted screw relative to a start, with its covariance over all lead angles.

    Args:
        tried: fits in order of their angles.
        chance: (f,) probabilities of angles between these.
        spread: (6, 6) covariance of the numbers but the angle.

    The stds are such that 1.96 of them hold 95 %: the curves are no straight lines.
    """
    joint, chart, _ = _counted_from(median, start)
    values, vectors = np.linalg.eigh(spread)
    roots = vectors * np.sqrt(np.maximum(values, 0.0))
    turn = chart.turn  # in the joint's frame, independent of the base's
    offs, all_slopes = [], []
    for trial in tried:
        recounted, other_chart, slopes = _counted_from(trial, start)
        offs.append(turn @ _difference(recounted, joint, chart))
        all_slopes.append(turn @ _carried(recounted, other_chart, joint, chart) @ slopes[:, :-1] @ roots)
    between = _interpolation(len(tried))
    off, slope = between @ np.array(offs), np.tensordot(between, all_slopes, 1)
    matrix = (chance[:, None] * off).T @ off + np.einsum("i,ijr,ikr->jk", chance, slope, slope)
    matrix = turn.T @ conservative_covariance(matrix, chance, off, np.sqrt((slope**2).sum(axis=2))) @ turn
    rows = (0.5 * (matrix + matrix.T)).tolist()
    return replace(joint, covariance=ParameterCovariance(chart.names, tuple(tuple(row) for row in rows)))


def _counted_from(trial: _HelixAtLead, start: Joint) -> tuple[Joint, JointChart, Floats]:
    """A fitted screw with its origin closest to another's, its chart, and derivatives (p, 7)."""
    c = float(seen_by(trial.fit.joint, np.array([start.position]), None, 1.0).configuration[0])
    length = -c * trial.helix.width
    joint = trial.helix.joint(length, start)
    chart = chart_of(joint, False)
    return joint, chart, chart_slopes(trial.helix, length, joint, chart)


def _carried(source: Joint, chart: JointChart, joint: Joint, here: JointChart) -> Floats:
    """(k, p) derivative of the named parameters of a joint with chart `here` by another chart's parameters."""
    axis = np.array(source.axis)
    side = 1.0 if float(axis @ joint.axis) >= 0 else -1.0
    across = here.free[5:, 5:]
    carried = np.zeros((len(here.free), chart.free.shape[1]))
    tilted = [cross(np.array(joint.axis), side * cross(tilt, axis)) for tilt in chart.basis]
    carried[:2, :2] = here.basis @ np.stack(tilted, axis=1)
    carried[2:4, 2:4] = here.basis @ chart.basis.T
    carried[4, 4] = 1.0
    carried[5:, 5:] = across @ across.T @ chart.free[5:, 5:]
    return carried


def _difference(source: Joint, joint: Joint, chart: JointChart) -> Floats:
    """(k,) named parameters of a screw minus those of a joint, relative to its point closest to the origin."""
    compared = seen_by(source, np.array([joint.position]), None, 1.0)
    c = float(compared.configuration[0])
    radial, axis = np.cos(c) * compared.frame[0] + np.sin(c) * compared.frame[1], np.array(source.axis)
    center = np.array(source.center) + source.pitch * c * axis
    side = 1.0 if float(axis @ joint.axis) >= 0 else -1.0
    across = chart.free[5:, 5:]
    return np.concatenate(
        [
            chart.basis @ cross(np.array(joint.axis), side * axis),
            chart.basis @ (center - joint.center),
            [source.pitch - joint.pitch],
            across @ across.T @ (center + compared.radius * radial - joint.position),
        ]
    )
