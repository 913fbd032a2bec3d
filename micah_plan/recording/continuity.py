"""Continuity of a track: which rows measure one continuous motion.

A tracker that loses a part writes zeros or its last pose again; one that mistakes a marker, an edge or another body
measures poses that the part cannot reach and return from. Two tests are made for every row before any fit:

- **Is it the same reading as before?** See `repeats.repeated_readings`.
- **Can the part get there?** A step to the next reading is a *jump* if it is several times as fast as nearly all steps
  of the track and as the steps next to it in the same direction, and no action commands it. Jumps cut the track into
  pieces, of which the sequence with most rows is kept: past a piece that the part can pass in the time, or over a jump,
  which costs some rows. So a piece from which the track comes back is left out, and one from which it does not is kept
  with a warning: rows may be missing there, or the tracker was restarted with an offset.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from micah_plan.arrays import Booleans, Floats, Ints
from micah_plan.recording.exact_poses import are_exact
from micah_plan.recording.repeats import repeated_readings
from micah_plan.recording.value import Recording

FLOORS = (0.03, 0.3)
"""Smallest jump [m, rad]: what is closer disturbs no fit that allows for noise."""

FASTER = 4.0
"""Times the speed of nearly all steps, and of those before and after it that go the same way."""

NEARLY_ALL = 0.75
"""Of the steps: strays in a tenth of the rows make a fifth of the steps jumps."""
_JUMP_COSTS = 0.1
"""Of the rows of a track: a longer piece that the track comes back from, or ends with, is believed."""

_DETOUR = 2.0
"""Times as long as the way without it is the way over a stray."""

_MOST_PIECES = 64
"""One after another that are looked over: more strays in a row are no strays."""

FEWEST = 8
"""Rows: fewer show no usual speed."""


@dataclass(frozen=True)
class Jump:
    """A step that the part cannot make but that is kept: to `row`, by a distance [m] and an angle [rad]."""

    row: int
    distance: float
    angle: float


@dataclass(frozen=True, eq=False)
class Continuity:
    """Classification of the rows of one part in one run.

    Attributes:
        is_measured: (n,) rows to learn from.
        repeats: (n,) rows that repeat the one before.
        rests: (n,) repeated rows in which the part rests: the poses were not measured by a tracker, which might have
            lost it.
        strays: (first, last) rows that are left out since the part cannot get there, with those that repeat them.
        jumps: steps that are kept though the part does not move so.
    """

    is_measured: Booleans
    repeats: Booleans
    rests: Booleans
    strays: tuple[tuple[int, int], ...]
    jumps: tuple[Jump, ...]


def continuity(time: Floats, position: Floats, quaternion: Floats | None, action: Floats | None = None) -> Continuity:
    """Classify rows as measurements of one motion, repeated rows, or strays.

    Args:
        time: (n,) [s]; position: (n, 3) [m]; quaternion: (n, 4) unit, scalar last, or None.
        action: (n, 3) commanded displacement to the next row [m], in any frame, NaN or 0 where there is none; or None.
    """
    repeats = repeated_readings(position, quaternion, action)
    fresh = np.flatnonzero(~repeats)
    if len(fresh) < FEWEST:
        return Continuity(~repeats, repeats, np.zeros(len(time), dtype=bool), (), ())
    commanded = np.zeros(len(fresh) - 1)
    if action is not None:
        so_far = np.concatenate([np.zeros((1, 3)), np.cumsum(np.nan_to_num(action), axis=0)])
        commanded = np.linalg.norm(np.diff(so_far[fresh], axis=0), axis=1)
    steps = _Steps.of(time[fresh], position[fresh], None if quaternion is None else quaternion[fresh])
    edges = [0, *(np.flatnonzero(steps.jumps(commanded)) + 1).tolist(), len(fresh)]
    pieces = list(pairwise(edges))
    kept = _kept(steps, pieces, _JUMP_COSTS * len(fresh))
    is_measured = np.zeros(len(time), dtype=bool)
    for number in kept:
        is_measured[fresh[slice(*pieces[number])]] = True
    left_out = np.array([int(fresh[a]) for k, (a, _) in enumerate(pieces) if k not in kept], dtype=np.int64)
    within = [(left_out[(left_out >= a) & (left_out <= b)], b) for a, b in stretches(~is_measured)]
    strays = tuple((int(stretch[0]), b) for stretch, b in within if len(stretch))
    over = [pieces[now][0] for before, now in pairwise(kept) if now == before + 1]
    jumps = tuple(Jump(int(fresh[k]), *steps.between(k - 1, k).tolist()) for k in over)
    rests = _rests(is_measured, repeats, position, quaternion)
    return Continuity(is_measured, repeats, rests, strays, jumps)


def _rests(is_measured: Booleans, repeats: Booleans, position: Floats, quaternion: Floats | None) -> Booleans:
    """(n,) repeated rows that are rests, since all other poses lie exactly on a joint."""
    turns = None if quaternion is None else quaternion[is_measured]
    if not repeats.any() or not are_exact(position[is_measured], turns):
        return np.zeros(len(repeats), dtype=bool)
    said_before = np.maximum.accumulate(np.where(repeats, 0, np.arange(len(repeats))))
    return np.asarray(repeats & is_measured[said_before])


@dataclass(frozen=True, eq=False)
class _Steps:
    """Consecutive readings with the steps between them.

    Attributes:
        time: (k,) in rows of the usual pause; position: (k, 3) [m]; quaternion: (k, 4), or None.
        lengths: (k-1,) of steps of position [m] and, if measured, rotation [rad].
        over_two: (k-2,) length of two steps together, of position and, if measured, rotation.
        usual: bound of nearly all steps, per row.
    """

    time: Floats
    position: Floats
    quaternion: Floats | None
    lengths: tuple[Floats, ...]
    over_two: tuple[Floats, ...]
    usual: tuple[float, ...]

    @classmethod
    def of(cls, time: Floats, position: Floats, quaternion: Floats | None) -> _Steps:
        row, channels = np.arange(len(time)), 1 if quaternion is None else 2

        def steps(lag: int) -> tuple[Floats, ...]:
            return tuple(apart(position, quaternion, row[:-lag], row[lag:])[:channels])

        pause = np.diff(time)
        # A pause that is shorter than usual is one of the clock, not of the hand.
        rows = np.concatenate([[0.0], np.cumsum(np.maximum(pause / np.median(pause), 1.0))])
        lengths = steps(1)
        usual = tuple(float(np.quantile(length / np.diff(rows), NEARLY_ALL)) for length in lengths)
        return cls(rows, position, quaternion, lengths, steps(2), usual)

    def jumps(self, commanded: Floats) -> Booleans:
        """(k-1,) whether each step exceeds the part's motion."""
        is_gap, rows = np.zeros(len(self.time) - 1, dtype=bool), np.diff(self.time)
        for number, (length, usual, floor) in enumerate(zip(self.lengths, self.usual, FLOORS, strict=False)):
            speed = length / rows
            # Two steps that lead further than each of them; directions of half turns are undetermined.
            goes_on = self.over_two[number] > np.maximum(length[1:], length[:-1])
            beside = np.zeros_like(speed)
            beside[:-1] = np.where(goes_on, speed[1:], 0.0)
            beside[1:] = np.maximum(beside[1:], np.where(goes_on, speed[:-1], 0.0))
            is_leap = (length > floor) & (speed > FASTER * np.maximum(usual, beside))
            is_gap |= is_leap & (commanded < 0.5 * length) if number == 0 else is_leap
        return is_gap

    def between(self, a: Ints | int, b: Ints | int) -> Floats:
        """(2, k) distances between readings, see `apart`."""
        return apart(self.position, self.quaternion, a, b)

    def comes_back(self, leaves: Ints, first: Ints, last: int, back: int) -> Booleans:
        """Whether readings from each of `first` to `last` lie on the path between the rows before and behind them.

        The part must get from there to here in the time, and the path over them must be much longer: rows in between on
        the direct path were measured, though rows are missing before and behind it.
        """
        rows, straight = self.time[back] - self.time[leaves], self.between(leaves, back)
        floor, usual = np.array(FLOORS)[:, None], np.array([*self.usual, 0.0])[:2, None]
        in_time = (straight <= np.maximum(floor, FASTER * usual) + rows * usual).all(axis=0)
        over = self.between(leaves, first) + self.between(last, back)[:, None]
        return np.asarray(in_time & ((over > 2.0 * floor) & (over > _DETOUR * straight)).any(axis=0))


