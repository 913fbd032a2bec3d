"""The last fit of a screw that only positions show, over every lead angle that they allow.

A short arc of a helix is hardly told from a circle, nor from a tight helix that follows the tracker's wander: the
likelihood of the lead angle is wide and has several peaks, and each of these, taken for the answer, is too sure of
itself. So the other numbers are fitted at each of many angles, and these are compared with the noise integrated out:
what is wander to one is motion to another. The answer is the median angle; its covariance holds all the others.

**A screw as positions show it.** The frame of its path at one point, the path's curvature, and its lead angle.

A piece of a helix shows its tangent, its curvature and its torsion one after the other, each less clearly than the one
before. Axis, centre and pitch are made of all of these. In the frame of the path only one number is hard to tell: the
lead angle, whose tangent is torsion by curvature, and pitch by radius.

Source: do Carmo, Differential Geometry of Curves and Surfaces, 1976, section 1-5 (Frenet's frame).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from micah_plan.arrays import DIFFERENCE, Floats
from micah_plan.automaton.joint import Joint, ParameterCovariance, screw
from micah_plan.learning.joints.joint_arrays import rotated, rotation_quaternion
from micah_plan.learning.joints.likelihood import (
    UNKNOWN,
    JointFit,
    descended,
    error_covariance,
    normal_equations,
    seen_with,
)
from micah_plan.learning.joints.parametrization import JointChart, chart_of, cross, frame_of, seen_by
from micah_plan.learning.joints.tracker_noise import (
    NoiseVariances,
    OrnsteinUhlenbeck,
    Scales,
    conservative_covariance,
    log_evidence,
    noise_of,
    wanders,
)

_LEADS = np.radians(np.linspace(-84.0, 84.0, 9))  # rad; lead angles tried all over the range
_STDS = (-2.6, -1.5, -0.7, 0.0, 0.7, 1.5, 2.6)  # around the likeliest angle
_BETWEEN = 10  # angles for each that was tried, interpolated
_STEPS = 6  # of Gauss and Newton at one angle
_FIRST_STEPS = 25  # from the start
_CONVERGED = 0.01  # nats
_LARGEST_TURN = 0.5  # rad, of one step
_LEAST_CURVATURE = 0.3  # of what it was, after one step


@dataclass(frozen=True, eq=False)
class _Tried:
    """A helix fitted at one lead angle, with the slopes (p, 7) of its joint's free numbers."""

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
    """The screw of the median lead angle, with its covariance, and the noise that it leaves; None of a straight path.

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
    lead, chance = _chances(leads, np.array(log_density)[order])
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
    return _covered(median, tried, chance, spread, start), noise


def _over_leads(start: _Tried, rows: _Rows, noise: NoiseVariances) -> list[_Tried]:
    """Helices at angles all over the range, each fitted from its neighbour."""
    upwards = start.helix.lead < _LEADS
    return _at(start, _LEADS[upwards], rows, noise) + _at(start, _LEADS[~upwards][::-1], rows, noise)


def _at(start: _Tried, leads: Floats, rows: _Rows, noise: NoiseVariances) -> list[_Tried]:
    """Helices at lead angles, each fitted from the one before."""
    trials: list[_Tried] = []
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


def _fitted(helix: Helix, rows: _Rows, noise: NoiseVariances, free: int, steps: int = _STEPS) -> _Tried:
    """The helix after Gauss-Newton steps of the first numbers."""
    return descended(_Descent(*_seen(helix, rows, noise), rows, noise, free), steps, _CONVERGED).tried


@dataclass(frozen=True, eq=False)
class _Descent:
    """A helix on its way to the likeliest one, of which so many numbers are free."""

    tried: _Tried
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
        helix = self.tried.helix.moved(_shortened(step, self.tried.helix))
        if helix is None:
            return None
        return _Descent(*_seen(helix, self.rows, self.noise), self.rows, self.noise, self.free)


def _shortened(step: Floats, helix: Helix) -> Floats:
    """A step along which the frame's numbers mean something."""
    share = min(1.0, _LARGEST_TURN / max(float(np.linalg.norm(step[:3])), 1e-12))
    if step[5] < 0:
        share = min(share, (1 - _LEAST_CURVATURE) * helix.curvature / -float(step[5]))
    return share * step


