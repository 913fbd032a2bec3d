"""Candidate carriers: parts whose motion other parts share."""

from __future__ import annotations

import numpy as np

from micah_plan.arrays import Booleans, Floats
from micah_plan.automaton.kinematics import ROTATION_LENGTH
from micah_plan.learning.roughness import bends, extent, std_of_bends
from micah_plan.recording.value import Recording

_WINDOWS = 24  # per run
_MOTION_STDS = 6.0  # white noise spreads the rows of a window over less, however many there are
_SHARE = 0.5  # of the rows in which a parent moves, in which its child moves as well
_FAR = 0.1  # m; further than slow errors of a tracker take a part, seen from another
_FAR_STDS = 20.0  # of the white noise
_FEW = 0.05  # share of the rows that do not count


def carriers(recording: Recording) -> dict[str, tuple[str, ...]]:
    """For every part, the other parts it may be mounted on, in the order of the recording's parts."""
    windows = {part: [moving_windows(recording, run, part) for run in recording.runs] for part in recording.parts}
    moving = {part: np.concatenate(runs) for part, runs in windows.items()}
    return {
        child: tuple(
            parent for parent in recording.parts if parent != child and _carries(moving[parent], moving[child])
        )
        for child in recording.parts
    }


def moves_far(recording: Recording) -> bool:
    """Whether the only part of a recording moves so far that a rigid pose can be excluded."""
    for run in recording.runs:
        place = _places(recording.rows(recording.run == run))
        if len(place) > 2 and extent(place, _FEW) > max(_FAR, _FAR_STDS * float(std_of_bends(bends(place)))):
            return True
    return False


def moving_windows(recording: Recording, run: int, part: str) -> Booleans:
    """Windows of a run in which a part moves; all parts share windows of equal duration."""
    in_run = recording.run == run
    own = np.flatnonzero(in_run & np.array([name == part for name in recording.part], dtype=bool))
    moves = np.zeros(_WINDOWS, dtype=bool)
    if len(own) < 3:
        return moves
    place = _places(recording.rows(own))
    edges = np.linspace(recording.time[in_run].min(), recording.time[in_run].max(), _WINDOWS + 1)
    window = np.clip(np.searchsorted(edges, recording.time[own], side="right") - 1, 0, _WINDOWS - 1)
    threshold = _MOTION_STDS * float(std_of_bends(bends(place)))
    for k in range(_WINDOWS):
        # With its neighbours: a window between rows of a slow recording would have none or one.
        rows = place[np.abs(window - k) <= 1]
        if len(rows) > 1:
            moves[k] = extent(rows) > threshold
    return moves


def _carries(parent: Booleans, child: Booleans) -> bool:
    return bool(parent.any() and (parent & child).sum() >= _SHARE * parent.sum())


def _places(recording: Recording) -> Floats:
    """(n, 3 or 12) positions, and directions of the part's axes scaled to lengths [m]."""
    if recording.quaternion is None:
        return recording.position
    turned = recording.poses().rotation.as_matrix().reshape(len(recording), 9)
    return np.concatenate([recording.position, ROTATION_LENGTH * turned], axis=1)
