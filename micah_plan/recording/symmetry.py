"""Symmetric objects: equivalent orientations of one pose are unified.

A tracker of a box, a cup or a handle may read it turned by half a turn from one row to the next, and back. Its position
continues, so the part did not rotate; the tracker confused symmetric orientations. For any symmetry, such a jump is a
rotation in the part's own frame by the same share of a whole turn about the same axis, each time. A part that really
rotated so far between two rows would hardly do so by 1/2, 1/3, 1/4 or 1/6 of a turn within the noise, there and back.

The rotation of a jump is read from straight lines through the rows before and after it, and all jumps of a track
together determine the axis; an axis of the part's frame is taken as exact if it is within the noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Floats, Ints
from micah_plan.recording.continuity import FASTER, FEWEST, FLOORS, NEARLY_ALL, apart
from micah_plan.recording.value import Recording

_LEAST_TURN = FLOORS[1]
"""Smallest jump [rad]: no symmetry that matters is finer."""
_ROWS_BESIDE = 10
"""Rows on each side that tell where a jump began and ended."""
_SURE_STDS = 4.0
"""Standard errors within which a turn or an axis is the one that it is compared with."""
_FINEST = 1e-5
"""Error of a turn [rad] that digits leave in any file."""
_BY_CHANCE = 0.05
"""Of a turn of a symmetry: nearer to it are a tenth of all turns about its axis, so that noise alone shows none."""
_FOLDS = (2, 3, 4, 6)
_FEWEST_JUMPS = 3
"""There, back and there again, for turns of less than a half: a part may really turn by a quarter, once."""


@dataclass(frozen=True, eq=False)
class Symmetry:
    """A rotation that maps an object onto itself.

    Attributes:
        fold: it is 1/fold of a whole turn. axis: (3,) unit, about it, in the part's frame.
    """

    fold: int
    axis: Floats

    def taken_back(self, quaternion: Floats, turns: Ints) -> Floats:
        """(n, 4) orientations with given multiples (n,) of the symmetry's rotation removed."""
        angle = -2.0 * np.pi / self.fold * turns
        back = Rotation.from_quat(quaternion) * Rotation.from_rotvec(angle[:, None] * self.axis)
        return np.where((turns == 0)[:, None], quaternion, back.as_quat())


@dataclass(frozen=True, eq=False)
class ReadTurned:
    """Rows of one part in one run that were read in an equivalent orientation."""

    part: str
    run: int
    symmetry: Symmetry
    rows: Ints


def with_unified_orientations(recording: Recording) -> Recording:
    """A recording in which each part keeps the orientation of most rows of its first run."""
    return turned_back(recording)[0]


def turned_back(recording: Recording) -> tuple[Recording, tuple[ReadTurned, ...]]:
    """(recording as of `with_unified_orientations`, corrected rows)."""
    if recording.quaternion is None or not np.isfinite(recording.quaternion).all():
        return recording, ()
    quaternion, found = recording.quaternion.copy(), list[ReadTurned]()
    for part in recording.parts:
        before = np.zeros(0, dtype=np.int64)
        for run in recording.runs:
            rows = recording.index(run=run, part=part)
            within = detect_symmetry(recording.position[rows], quaternion[rows])
            if within is not None:
                quaternion[rows] = within[0].taken_back(quaternion[rows], within[1])
            between = _between(recording.position, quaternion, before, rows)
            if between is not None:
                quaternion[rows] = between[0].taken_back(quaternion[rows], np.full(len(rows), between[1]))
            symmetry = next((each[0] for each in (between, within) if each is not None), None)
            if symmetry is not None:
                read, recorded = (Rotation.from_quat(each[rows]) for each in (quaternion, recording.quaternion))
                is_turned = (read.inv() * recorded).magnitude() > _LEAST_TURN
                found.append(ReadTurned(part, run, symmetry, rows[is_turned]))
            before = np.concatenate([before, rows])
    found = [each for each in found if len(each.rows)]
    return (replace(recording, quaternion=quaternion), tuple(found)) if found else (recording, ())


def detect_symmetry(position: Floats, quaternion: Floats) -> tuple[Symmetry, Ints] | None:
    """(symmetry, (n,) multiples of its turn by which rows differ from most); None if all rows agree.

    Args:
        position: (n, 3) [m], of one part in one run; quaternion: (n, 4) unit, scalar last.
    """
    if len(position) < FEWEST:
        return None
    row = np.arange(len(position))
    way, angle = apart(position, quaternion, row[:-1], row[1:])
    is_small = angle < _LEAST_TURN
    if is_small.all() or is_small.sum() < FEWEST:
        return None
    usual = float(np.quantile(angle[is_small], NEARLY_ALL))
    goes_on = way <= FASTER * np.quantile(way, NEARLY_ALL)
    jumps = np.flatnonzero(~is_small & (angle > FASTER * usual) & goes_on) + 1
    if not len(jumps):
        return None
    edges = np.array([0, *jumps, len(position)])
    found = _in_common(*_turns_of_jumps(Rotation.from_quat(quaternion), edges, usual))
    if found is None:
        return None
    symmetry, by = found
    turns = np.repeat(np.concatenate([[0], np.cumsum(by)]) % symmetry.fold, np.diff(edges))
    most = int(np.argmax(np.bincount(turns, minlength=symmetry.fold)))
    return symmetry, (turns - most) % symmetry.fold


