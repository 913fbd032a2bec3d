"""Warnings about rows that are not measurements of one continuous motion, see `continuity`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from micah_plan.message import Message
from micah_plan.recording import messages
from micah_plan.recording.continuity import FLOORS, Continuity, apart, continuity_of, stretches
from micah_plan.recording.symmetry import ReadTurned, turned_back
from micah_plan.recording.value import Recording

_FEW, _RARE = 3, 0.05
"""Repeats of so few rows at a time, that are so rare, are dropped frames, which nobody has to know."""

_AT_RANDOM = 1.5
"""Of the variance is the mean square of steps, which is 2 of noise, of what says nothing of the next row."""

_FEWEST = 16

_OVERLAP = 0.8
"""Of the rows of two parts that strayed together, for one to be taken for the other."""

_CLOSER = 0.25
"""Of the way to its own place is the way of a stray to the place of the part that it is taken for."""


@dataclass(frozen=True, eq=False)
class _Track:
    """One part in one run with its rows, and which of them are measurements."""

    name: str
    index: tuple[int, ...]
    rows: Recording
    continuity: Continuity

    def row_range_text(self, first: int, last: int) -> str:
        """The row numbers and times of a range, in words."""
        number = f"rows {self.index[first]} to {self.index[last]}" if last > first else f"row {self.index[first]}"
        begin, end = self.rows.time[[first, last]].tolist()
        return f"{number} (t = {begin:.4g}" + (f" to {end:.4g} s)" if last > first else " s)")

    def adjacent_row(self, first: int, last: int) -> int:
        """The nearest measured row before a range or, at the start, behind it."""
        measured = np.flatnonzero(self.continuity.is_measured)
        before = measured[measured < first]
        return int(before[-1] if len(before) else measured[measured > last][0])


_Stray = tuple[_Track, int, int]
"""A part, and the first and last row of a piece that is left out of its track."""


def breaks(recording: Recording) -> tuple[str, ...]:
    """Warnings, one line for each stretch that is not a measurement of the motion, and for each jump."""
    recording, turned = turned_back(recording)
    every: list[str] = []
    for run in recording.runs:
        tracks = []
        for part in recording.parts:
            index = recording.index(run=run, part=part)
            if len(index):
                rows = recording.rows(index)
                tracks.append(_Track(f"part '{part}'", tuple(index.tolist()), rows, continuity_of(rows)))
        lines = [
            line for track in tracks for line in (*_noise_lines(track), *_repeat_lines(track), *_jump_lines(track))
        ]
        lines += _stray_lines(tracks)
        lines += [_turned_line(recording, each) for each in turned if each.run == run]
        every += [messages.in_run(run, line) if len(recording.runs) > 1 else line for line in lines]
    return tuple(every)


def _turned_line(recording: Recording, turned: ReadTurned) -> Message:
    """The warning of rows in which a symmetric part was read in another orientation."""
    first = int(turned.rows[0])
    time = float(recording.time[first])
    return messages.read_turned(turned.part, turned.symmetry.fold, len(turned.rows), first, time)


def _noise_lines(track: _Track) -> list[Message]:
    """Warnings of parts whose positions are white noise, not a trajectory.

    The mean square of successive differences is twice the variance of white noise, and less of any motion (von Neumann,
    Annals of Mathematical Statistics 1941).
    """
    rows = track.rows.rows(track.continuity.is_measured)
    if len(rows) < _FEWEST:
        return []
    lines = []
    vectors = [(rows.position, "m", FLOORS[0])]
    if rows.quaternion is not None:
        turned = rows.poses().rotation
        vectors.append((np.asarray((turned * turned.mean().inv()).as_rotvec()), "rad", FLOORS[1]))
    for values, unit, floor in vectors:
        spread = float(np.sqrt(values.var(axis=0).sum()))
        steps = float((np.diff(values, axis=0) ** 2).sum(axis=1).mean())
        if spread > floor and steps > _AT_RANDOM * spread**2:
            lines.append(messages.is_noise(track.name, spread, unit))
    return lines


def _repeat_lines(track: _Track) -> list[Message]:
    strays = np.zeros(len(track.rows), dtype=bool)
    for first, last in track.continuity.strays:
        strays[first : last + 1] = True
    pieces = stretches(track.continuity.repeats & ~strays)
    if not pieces or (max(b - a for a, b in pieces) + 1 < _FEW and track.continuity.repeats.mean() < _RARE):
        return []
    first, last = max(pieces, key=lambda piece: piece[1] - piece[0])
    total = sum(b - a + 1 for a, b in pieces)
    is_one = len(pieces) == 1
    where = f", {'' if is_one else 'most of them '}{track.row_range_text(first, last)}"
    repeated = track.index[first - 1] if is_one else None
    return [messages.repeats(total, track.name, repeated, where, bool(track.continuity.rests.any()))]


def _jump_lines(track: _Track) -> list[Message]:
    if not track.continuity.jumps:
        return []
    jump = max(track.continuity.jumps, key=lambda jump: jump.distance)
    size, where = _size(jump.distance, jump.angle), track.row_range_text(jump.row, jump.row)
    return [messages.jumps(track.name, *size, where, len(track.continuity.jumps) - 1)]


def _stray_lines(tracks: Sequence[_Track]) -> list[Message]:
    """Warnings of the strays of all parts of a run; parts that swap places are reported as exchanged."""
    every = [(track, first, last) for track in tracks for first, last in track.continuity.strays]
    pairs = [
        (a, b)
        for track, another in combinations(tracks, 2)
        for a, b in _at_once(track, another)
        if _is_taken_for(a, b) and _is_taken_for(b, a)
    ]
    lines = [messages.exchanged(a[0].name, b[0].name, a[0].row_range_text(*a[1:])) for a, b in pairs]
    named = [stray for pair in pairs for stray in pair]
    for track in tracks:
        alone = [stray for stray in every if stray[0] is track and stray not in named]
        if alone:
            lines.append(_stray_line(track, [(first, last) for _, first, last in alone]))
    return lines


def _stray_line(track: _Track, strays: Sequence[tuple[int, int]]) -> Message:
    """The warning of a track's longest stray, with their number."""
    first, last = max(strays, key=lambda stray: stray[1] - stray[0])
    size = _size(*apart(track.rows.position, track.rows.quaternion, track.adjacent_row(first, last), first).tolist())
    is_at_end = first == 0 or last == len(track.rows) - 1
    where = track.row_range_text(first, last)
    return messages.stray(track.name, *size, where, len(strays) - 1, is_at_end)


