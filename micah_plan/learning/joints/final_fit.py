"""Final fit of a joint to all rows of its segments: robust maximum likelihood with an honest covariance.

A mixture with outliers selects the inliers, starting with the likelier of the guess and the closed form; generalized
least squares on SE(3) under the resulting noise finds the joint. Whether a hinge advances as it turns is decided here,
by all rows: an assumed tracker wander hides a thread of a millimetre.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from micah_plan.arrays import Floats
from micah_plan.automaton.certainty import Deviation
from micah_plan.automaton.joint import KINDS, Joint, JointKind, twisting
from micah_plan.automaton.kinematics import ROTATION_LENGTH, reversed_direction, shifted
from micah_plan.learning.joints.helix_fit import fit_helix
from micah_plan.learning.joints.joint_arrays import arrays_of, concatenated_joints
from micah_plan.learning.joints.likelihood import (
    JointFit,
    fit_likelihood,
    parameter_covariance,
    pitch_log_odds,
    seen_with,
)
from micah_plan.learning.joints.linear_fits import linear_fits
from micah_plan.learning.joints.mixture import Mixtures, Sort, fit_mixtures
from micah_plan.learning.joints.parametrization import seen_by
from micah_plan.learning.joints.residuals import compare_arrays
from micah_plan.learning.joints.tracker_noise import ErrorPosterior, NoiseVariances, Scales, noise_of, white_noise
from micah_plan.learning.settings import LearnSettings

# Nats: one in fifteen joints is a screw. That a hinge is taken for one is the worse mistake of the two: real hinges are
# not ideal. So a screw is chosen as if there were one in a hundred, and said so where all poses are asked.
RARE_SCREW, SCREW_COST = 2.7, 4.6
PITCH = 0.1  # m/rad; prior std of a screw's pitch
_LEAST_STDS = (1e-5, 1e-6)  # rad, m
_ROTATION_SPAN = 2 * np.pi
_POSITION_SPAN = 1.0  # m, where the rows span less
_STARTING_ROWS = 100  # no start needs more
_MOST_PITCH_ROWS = 256  # of a hinge that may be a screw
_VOTES = 3  # times the fewest rows of a joint; with fewer rows none is doubted
_ROUNDS = 2  # of noise and joint alternately
_ROUGH = 0.05  # nats
_FAR = 4.0  # stds that better weights may move an axis by


@dataclass(frozen=True)
class LackOfFit:
    """Evidence of all rows against a fitted joint.

    Attributes:
        screw_log_odds: of a screw against the hinge, with equal priors; None where neither was requested.
        deviation: how far the part leaves the joint; None where it does not move, or the rows are too few.
    """

    screw_log_odds: float | None = None
    deviation: Deviation | None = None


NO_LACK_OF_FIT = LackOfFit()


@dataclass(frozen=True, eq=False)
class FittedJoint:
    """A joint fitted to rows.

    Attributes:
        joint: with the covariance of its parameters; without it where there are too few rows to separate noise from
            motion.
        inlier: (n,) probability that a row is no outlier.
        outlier_ratio: γ, the share of outliers.
        position_std: total std of a position per axis [m], white and wandering.
        rotation_std: the same of a rotation [rad]; 0 without orientations.
        log_likelihood: of the mixture, with the prior of γ, rows taken as independent.
        lack_of_fit: evidence of the rows against it.
    """

    joint: Joint
    inlier: Floats
    outlier_ratio: float
    position_std: float
    rotation_std: float
    log_likelihood: float
    lack_of_fit: LackOfFit = NO_LACK_OF_FIT


def fit_joint(
    guess: Joint,
    position: Floats,
    quaternion: Floats | None,
    time: Floats,
    weight: Floats,
    settings: LearnSettings | None = None,
) -> FittedJoint:
    """The maximum-likelihood joint of the guess's kind, or the screw that a hinge turns out to be.

    Args:
        guess: a joint of the kind to fit; it competes with the other starts, is the result where there are too few
            rows, and defines the zero and the direction of configurations. Where orientations are measured, all rows
            decide between hinge and screw; without them a short arc hardly determines its lead angle (`helix_fit`).
        position, quaternion: (n, 3) [m] and (n, 4) scalar last, of any sign; quaternion None if not measured.
        time: (n,) [s] of the rows, in any order; pauses between segments are welcome.
        weight: (n,) probability that a row can be trusted at all; rows of 0.5 or less are not looked at.
        settings: prior of outliers, size of a joint's misfit; None: the defaults.
    """
    settings = settings or LearnSettings()
    rows = _Rows(position, _units(quaternion), weight, settings.outlier_weight)
    used = np.flatnonzero(weight > 0.5)
    need = minimal_rows(guess.kind, quaternion is not None)
    if len(used) <= need:
        return rows.evaluated(guess)
    used = used[np.argsort(time[used], kind="stable")]
    # So few rows cannot outvote one another: any that a joint is drawn through would be its only inliers.
    trusting = len(used) < _VOTES * need
    start, stds = _best_start(guess, rows, used)
    believed = _fit_to_inliers(start, stds, rows, used, trusting)
    if believed is None:
        return rows.evaluated(start)
    fit, kept, stds = believed
    scales = Scales(_LEAST_STDS, (settings.rotation_misfit, settings.position_misfit))
    posterior = _posterior_of_residuals(fit, time[kept], stds, scales)
    if posterior is None:
        return rows.evaluated(fit.joint)
    log_odds = None
    if rows.quaternion is not None and KINDS[guess.kind].turns and {"revolute", "screw"} <= set(settings.kinds):
        chosen = _hinge_or_screw(fit.joint, (position[kept], rows.quaternion[kept]), time[kept], stds, scales)
        log_odds = None if chosen is None else chosen[1]
        if chosen is not None and chosen[0].kind != fit.joint.kind:
            fit = fit_likelihood(chosen[0], *rows.of(kept), white_noise(stds), _ROUGH)
            posterior = _posterior_of_residuals(fit, time[kept], stds, scales) or posterior
    noise = posterior.likeliest
    before = _in_parametrisation_of(fit.joint, guess, quaternion is not None)
    helix = None
    if fit.joint.kind == "screw" and quaternion is None:
        helix = fit_helix(before, position[kept], time[kept], noise, scales)
    joint, noise = helix or (_refined(before, *rows.of(kept), noise, posterior), noise)
    evaluated = _fitted(joint, rows.mixture(joint, noise.stds), quaternion is not None)
    rotation_std = noise.stds[0] if quaternion is not None else 0.0
    lack_of_fit = LackOfFit(log_odds, _deviation(posterior, scales) if joint.moves else None)
    return replace(evaluated, position_std=noise.stds[1], rotation_std=rotation_std, lack_of_fit=lack_of_fit)


def _deviation(posterior: ErrorPosterior, scales: Scales) -> Deviation:
    """Distance of a part from its joint, from the residuals of a fit."""
    sizes = np.sqrt([posterior.rotation, posterior.position])
    unusual = (sizes > np.array(scales.misfit)[:, None]).any(axis=0)
    rotation, position = sizes @ posterior.chance
    return Deviation(float(position), float(rotation), float(posterior.chance[unusual].sum()))


def _posterior_of_residuals(
    fit: JointFit, time: Floats, stds: tuple[float, float], scales: Scales
) -> ErrorPosterior | None:
    return noise_of(fit.contrasts, fit.chart.in_frame, time, fit.seen.configuration, stds, scales)


def _hinge_or_screw(
    joint: Joint, rows: tuple[Floats, Floats], time: Floats, stds: tuple[float, float], scales: Scales
) -> tuple[Joint, float] | None:
    """(hinge or screw near a joint that turns, log odds of the screw); None with too few rows.

    Args:
        rows, time: positions (n, 3), quaternions (n, 4) and their times (n,) [s].
    """
    # Rows that are interpolated, or filtered by the tracker, repeat one another.
    sample = np.linspace(0, len(time) - 1, min(len(time), _MOST_PITCH_ROWS)).round().astype(int)
    start = twisting("screw", joint.axis, joint.center, joint.pitch, joint.position, joint.quaternion)
    fit = fit_likelihood(start, rows[0][sample], rows[1][sample], white_noise(stds), _ROUGH)
    posterior = _posterior_of_residuals(fit, time[sample], stds, scales)
    if posterior is None:
        return None
    fit = fit_likelihood(fit.joint, rows[0][sample], rows[1][sample], posterior.likeliest, _ROUGH)
    log_odds = pitch_log_odds(fit, posterior, PITCH)
    kind: JointKind = "screw" if log_odds > SCREW_COST else "revolute"
    at = fit.joint if kind == "screw" else joint
    return twisting(kind, at.axis, at.center, at.pitch, at.position, at.quaternion), log_odds


def _refined(
    before: Joint,
    position: Floats,
    quaternion: Floats | None,
    noise: NoiseVariances,
    posterior: ErrorPosterior,
) -> Joint:
    """The maximum-likelihood joint with its covariance; the previous one if the likelihood diverges from it."""
    fit = fit_likelihood(before, position, quaternion, noise)
    joint = replace(fit.joint, covariance=parameter_covariance(fit, noise, posterior))
    if _is_off_unweighted_axis(joint, before):
        fit = seen_with(before, position, quaternion, noise)
        joint = replace(before, covariance=parameter_covariance(fit, noise, posterior))
    return joint


def _is_off_unweighted_axis(joint: Joint, before: Joint) -> bool:
    """Whether the axis is farther from the unweighted one than its covariance allows.

    Where one direction is much noisier than the others, a free configuration along it explains that noise, and the
    motion is taken as wander: a likelihood with one noise for all directions then has another, false optimum.
    """
    if not joint.moves or joint.covariance is None:
        return False
    if not joint.turns:
        return True  # weights change little there, and only positions determine the axis
    turned = float(np.arccos(min(1.0, abs(float(np.dot(joint.axis, before.axis))))))
    return turned > _FAR * float(np.sqrt(joint.covariance.matrix[0][0] + joint.covariance.matrix[1][1]))


@dataclass(frozen=True, eq=False)
class _Rows:
    position: Floats
    quaternion: Floats | None
    weight: Floats
    outlier_weight: float

    def of(self, index: NDArray[np.int64]) -> tuple[Floats, Floats | None]:
        """Positions and quaternions of some rows."""
        return self.position[index], None if self.quaternion is None else self.quaternion[index]

    def mixture(self, joint: Joint, stds: tuple[float, float]) -> Mixtures:
        """The mixture of inliers and outliers under a joint."""
        compared = seen_by(joint, self.position, self.quaternion, stds[1] / stds[0])
        return self.mixtures(joint.kind, [square[None] for square in compared.squares()], self.weight)

    def mixtures(self, kind: JointKind, squares: list[Floats], weight: Floats) -> Mixtures:
        """The mixtures of squared errors (h, n), of positions and, where measured, of rotations."""
        moves, turning = KINDS[kind].moves, KINDS[kind].turns
        has_orientation = len(squares) > 1
        # What a row's configuration takes from its errors; a turn shares it between position and rotation.
        shared = 0.5 if turning and has_orientation else float(moves)
        far = self.position - self.position.mean(axis=0)
        span = max(_POSITION_SPAN, 2 * float(np.sqrt(np.einsum("ij,ij->i", far, far).max())))
        sorts = [Sort(squares[0], 3 - shared, span, _LEAST_STDS[1])]
        if has_orientation:
            sorts.append(Sort(squares[1], 2.5 if turning else 3.0, _ROTATION_SPAN, _LEAST_STDS[0]))
        return fit_mixtures(sorts, weight, self.outlier_weight)

    def evaluated(self, joint: Joint) -> FittedJoint:
        """A joint as given, without covariance, with the rows evaluated on it."""
        bare = replace(joint, covariance=None)
        if not (self.weight > 0.5).any():
            return FittedJoint(bare, np.zeros(len(self.weight)), 0.0, 0.0, 0.0, 0.0)
        return _fitted(bare, self.mixture(joint, (1.0, ROTATION_LENGTH)), self.quaternion is not None)


def _best_start(guess: Joint, rows: _Rows, used: NDArray[np.int64]) -> tuple[Joint, tuple[float, float]]:
    """The likeliest of the guess and the closed form, on some of the rows."""
    sample = used[np.linspace(0, len(used) - 1, min(len(used), _STARTING_ROWS)).round().astype(int)]
    p, q = rows.of(sample)
    linear, fixed = linear_fits([guess.kind], np.ones((1, len(sample)), dtype=bool), p, q)
    starts = concatenated_joints(
        [arrays_of([guess, _moved_to_middle_row(guess, p, q)]), linear.take(np.flatnonzero(fixed))]
    )
    error = compare_arrays(starts, p, q, ROTATION_LENGTH).error
    squares = [(error[:, -3:] ** 2).sum(axis=1)]
    if q is not None:
        squares.append((error[:, :3] ** 2).sum(axis=1))
    scored = rows.mixtures(guess.kind, squares, rows.weight[sample])
    best = int(np.argmax(scored.log_likelihood))
    return starts.joint(best) if best else guess, _stds(scored, best)


def _fit_to_inliers(
    joint: Joint, stds: tuple[float, float], rows: _Rows, used: NDArray[np.int64], trusting: bool
) -> tuple[JointFit, NDArray[np.int64], tuple[float, float]] | None:
    """(fit, rows, stds) of a joint fitted to the rows that agree with it; None with too few."""
    fit, kept = None, used[:0]
    for _ in range(_ROUNDS):
        before = kept
        mixture = rows.mixture(joint, stds)
        stds = _stds(mixture)
        kept = used if trusting else used[mixture.inlier[0, used] > 0.5]
        if len(kept) <= minimal_rows(joint.kind, rows.quaternion is not None):
            return None
        if fit is not None and np.array_equal(kept, before):
            break
        fit = fit_likelihood(joint, *rows.of(kept), white_noise(stds), _ROUGH)
        joint = fit.joint
    return None if fit is None else (fit, kept, stds)


def _moved_to_middle_row(guess: Joint, position: Floats, quaternion: Floats | None) -> Joint:
    """The guess moved to the middle row, as a start even where the rows determine no joint of its kind."""
    row = int(np.argmin(((position - np.median(position, axis=0)) ** 2).sum(axis=1)))
    shift = position[row] - guess.position
    center = tuple((guess.center + shift).tolist()) if guess.turns else guess.center
    turned = guess.quaternion if quaternion is None else tuple(quaternion[row].tolist())
    return replace(guess, position=tuple(position[row].tolist()), center=center, quaternion=turned)


def _in_parametrisation_of(joint: Joint, guess: Joint, has_orientation: bool) -> Joint:
    """The same motion with the direction and origin of the guess."""
    if not joint.moves:
        return replace(joint, fixed_at=guess.fixed_at)
    if np.dot(joint.axis, guess.axis) < 0:
        joint = reversed_direction(joint)
    quaternion = np.array([guess.quaternion]) if has_orientation else None
    (c,) = seen_by(joint, np.array([guess.position]), quaternion, ROTATION_LENGTH).configuration
    return shifted(joint, float(c))


def _fitted(joint: Joint, mixtures: Mixtures, has_orientation: bool) -> FittedJoint:
    rotation_std, position_std = _stds(mixtures)
    return FittedJoint(
        joint,
        mixtures.inlier[0],
        float(mixtures.ratio[0]),
        position_std,
        rotation_std if has_orientation else 0.0,
        float(mixtures.log_likelihood[0]),
    )


def _stds(mixtures: Mixtures, number: int = 0) -> tuple[float, float]:
    """Std of a rotation (1 rad where not measured) and of a position under one of the joints."""
    rotation = float(mixtures.stds[1][number]) if len(mixtures.stds) > 1 else 1.0
    return rotation, float(mixtures.stds[0][number])


def _units(quaternion: Floats | None) -> Floats | None:
    """Normalised quaternions; their signs are arbitrary."""
    if quaternion is None:
        return None
    return np.asarray(quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True))


def minimal_rows(kind: JointKind, has_orientation: bool) -> int:
    """Number of rows that determine a joint: 1 pose for rigid, 2 poses else; 3 positions for a circle."""
    freedom = KINDS[kind]
    return 3 if freedom.turns and not has_orientation else 2 if freedom.moves else 1