def _seen(helix: Helix, rows: _Rows, noise: NoiseVariances) -> tuple[_Tried, Floats]:
    """A helix as it is, and the pull (7,) of the rows on its numbers."""
    joint = helix.joint(0.0, rows.like)
    fit = seen_with(joint, rows.position, None, noise)
    information, pull, cost = normal_equations(fit, noise)
    slopes = chart_slopes(helix, 0.0, joint, fit.chart)
    return _Tried(helix, fit, slopes, slopes.T @ information @ slopes, cost), slopes.T @ pull


def _log_density(trial: _Tried, rows: _Rows) -> float:
    """Ln density of the lead angle, all other numbers and the noise integrated out."""
    within = trial.fit.chart.in_frame @ trial.slopes[:, :-1]
    return log_evidence(trial.fit.contrasts, within, rows.wanders, trial.fit.seen.configuration, rows.scales)


def _chances(leads: Floats, log_density: Floats) -> tuple[Floats, Floats]:
    """Angles (f,) between those tried (m,), in order, and their probabilities; no angle is preferred beforehand."""
    fine = _interpolation(len(leads)) @ leads
    log_fine = PchipInterpolator(leads, log_density)(fine)
    chance = np.gradient(fine) * np.exp(log_fine - log_fine.max())
    return fine, np.asarray(chance / chance.sum())


def _interpolation(points: int) -> Floats:
    """(f, m) matrix that interpolates values between neighbours, evenly."""
    at = np.linspace(0, points - 1, _BETWEEN * points)
    return np.asarray(np.maximum(1 - np.abs(at[:, None] - np.arange(points)), 0.0))


def _covered(median: _Tried, tried: Sequence[_Tried], chance: Floats, spread: Floats, start: Joint) -> Joint:
    """A fitted screw, counted from where a start counts, with its covariance over all lead angles.

    Args:
        tried: fits in the order of their angles.
        chance: (f,) probabilities of angles between these.
        spread: (6, 6) covariance of the numbers but the angle.

    The stds are such that 1.96 of them hold 95 %: the curves are no straight lines.
    """
    joint, chart, _ = _counted_from(median, start)
    values, vectors = np.linalg.eigh(spread)
    roots = vectors * np.sqrt(np.maximum(values, 0.0))
    turn = chart.turn  # in the joint's frame nothing depends on the base's
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


def _counted_from(trial: _Tried, start: Joint) -> tuple[Joint, JointChart, Floats]:
    """A fitted screw whose origin is closest to that of another, its chart, and slopes (p, 7) there."""
    c = float(seen_by(trial.fit.joint, np.array([start.position]), None, 1.0).configuration[0])
    length = -c * trial.helix.width
    joint = trial.helix.joint(length, start)
    chart = chart_of(joint, False)
    return joint, chart, chart_slopes(trial.helix, length, joint, chart)


def _carried(source: Joint, chart: JointChart, joint: Joint, here: JointChart) -> Floats:
    """(k, p) named parameters of a joint with chart `here` per free number of another one's chart."""
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
    """(k,) named parameters of a screw less those of a joint, counted from where it comes closest to its origin."""
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


NUMBERS = 7  # turn of the frame (3) and shift across the path (2), both in the frame; curvature; lead angle
_FLATTEST = 1e-3  # 1/m; a straighter path has no frame
_STEEPEST = 1.55  # rad; a steeper path is straight


