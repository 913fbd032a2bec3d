"""The track of one part in one run, prepared for learning: continuous orientation, actions in the part's frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Booleans, Floats, Ints
from micah_plan.automaton.graph import BASE
from micah_plan.errors import InputError, shown
from micah_plan.learning.dead_band import without_actions_at_goal, without_dead_band
from micah_plan.learning.settings import FEWEST_ROWS
from micah_plan.recording.commands import Meaning, command_meaning
from micah_plan.recording.continuity import continuity
from micah_plan.recording.value import Recording

# Of the largest step: rows in which a part moves. Of a usual step: by how much a place that is held changes.
_MOVES, _STAYS = 0.1, 0.1


@dataclass(frozen=True, eq=False)
class PartTrack:
    """Rows of one part in one run (n rows).

    Attributes:
        rows: (n,) their indices within the whole recording.
        time: (n,) [s].
        position: (n, 3) [m].
        quaternion: (n, 4) scalar last, of continuous sign; None if orientation was not measured.
        action: (n, 3) commanded displacement to the next row [m], in the part's frame where orientation was measured
            (there the direction of motion of every joint is constant), else in the base frame; 0 where it is missing.
            None if the run has no action at all.
        meaning: of the actions, as stated by the recording (`recording.commands`); None: not stated.
    """

    rows: Ints
    time: Floats
    position: Floats
    quaternion: Floats | None
    action: Floats | None
    meaning: Meaning | None = None

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def duration(self) -> float:
        """Time from the first row to the last [s]."""
        return float(self.time[-1] - self.time[0])

    @cached_property
    def rotation(self) -> Rotation | None:
        return None if self.quaternion is None else Rotation.from_quat(self.quaternion)

    def take(self, index: NDArray[np.int64] | slice) -> PartTrack:
        """The rows with these indices."""
        return PartTrack(
            self.rows[index],
            self.time[index],
            self.position[index],
            None if self.quaternion is None else self.quaternion[index],
            None if self.action is None else self.action[index],
            self.meaning,
        )

    def coarsened(self, size: int) -> PartTrack:
        """Means of `size` rows each, named after their first row; their actions are summed."""
        begins = np.arange(0, len(self), size)
        counts = np.diff(np.append(begins, len(self)))[:, None]
        quaternion = None
        if self.quaternion is not None:
            quaternion = np.add.reduceat(self.quaternion, begins, axis=0)
            quaternion = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
        return PartTrack(
            self.rows[begins],
            np.add.reduceat(self.time, begins) / counts[:, 0],
            np.add.reduceat(self.position, begins, axis=0) / counts,
            quaternion,
            None if self.action is None else np.add.reduceat(self.action, begins, axis=0),
            self.meaning,
        )

    def followed_by(self, later: PartTrack) -> PartTrack:
        """These rows and later ones of the same part; both have the same columns."""

        def both(first: Floats | None, second: Floats | None) -> Floats | None:
            return None if first is None or second is None else np.concatenate([first, second])

        return PartTrack(
            np.concatenate([self.rows, later.rows]),
            np.concatenate([self.time, later.time]),
            np.concatenate([self.position, later.position]),
            both(self.quaternion, later.quaternion),
            both(self.action, later.action),
            self.meaning,
        )


def find_inliers(track: PartTrack) -> Booleans:
    """(n,) rows that are measurements of one continuous motion, excluding repeats and strays."""
    found = continuity(track.time, track.position, track.quaternion, track.action)
    return found.is_measured | found.rests


def part_track(recording: Recording, run: int, part: str) -> PartTrack:
    """The rows of one part in one run.

    Raises:
        InputError: if there are fewer than FEWEST_ROWS rows, one is not finite, or a part has the base's name.
    """
    if BASE in recording.parts:
        problem = f"a part is named {shown(BASE)}, as the body that all parts are related to"
        raise InputError(problem, where="column 'part'", remedy="give the part another name or leave its rows out")
    of_part = np.array([name == part for name in recording.part], dtype=bool)
    rows = np.flatnonzero(np.logical_and(recording.run == run, of_part))
    where = f"run {run}, part '{part}'"
    if len(rows) < FEWEST_ROWS:
        problem = f"learning needs at least {FEWEST_ROWS} rows, found {len(rows)}"
        raise InputError(problem, where=where, remedy="record a longer motion or leave these rows out")
    track = measured_track(recording, rows, rows, where)
    if track.action is None:
        return track
    if has_position_actions(track):
        return replace(track, action=without_actions_at_goal(track.position, track.action))
    return replace(track, action=without_dead_band(track.position, track.quaternion, track.action))


def has_position_actions(track: PartTrack) -> bool:
    """Whether a run's actions are goal positions: as stated by the recording, or as its data show."""
    if track.action is None or track.meaning is not None:
        return track.action is not None and track.meaning == "position"
    ways = track.action if track.rotation is None else track.rotation.apply(track.action)
    return are_held((track.position + ways)[:-1], track.position[:-1])  # the last row has no command


def are_held(places: Floats, at: Floats) -> bool:
    """Whether commanded points (n, k) stay constant while the part (n, k) moves, unlike displacements."""
    changed, moved = (np.linalg.norm(np.diff(rows, axis=0), axis=1) for rows in (places, at))
    is_moving = moved > _MOVES * moved.max(initial=0.0)
    return bool(is_moving.any() and np.median(changed[is_moving]) < _STAYS * np.median(moved[is_moving]))


def measured_track(recording: Recording, rows: Ints, index: Ints, where: str) -> PartTrack:
    """Selected rows (`index`) of a recording, of one part and run, prepared for learning and numbered `rows`.

    Raises:
        InputError: if a pose is not finite, or time does not increase.
    """
    position = recording.position[index]
    late = np.flatnonzero(~(np.diff(recording.time[index]) > 0))
    if len(late):
        row, (before, now) = int(rows[late[0] + 1]), recording.time[index[late[0] : late[0] + 2]].tolist()
        problem = f"time must increase from row to row of a part, found t = {now:g} s after {before:g} s in row {row}"
        raise InputError(problem, where=where, remedy="keep one row of those that share a time")
    quaternion = None if recording.quaternion is None else _continuous(recording.quaternion[index])
    if not np.isfinite(position).all() or (quaternion is not None and not np.isfinite(quaternion).all()):
        raise InputError("poses must be finite", where=where, remedy="remove the rows without a pose")
    action = None if recording.action is None else recording.action[index]
    is_given = np.zeros(len(index), dtype=bool) if action is None else np.asarray(np.isfinite(action).all(axis=1))
    if action is not None and is_given.any():
        action = np.where(is_given[:, None], action, 0.0)
        if quaternion is not None:
            action = Rotation.from_quat(quaternion).inv().apply(action)
    else:
        action = None
    return PartTrack(rows, recording.time[index], position, quaternion, action, command_meaning(recording))


def _continuous(quaternion: Floats) -> Floats:
    """Quaternions with signs chosen for continuity."""
    flips = np.where(np.sum(quaternion[1:] * quaternion[:-1], axis=1) < 0, -1.0, 1.0)
    unit = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    return np.asarray(unit * np.concatenate([[1.0], np.cumprod(flips)])[:, None])