def _between(position: Floats, quaternion: Floats, before: Ints, rows: Ints) -> tuple[Symmetry, int] | None:
    """(symmetry, multiple) by which a run's orientations differ from an earlier one's at close positions; None if
    equal.
    """
    if len(before) < FEWEST or len(rows) < FEWEST:
        return None
    away, nearest = KDTree(position[before]).query(position[rows])
    closest = np.argsort(away, kind="stable")[:_ROWS_BESIDE]
    there, here = (Rotation.from_quat(quaternion[of]) for of in (before[nearest[closest]], rows[closest]))
    turned = there.inv() * here
    mean = turned.mean()
    error = float(np.sqrt(np.mean((mean.inv() * turned).magnitude() ** 2)))
    if mean.magnitude() < _LEAST_TURN:
        return None
    found = _in_common(mean.as_rotvec()[None], np.array([max(error, _FINEST)]))
    return None if found is None else (found[0], int(found[1][0]) % found[0].fold)


def _turns_of_jumps(turned: Rotation, edges: Ints, usual: float) -> tuple[Floats, Floats]:
    """((j, 3) rotation vectors of the jumps at inner edges in the part's frame, (j,) errors [rad]).

    Args:
        usual: bound of nearly all other steps [rad].
    """
    ends = [
        (_at_edge(turned, int(a), int(b), at_end=True), _at_edge(turned, int(b), int(c), at_end=False))
        for a, b, c in zip(edges[:-2], edges[1:-1], edges[2:], strict=True)
    ]
    turns = [(before.inv() * after).as_rotvec() for (before, _), (after, _) in ends]
    errors = np.array([(before, after) for (_, before), (_, after) in ends])
    # Short pieces determine neither noise nor motion: both are in the usual step.
    errors = np.where(np.isfinite(errors), errors, usual)
    return np.array(turns), np.maximum(np.sqrt((errors**2).sum(axis=1)), _FINEST)


def _at_edge(turned: Rotation, first: int, last: int, *, at_end: bool) -> tuple[Rotation, float]:
    """(orientation half a row beyond an end of the rows first to last - 1, its standard error [rad])."""
    if at_end:
        rows, edge = np.arange(max(first, last - _ROWS_BESIDE), last), last - 0.5
    else:
        rows, edge = np.arange(first, min(last, first + _ROWS_BESIDE)), first - 0.5
    reference = turned[int(rows[-1 if at_end else 0])]
    if len(rows) < 4:
        return reference, np.inf
    away = (reference.inv() * turned[rows]).as_rotvec()
    design = np.stack([np.ones(len(rows)), rows - edge], axis=1)
    fitted, *_ = np.linalg.lstsq(design, away, rcond=None)
    variance = float(((away - design @ fitted) ** 2).sum()) / (len(rows) - 2)
    error = float(np.sqrt(variance * np.linalg.inv(design.T @ design)[0, 0]))
    return reference * Rotation.from_rotvec(fitted[0]), error


def _in_common(turns: Floats, errors: Floats) -> tuple[Symmetry, Ints] | None:
    """(symmetry common to all jumps (j, 3) [rad] with errors (j,), their multiples); None without one."""
    angle = np.linalg.norm(turns, axis=1)
    axes = turns / angle[:, None]
    axis = np.linalg.eigh((axes / errors[:, None] ** 2).T @ axes)[1][:, -1]
    side = np.sign(axes @ axis)
    off = np.arccos(np.clip(np.abs(axes @ axis), 0.0, 1.0)) * angle
    for fold in _FOLDS:
        step = 2.0 * np.pi / fold
        by = np.round(side * angle / step).astype(np.int64)
        near = np.minimum(_SURE_STDS * errors, _BY_CHANCE * step)
        if (by % fold == 0).any() or (np.hypot(side * angle - by * step, off) > near).any():
            continue
        if len(turns) < _FEWEST_JUMPS and (2 * by % fold).any():
            return None
        error = 1.0 / np.sqrt((1.0 / errors**2).sum()) / np.sin(0.5 * step)
        return Symmetry(fold, _exact(axis, error)), by
    return None


def _exact(axis: Floats, error: float) -> Floats:
    """The axis of the part's frame within an error [rad] of a direction; else that direction."""
    along = int(np.argmax(np.abs(axis)))
    exact = np.sign(axis[along]) * np.eye(3)[along]
    return exact if np.arccos(np.clip(exact @ axis, -1.0, 1.0)) < _SURE_STDS * error else axis