def _size(distance: float, angle: float) -> tuple[float, float]:
    """A distance [m] and an angle [rad], 0 where negligible."""
    return (distance if distance > 0.1 * FLOORS[0] else 0.0, angle if angle > 0.1 * FLOORS[1] else 0.0)


def _at_once(track: _Track, second: _Track) -> list[tuple[_Stray, _Stray]]:
    """Whether strays of two parts share most of their rows."""
    pairs = []
    begins, ends = (second.rows.time[[stray[k] for stray in second.continuity.strays]] for k in (0, 1))
    for first, last in track.continuity.strays:
        begin, end = track.rows.time[[first, last]].tolist()
        for k in range(int(np.searchsorted(ends, begin)), int(np.searchsorted(begins, end, side="right"))):
            shared = min(end, float(ends[k])) - max(begin, float(begins[k]))
            if shared >= _OVERLAP * max(end - begin, float(ends[k] - begins[k])):
                pairs.append(((track, first, last), (second, *second.continuity.strays[k])))
    return pairs


def _is_taken_for(stray: _Stray, another: _Stray) -> bool:
    """Whether a stray of one part lies where another part was before."""
    (track, first, last), (place, begin, end) = stray, another
    here = track.rows.position[first]
    from_own = np.linalg.norm(here - track.rows.position[track.adjacent_row(first, last)])
    from_other = np.linalg.norm(here - place.rows.position[place.adjacent_row(begin, end)])
    return bool(from_other < _CLOSER * from_own)
