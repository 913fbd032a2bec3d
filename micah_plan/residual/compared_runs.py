"""Runs of a recording as they are compared with a model: which rows follow each other, and what moves them.

A row that is missing takes its command with it, so what happened from the row before to the row after is not told:
those are not consecutive, as time stamps show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from micah_plan.arrays import Floats, Ints, robust_std, white_std
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.tracks import Track, tracks
from micah_plan.recording.value import Recording
from micah_plan.residual.likelihood import FEWEST_ROWS, FREEDOM, LEAST_EVIDENCE, robust_log_density

Place = tuple[int, float]
"""Of a part in its recording: number of its run's place, and its first time in that run [s]."""

# A pause that is so many times the usual one, and so many standard deviations longer, is a missing row.
_LONGER, _STDS_LONGER = 1.5, 6.0
# Actions are stored at most so many rows late; commands before one's own that a motion may remember, and commands on
# both sides of it over which poses may have been smoothed.
_MOST_LATE, _PAST, _BESIDE = 3, 2, 3
_FEWEST_STEPS = 20
# What a later row must foretell better per step [nats], and its share of all that commands do.
_LATE_PER_ROW, _OWN_SHARE = 0.05, 0.3


def read_tracks(automaton: HybridAutomaton, recording: Recording) -> tuple[tuple[Track, ...], int]:
    """Every run of a recording from its first measured row to its last, with actions in the rows that they move.

    Returns:
        The runs, and by how many rows all actions were stored after those rows.

    Raises:
        InputError: see `tracks`.
    """
    measured = []
    for track in tracks(automaton, recording):
        rows = np.flatnonzero(track.is_measured)
        measured.append(rows_of(track, int(rows[0]), int(rows[-1]) + 1) if len(rows) else track)
    late = rows_late(measured)
    return tuple(_taken_back(track, late) for track in measured if len(track.time) > late), late


def _taken_back(track: Track, late: int) -> Track:
    """A run whose actions are stored `late` rows after those that they move: the last rows then have none."""
    if not late or track.u is None or track.action is None:
        return track
    shorter = rows_of(track, 0, len(track.time) - late)
    return replace(shorter, u=track.u[late:], action=track.action[late:])


def rows_late(runs: Sequence[Track]) -> int:
    """By how many rows actions are stored after those that they move.

    The action of a later row foretells a motion better than its own row's and those before it, and with their sign.
    (Where commands follow what was measured, the next command foretells the noise of a motion with the other sign;
    where poses were smoothed, commands of rows before and after foretell it alike.)
    """
    late = 0
    while late < _MOST_LATE and any(_is_foretold_later(runs, late, i) for i in range(runs[0].x.shape[1])):
        late += 1
    return late


def _is_foretold_later(runs: Sequence[Track], late: int, i: int) -> bool:
    """Whether a coordinate's motion follows the command `late` + 1 rows later, rather than those up to `late`."""
    designs, moved = [], []
    for track in runs:
        if track.u is None or track.u.shape[1] != track.x.shape[1]:
            return False
        dx, u = np.diff(track.x[:, i]), track.u[:, i]
        steps = np.arange(_BESIDE, len(dx) - late - _BESIDE)
        if len(steps):
            designs.append(np.stack([u[steps + late + k] for k in range(-_BESIDE, _BESIDE + 1)], axis=1))
            moved.append(dx[steps])
    if not designs:
        return False
    design, now = np.concatenate(designs), np.concatenate(moved)
    is_finite = np.isfinite(design).all(axis=1)
    design, now = design[is_finite], now[is_finite]
    if len(now) < _FEWEST_STEPS or not np.any(now):
        return False
    first = _BESIDE - _PAST
    own, next_one = design[:, first : _BESIDE + 1], design[:, first + 1 : _BESIDE + 2]
    alike = np.column_stack([design[:, _BESIDE], (design + design[:, ::-1])[:, :_BESIDE]])
    ones = np.ones((len(now), 1))
    up_to_own, up_to_next, on_both_sides, any_row = (
        robust_log_density(np.hstack([ones, columns]), now, FREEDOM) for columns in (own, next_one, alike, design)
    )
    if min(up_to_next - up_to_own, any_row - on_both_sides) < max(LEAST_EVIDENCE, _LATE_PER_ROW * len(now)):
        return False
    response = np.linalg.lstsq(np.hstack([ones, next_one]), now, rcond=None)[0][1:]
    return bool(response[-1] > _OWN_SHARE * np.abs(response).sum())


def white_noise_of(x: Floats) -> Floats:
    """(n,) std of measured configurations (T, n), as third differences show it: no smooth motion has any."""
    if len(x) < FEWEST_ROWS:
        return np.zeros(x.shape[1])
    return white_std(x, 3)


def sections(time: Floats) -> list[tuple[int, int]]:
    """(first row, end) of the rows (T,) that follow one another without a gap."""
    if len(time) < FEWEST_ROWS:
        return [(0, len(time))]
    pause = np.diff(time)
    usual = float(np.median(pause))
    missing = pause > max(_LONGER * usual, usual + _STDS_LONGER * float(robust_std(pause)))
    edges = [0, *(np.flatnonzero(missing) + 1).tolist(), len(time)]
    return list(pairwise(edges))


def consecutive_parts(track: Track) -> list[Track]:
    """The parts of a run in which rows are consecutive, of two rows or more."""
    return [rows_of(track, a, b) for a, b in sections(track.time) if b - a > 1]


def rows_of(track: Track, first: int, end: int) -> Track:
    """Some rows of a run."""
    steps = slice(first, end - 1)
    u, action = (None if commands is None else commands[steps] for commands in (track.u, track.action))
    return _taken(track, slice(first, end), u, action)


def _taken(track: Track, rows: slice | Ints, u: Floats | None, action: Floats | None) -> Track:
    """Some rows of a run, with the commands from each to the next."""
    return replace(
        track,
        time=track.time[rows],
        position=track.position[rows],
        quaternion=None if track.quaternion is None else track.quaternion[rows],
        x=track.x[rows],
        u=u,
        action=action,
        believed=None if track.believed is None else track.believed[rows],
        is_measured=track.is_measured[rows],
    )


def at_measurements(track: Track) -> Track:
    """The measured rows of a run alone, with all that was commanded from each to the next."""
    if track.is_measured.all():
        return track
    rows = np.flatnonzero(track.is_measured)

    def between(commands: Floats | None) -> Floats | None:
        if commands is None:
            return None
        so_far = np.concatenate([np.zeros_like(commands[:1]), np.cumsum(commands, axis=0)])
        return np.asarray(np.diff(so_far[rows], axis=0))

    return _taken(track, rows, between(track.u), between(track.action))