@dataclass(frozen=True, eq=False)
class Helix:
    """A helix at a point [m]: rows of its frame are tangent, normal and binormal.

    Attributes:
        curvature: of the path [1/m].
        lead: angle of the path against the plane across its axis [rad]; 0 on a circle.
    """

    point: Floats
    frame: Floats
    curvature: float
    lead: float

    @property
    def width(self) -> float:
        """Arc length per radian [m]."""
        return float(np.cos(self.lead)) / self.curvature

    @property
    def axis(self) -> Floats:
        """(3,) unit vector."""
        return np.asarray(np.sin(self.lead) * self.frame[0] + np.cos(self.lead) * self.frame[2])

    def moved(self, numbers: Floats) -> Helix | None:
        """After a step of the first of the `NUMBERS`; None where there is no such helix."""
        step = np.zeros(NUMBERS)
        step[: len(numbers)] = numbers
        curvature, lead = self.curvature + float(step[5]), self.lead + float(step[6])
        if curvature < _FLATTEST or abs(lead) > _STEEPEST:
            return None
        turned = np.asarray(rotated(rotation_quaternion(self.frame.T @ step[:3]), self.frame))
        return Helix(self.point + step[3:5] @ self.frame[1:], turned, curvature, lead)

    def joint(self, length: float, like: Joint) -> Joint:
        """The screw whose origin lies an arc length [m] before the point; its orientation is not looked at."""
        axis, center, pitch, position = _parts(self, length)
        return screw(axis, center, float(pitch[0]), position, like.quaternion)


def helix_of(joint: Joint, length: float) -> Helix | None:
    """A screw's path at an arc length [m] from its origin; None where it is straight."""
    frame, radius = frame_of(joint)
    square = radius**2 + joint.pitch**2
    if radius < _FLATTEST * square:
        return None
    width = float(np.sqrt(square))
    c = length / width
    axis = frame[2]
    outwards = np.cos(c) * frame[0] + np.sin(c) * frame[1]
    around = cross(axis, outwards)
    point = np.array(joint.center) + radius * outwards + joint.pitch * c * axis
    rows = [(radius * around + joint.pitch * axis) / width, -outwards, (radius * axis - joint.pitch * around) / width]
    lead = float(np.arctan2(joint.pitch, radius))
    return Helix(point, np.stack(rows), radius / square, float(np.clip(lead, -_STEEPEST, _STEEPEST)))


def chart_slopes(helix: Helix, length: float, joint: Joint, chart: JointChart) -> Floats:
    """(p, 7) free numbers of the screw (`chart_of` without orientations) per number of its helix."""
    slopes = np.zeros((chart.free.shape[1], NUMBERS))
    across = chart.free[5:, 5:].T
    turns, shifts = helix.frame, helix.frame[1:]
    # Turns and shifts of the path move the screw as a rigid body.
    slopes[:2, :3] = chart.basis @ turns.T
    slopes[2:4, :3] = chart.basis @ np.cross(turns, np.subtract(joint.center, helix.point)).T
    slopes[5:, :3] = across @ np.cross(turns, np.subtract(joint.position, helix.point)).T
    slopes[2:4, 3:5], slopes[5:, 3:5] = chart.basis @ shifts.T, across @ shifts.T
    for number, size in ((5, DIFFERENCE * helix.curvature), (6, DIFFERENCE)):
        step = np.zeros(NUMBERS)
        step[number] = size
        ahead, behind = (helix.moved(sign * step) for sign in (1.0, -1.0))
        if ahead is None or behind is None:
            continue
        slope = (np.concatenate(_parts(ahead, length)) - np.concatenate(_parts(behind, length))) / (2 * size)
        of_axis, of_center, of_pitch, of_position = np.split(slope, (3, 6, 7))
        tilt = cross(np.array(joint.axis), of_axis)
        slopes[:, number] = np.concatenate(
            [chart.basis @ tilt, chart.basis @ of_center, of_pitch, across @ of_position]
        )
    return slopes


def _parts(helix: Helix, length: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Axis, centre, pitch (1,) and position of the screw whose origin lies an arc length [m] before the point."""
    width, axis, outwards = helix.width, helix.axis, -helix.frame[1]
    radius, pitch, c = width * np.cos(helix.lead), width * float(np.sin(helix.lead)), -length / width
    center = helix.point - radius * outwards + pitch * c * axis
    return axis, center, np.array([pitch]), center + radius * (np.cos(c) * outwards + np.sin(c) * cross(axis, outwards))