def apart(position: Floats, quaternion: Floats | None, a: Ints | int, b: Ints | int) -> Floats:
    """(2, k) distances [m] and angles [rad] from rows a to rows b; angles of 0 where orientation was not measured."""
    far = np.linalg.norm(position[b] - position[a], axis=-1)
    if quaternion is None:
        return np.stack([far, np.zeros_like(far)])
    cosine = np.abs((quaternion[a] * quaternion[b]).sum(axis=-1))
    return np.stack([far, 2.0 * np.arccos(np.minimum(cosine, 1.0))])


def continuity_of(rows: Recording) -> Continuity:
    """The continuity of the rows of one part in one run."""
    return continuity(rows.time, rows.position, rows.quaternion, rows.action)


def _kept(steps: _Steps, pieces: list[tuple[int, int]], cost: float) -> list[int]:
    """Numbers of the pieces in the chain with most rows, where each jump costs a number of rows."""
    if len(pieces) == 1:
        return [0]
    starts, ends = np.transpose(pieces)
    best, before = (ends - starts).astype(float), np.full(len(pieces), -1)
    for now in range(1, len(pieces)):
        passed = np.arange(max(now - _MOST_PIECES, 0), now)
        beside = steps.comes_back(ends[passed] - 1, ends[passed], int(ends[now - 1]) - 1, int(starts[now]))
        beside[-1] = False
        total = best[passed] + best[now] - np.where(beside, 0.0, cost)
        if total.max() > best[now]:
            best[now], before[now] = total.max(), passed[np.argmax(total)]
    chain = [int(np.argmax(best))]
    while before[chain[-1]] >= 0:
        chain.append(int(before[chain[-1]]))
    return chain[::-1]


def stretches(rows: Booleans) -> list[tuple[int, int]]:
    """(first, last) of every stretch of rows (n,) that are true."""
    edges: Ints = np.flatnonzero(np.diff(np.concatenate([[False], rows, [False]]).astype(np.int8)))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]
