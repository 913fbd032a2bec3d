"""Learning from a run with an action channel: actions in another frame, scaled, early or late.

Frame and gain are marginalised in the evidence of a step model. The delay is not: it is estimated from a first result
without it, and where it matters the run is learned again with the actions shifted to when they acted.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from micah_plan.arrays import Booleans
from micah_plan.automaton.certainty import CHANNEL_NAMES, ActionChannel
from micah_plan.learning.actions.channel import estimate_channel
from micah_plan.learning.actions.command_path import with_delayed_actions
from micah_plan.learning.joints.residuals import compare_all
from micah_plan.learning.run import LearnedRun, segment_run, with_joints
from micah_plan.learning.segments import FittedPiece
from micah_plan.learning.settings import LearnSettings
from micah_plan.learning.track import PartTrack

_SURE_STDS = 3.0  # stds by which a delay differs from none
_DECISIVE = 3.0  # nats: that actions acted at another time is one more number, as likely as not
_STEP_SHARE = 0.5  # of a step of the segmentation; a shorter delay has no effect


def learn_acted_run(
    track: PartTrack,
    settings: LearnSettings,
    inlier: Booleans | None = None,
    counted: Booleans | None = None,
) -> tuple[LearnedRun, ActionChannel | None]:
    """The learned run with its actions, and the channel that relates the actions to the motion.

    Args:
        track: with or without actions.
        inlier: (n,) rows that are no outliers; None: to be found.
        counted: (n,) rows to average for steps; None: all but outliers.

    Returns:
        the run, whose track has the actions where they acted if that explains it better; None where there are no
        actions or they are uninformative.
    """
    segmented_run = segment_run(track, settings, inlier, counted=counted)
    learned = with_joints(segmented_run, settings)
    channel = _channel(learned, track)
    if channel is None:
        return learned, None
    if channel.commands == "position":  # the remaining distance shows when the part arrives, later it is 0
        return learned, channel
    std = float(np.sqrt(channel.covariance[CHANNEL_NAMES.index("delay")][CHANNEL_NAMES.index("delay")]))
    step = segmented_run.steps.size * track.duration / len(track)
    if abs(channel.delay) > max(_SURE_STDS * std, _STEP_SHARE * step):
        delayed = with_delayed_actions(track, channel.delay)
        start = replace(segmented_run, segmented=learned.segmented)
        again = segment_run(delayed, settings, learned.inlier, start)
        if again.posterior.log_evidence > learned.posterior.log_evidence + _DECISIVE:
            moved = with_joints(again, settings)
            return moved, _channel(moved, track) or channel
    return learned, channel


def _channel(learned: LearnedRun, track: PartTrack) -> ActionChannel | None:
    """The channel of the joint that governs the most rows."""
    moving = [piece for piece in learned.pieces if piece.leader is not None]
    if not moving or track.action is None or any(sure.no_single_joint for sure in learned.certainties):
        return None
    longest = max(moving, key=lambda piece: piece.end - piece.start)
    # The step into a neighbour is not the joint's alone: a stop cuts it short.
    pieces = [
        (piece.start + (piece.start > 0), piece.end - (piece.end < len(track) - 1))
        for piece in moving
        if piece.leader == longest.leader
    ]
    return estimate_channel(longest.joint, pieces, track, _white_std(longest, learned, track), learned.inlier)


def _white_std(piece: FittedPiece, learned: LearnedRun, track: PartTrack) -> float:
    """White noise of one measured configuration [rad or m]."""
    row = slice(piece.start, piece.start + 1)
    quaternion = None if track.quaternion is None else track.quaternion[row]
    direction = compare_all([piece.joint], track.position[row], quaternion, 1.0).direction[0, :, 0]
    noise = learned.noise
    information = float(direction[-3:] @ direction[-3:]) / noise.position_white**2
    if quaternion is not None:
        information += float(direction[:3] @ direction[:3]) / noise.rotation_white**2
    return float(information**-0.5)
