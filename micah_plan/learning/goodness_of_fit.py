"""Goodness of fit: alternatives for rows that the joints of an answer miss.

Real joints and trackers deviate from models. Where a result misses its rows by more than that, the part may move
freely, or along a path that no joint with a constant twist follows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from micah_plan.arrays import Booleans, Floats
from micah_plan.automaton.certainty import NoSingleJoint
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.kinematics import ROTATION_LENGTH, jacobian
from micah_plan.learning.paths import length_std, likeliest_path, principal_path
from micah_plan.learning.segmenting.free import (
    free_log_probability,
)
from micah_plan.learning.segmenting.noise import MeasurementNoise
from micah_plan.learning.segmenting.noise_fit import finest_stds, initial_noise, misses
from micah_plan.learning.segmenting.segmentation import best_single, under_noise
from micah_plan.learning.segmenting.segmented import Segmented
from micah_plan.learning.segments import FittedPiece, left_by, segment_configurations
from micah_plan.learning.settings import LearnSettings
from micah_plan.learning.track import PartTrack

_RARE = 10.0  # nats: parts that no joint holds are rare among what is recorded to learn from
# Times what rows scatter by: answers of joints that are as far from ideal as is expected miss by one of it, and
# handheld cameras bend a single hinge by up to nearly two. Joints in turn, which follow many a curve, are asked sooner:
# those of true chains miss by up to 0.56, two that follow a curve by 0.81 and more.
_LARGEST_SCATTER, _MAX_RMS_CHAIN, _CURVED = 1.2, 0.7, 2.0
# More of them follow a curve as closely as true chains do, as arc and line and arc again. And the cosine of a corner:
# in a real chain there mostly is one where a joint takes over.
_CHAIN, _NO_CORNER = 3, 0.95
_FEWEST_TO_DOUBT = 16  # rows; fewer lie on any smooth path, and do not separate a joint from free motion


@dataclass(frozen=True, eq=False)
class GoodnessOfFit:
    """Alternatives to the joints of an answer.

    Attributes:
        log_odds: of a motion without a joint over the best joints [nats].
        log_evidence: of the best explanation of the rows.
        instead: of the answer, if it does not stand: mostly the one joint that explains all of them best.
        path: along which the part moves; None: it moves freely, if there are odds of that.
    """

    log_odds: float
    log_evidence: float
    instead: Segmented | None = None
    path: Joint | None = None

    @property
    def moves_freely(self) -> bool:
        return self.instead is not None and self.path is None and self.log_odds > 0


def assess_joints(
    segmented: Segmented,
    fitted: Sequence[FittedPiece],
    track: PartTrack,
    inlier: Booleans,
    noise: MeasurementNoise,
    settings: LearnSettings,
) -> GoodnessOfFit | None:
    """Alternatives that explain the rows better than an answer; None if its joints miss them by little.

    A sequence of joints follows many curves closely, and a slide tolerates a rotation: the criterion is how far either
    the result or the best single joint misses the rows. Deviations of real joints repeat in every pass, and a curve
    follows them better than a sequence of joints.
    """
    if inlier.sum() < _FEWEST_TO_DOUBT:
        return None
    scatter, missed = _scatter(track, inlier, noise, settings), _misfit(fitted, track, inlier)
    is_in_turn = len({piece.joint for piece in fitted if piece.joint.moves}) > 1
    is_near = not (missed > (_MAX_RMS_CHAIN if is_in_turn else _LARGEST_SCATTER) * scatter).any()
    if is_near and not _follows_a_curve(fitted, track, inlier, noise):
        return None
    single = best_single(segmented, settings)
    missed_by_one, answer = _misfit_of_answer(single), segmented.log_probability
    if not (missed_by_one > np.sqrt(3) * finest_stds(3 * len(missed_by_one))).any():
        # One joint meets all rows to within the finest noise. So that is the tracker's, and no curve is closer.
        likelier = max(single, under_noise(segmented, single.noise, settings), key=lambda found: found.log_probability)
        return _replaced_by(likelier) if likelier.log_probability > answer else None
    if not (np.maximum(missed, missed_by_one) > _CURVED * scatter).any():
        return None
    steps, likelihood_power = segmented.track, segmented.table.likelihood_power
    rough = initial_noise(steps, settings)
    free = free_log_probability(steps, rough, likelihood_power)
    path = likeliest_path(steps, rough, likelihood_power) if settings.paths else None
    if path is not None and path.log_probability <= free:
        path = None
    if path is None and not (missed_by_one > _CURVED * scatter).any():
        # Rows that pass once lie on a smooth curve in any case, and one joint is as near as joints are.
        return _replaced_by(single) if single.log_probability > answer else None
    log_alternative = (free if path is None else path.log_probability) - _RARE
    if log_alternative <= answer:
        return GoodnessOfFit(log_alternative - answer, answer)
    log_odds = log_alternative - max(single.log_probability, answer)
    if log_odds <= 0:
        return GoodnessOfFit(log_odds, single.log_probability, single)
    if path is None:
        return GoodnessOfFit(log_odds, log_alternative, single)
    rows = track.take(np.flatnonzero(inlier))
    std = max(path.std, length_std(initial_noise(rows, settings)))
    return GoodnessOfFit(log_odds, log_alternative, single, principal_path(rows, std, path.curve) or path.curve)


def _replaced_by(answer: Segmented) -> GoodnessOfFit:
    return GoodnessOfFit(-np.inf, answer.log_probability, answer)


def no_single_joint_of(
    fitted: Sequence[FittedPiece],
    track: PartTrack,
    inlier: Booleans,
    noise: MeasurementNoise,
    settings: LearnSettings,
    log_odds: float,
) -> NoSingleJoint:
    """The error of joints on rows of free motion."""
    missed, scatter = _misfit(fitted, track, inlier), _scatter(track, inlier, noise, settings)
    turned = track.quaternion is not None
    return NoSingleJoint(
        position=float(missed[-1]),
        rotation=float(missed[0]) if turned else None,
        position_noise=float(scatter[-1]),
        rotation_noise=float(scatter[0]) if turned else None,
        log_odds=log_odds,
    )


def _follows_a_curve(
    fitted: Sequence[FittedPiece], track: PartTrack, inlier: Booleans, noise: MeasurementNoise
) -> bool:
    """Whether a part passes smoothly from joint to joint several times, which indicates a curve."""
    if len({piece.joint for piece in fitted}) < _CHAIN or not all(piece.joint.moves for piece in fitted):
        return False
    weight = np.repeat([noise.rotation_length, 1.0], 3)[-6 if track.quaternion is not None else -3 :]

    def direction(piece: FittedPiece, last: bool) -> Floats:
        rows = piece.index(inlier)
        c = segment_configurations(piece.joint, rows[-1:] if last else rows[:1], track, noise)
        along = jacobian(piece.joint, c)[0][-len(weight) :] * weight
        return np.asarray(along / np.linalg.norm(along))

    cosines = [abs(float(direction(a, True) @ direction(b, False))) for a, b in pairwise(fitted)]
    return min(cosines) > _NO_CORNER


def _misfit(fitted: Sequence[FittedPiece], track: PartTrack, inlier: Booleans) -> Floats:
    """(2,) or (1,) root mean square distance of rows from their joints: rotation [rad], if measured, position [m]."""
    errors = [left_by(piece.joint, piece.index(inlier), track, ROTATION_LENGTH) for piece in fitted]
    error = np.concatenate(errors)
    return np.asarray(np.sqrt((error.reshape(len(error), -1, 3) ** 2).sum(axis=2).mean(axis=0)))


def _misfit_of_answer(answer: Segmented) -> Floats:
    """As `_misfit`, for the steps and joints of an answer."""
    error, _ = misses(answer.table.pool, answer.segmentation.which)
    return np.asarray(np.sqrt((error.reshape(len(error), -1, 3) ** 2).sum(axis=2).mean(axis=0)))


def _scatter(track: PartTrack, inlier: Booleans, noise: MeasurementNoise, settings: LearnSettings) -> Floats:
    """(2,) or (1,) expected distance of rows from a correct joint: rotation [rad], if measured, and position [m].

    By their white noise, of which a few rows leave open how much it is, and because neither joints nor trackers are
    ideal.
    """
    rough = initial_noise(track.take(np.flatnonzero(inlier)), settings).of_rows(1.0)
    position = np.hypot(max(noise.position_white, rough.position_white), settings.position_misfit)
    rotation = np.hypot(max(noise.rotation_white, rough.rotation_white), settings.rotation_misfit)
    return np.asarray(np.sqrt(3) * np.array([rotation, position] if track.quaternion is not None else [position]))
