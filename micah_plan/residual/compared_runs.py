"""Runs of a recording prepared for comparison with a model: contiguous rows and the commands between them.

A missing row takes its command with it, so the motion across the gap is not determined: rows on its two sides are not
consecutive, as time stamps show.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from micah_plan.arrays import Booleans, Floats, Ints, robust_std, white_std
from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.tracks import Track, tracks
from micah_plan.recording.value import Recording
from micah_plan.residual.likelihood import FEWEST_ROWS
from micah_plan.residual.stored_late import is_regular_in_places, rows_late

Place = tuple[int, float]
"""Of a part in its recording: number of its run's place, and its first time in that run [s]."""

# A pause that is so many times the usual one, and so many standard deviations longer, is a missing row.
_LONGER, _STDS_LONGER = 1.5, 6.0


def read_tracks(automaton: HybridAutomaton, recording: Recording) -> tuple[tuple[Track, ...], int]:
    """Every run of a recording from its first to its last measured row, with actions in the rows of their motions.

    Returns:
        The runs, and by how many rows all actions were stored too late.

    Raises:
        InputError: see `tracks`.
    """
    measured = []
    for track in tracks(automaton, recording):
        rows = np.flatnonzero(track.is_measured)
        measured.append(rows_of(track, int(rows[0]), int(rows[-1]) + 1) if len(rows) else track)
    late = rows_late(measured)
    following = {effect.coordinate for effect in automaton.effects if form(effect.name).layer == "place"}
    is_of_places = np.array(
        [
            late > 0 and (each.name in following or is_regular_in_places(measured, i))
            for i, each in enumerate(automaton.coordinates)
        ]
    )
    return tuple(_with_earlier_actions(track, late, is_of_places) for track in measured if len(track.time) > late), late


def _with_earlier_actions(track: Track, late: int, led: Booleans) -> Track:
    """A run with each action moved `late` rows earlier, to the motion that it causes; the last rows then have none.

    Args:
        led: (n,) whether commands mean places: they lead there from the poses that they were stored with.
    """
    if not late or track.u is None or track.action is None:
        return track
    shorter = rows_of(track, 0, len(track.time) - late)
    led_from = np.where(led, track.origin[late:], shorter.origin)
    return replace(shorter, u=track.u[late:], action=track.action[late:], led_from=led_from)


def white_noise_of(x: Floats) -> Floats:
    """(n,) std of white noise in configurations (T, n), from third differences, which vanish for smooth motion."""
    if len(x) < FEWEST_ROWS:
        return np.zeros(x.shape[1])
    return white_std(x, 3)


def sections(time: Floats) -> list[tuple[int, int]]:
    """(first row, end) of the contiguous stretches of rows (T,)."""
    if len(time) < FEWEST_ROWS:
        return [(0, len(time))]
    pause = np.diff(time)
    usual = float(np.median(pause))
    missing = pause > max(_LONGER * usual, usual + _STDS_LONGER * float(robust_std(pause)))
    edges = [0, *(np.flatnonzero(missing) + 1).tolist(), len(time)]
    return list(pairwise(edges))


def consecutive_parts(track: Track) -> list[Track]:
    """The contiguous parts of a run, of two rows or more."""
    return [rows_of(track, a, b) for a, b in sections(track.time) if b - a > 1]


def rows_of(track: Track, first: int, end: int) -> Track:
    """The rows `first` to `end` of a run."""
    steps = slice(first, end - 1)
    u, action = (None if commands is None else commands[steps] for commands in (track.u, track.action))
    return _selected_rows(track, slice(first, end), u, action)


def _selected_rows(track: Track, rows: slice | Ints, u: Floats | None, action: Floats | None) -> Track:
    """Selected rows of a run, with the commands between them."""
    return replace(
        track,
        time=track.time[rows],
        position=track.position[rows],
        quaternion=None if track.quaternion is None else track.quaternion[rows],
        x=track.x[rows],
        u=u,
        action=action,
        believed=None if track.believed is None else track.believed[rows],
        led_from=None if track.led_from is None else track.led_from[rows],
        is_measured=track.is_measured[rows],
    )


def at_measurements(track: Track) -> Track:
    """The measured rows of a run, with the commands in between summed."""
    if track.is_measured.all():
        return track
    rows = np.flatnonzero(track.is_measured)

    def between(commands: Floats | None) -> Floats | None:
        if commands is None:
            return None
        so_far = np.concatenate([np.zeros_like(commands[:1]), np.cumsum(commands, axis=0)])
        return np.asarray(np.diff(so_far[rows], axis=0))

    return _selected_rows(track, rows, between(track.u), between(track.action))
