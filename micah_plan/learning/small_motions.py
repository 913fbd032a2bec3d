"""Warnings of motions that are too small to identify a joint."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.learning import messages
from micah_plan.learning.roughness import bends, extent, std_of_bends
from micah_plan.learning.segmenting.parameter_costs import BLOCKS, TRAVEL
from micah_plan.learning.settings import FEWEST_ROWS, LearnSettings
from micah_plan.learning.track import PartTrack, find_inliers, part_track
from micah_plan.recording.value import Recording

_CLEAR_MOTION = 10.0  # wanders; a larger motion shows its joint
_FEW = 0.02  # share of the rows that do not count


def small_motions(recording: Recording, settings: LearnSettings) -> tuple[str, ...]:
    """A warning for each part whose motion is less than ten times the assumed drift in all runs."""
    warnings = []
    names = np.array(recording.part)
    for part in recording.parts:
        runs = [run for run in recording.runs if np.sum((recording.run == run) & (names == part)) >= FEWEST_ROWS]
        reaches = [reach for run in runs if (reach := _reach(part_track(recording, run, part))) is not None]
        if not reaches:
            continue
        moved, turned = (max(values) for values in zip(*reaches, strict=True))
        if moved < _CLEAR_MOTION * settings.position_wander and turned < _CLEAR_MOTION * settings.rotation_wander:
            wander = settings.position_wander, settings.rotation_wander
            has_orientation = recording.quaternion is not None
            warnings.append(messages.small_motion(part, moved, turned if has_orientation else None, wander))
    return tuple(warnings)


def _reach(track: PartTrack) -> tuple[float, float] | None:
    """Translation [m] and rotation [rad] of a part; None within the noise of its rows."""
    inlier = find_inliers(track)
    position = track.position[inlier]
    noise = float(np.sqrt(3) * std_of_bends(bends(position)))
    blocks = np.array_split(position, min(BLOCKS, len(position)))
    apart = extent(np.array([block.mean(axis=0) for block in blocks]))
    turned = 0.0
    if track.quaternion is not None:
        rotation = Rotation.from_quat(track.quaternion[inlier])
        turned = float(np.quantile((rotation * rotation[0].inv()).magnitude(), 1 - _FEW))
    if apart < TRAVEL * noise / np.sqrt(len(position) / len(blocks)):
        return None
    return extent(position, _FEW), turned
