"""What the filter knows at the first row of a segment: the commands before it, and how fast the part moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import planted_effects as plants
import pytest

from micah_plan.automaton.effects.memories import LONGEST_DELAY
from micah_plan.automaton.tracks import tracks
from micah_plan.residual.coordinate_data import coordinate_data_of

ROWS = 200


@pytest.fixture(scope="module")
def recorded(door):
    """A run in which the door swings, at commands that are all different."""
    z = 0.6 + 0.4 * np.sin(0.11 * np.arange(ROWS))
    run = (z, 0.001 * np.arange(ROWS))
    (track,) = tracks(door, plants.door_recording([run]))
    (data,) = coordinate_data_of(door, (track,))
    return track, data


def first_rows(track, data):
    """The row of the recording in which each segment begins."""
    return np.searchsorted(track.time, data.time[:, 0] - 1e-9)


def test_segments_know_the_commands_before_them_the_last_first(recorded) -> None:
    track, data = recorded
    for s, first in enumerate(first_rows(track, data)):
        known = min(first, LONGEST_DELAY + 1)
        rows = first - 1 - np.arange(known)
        np.testing.assert_allclose(data.earlier[0, s, :known], track.u[rows, 0], atol=1e-12)
        np.testing.assert_allclose(data.earlier[1, s, :known], data_places(data)[rows], atol=1e-9)
        assert np.isnan(data.earlier[:, s, known:]).all()


def data_places(data):
    """Where the command of each row of the only run leads."""
    (places,) = data.whole.place
    return places


def test_segments_know_how_fast_the_part_moves(recorded) -> None:
    track, data = recorded
    first = first_rows(track, data)
    assert (data.moving[first == 0] == 0.0).all()
    speed = 0.4 * 0.11 * np.cos(0.11 * first)
    np.testing.assert_allclose(data.moving[first > 0], speed[first > 0], rtol=0.03, atol=1e-3)


def test_chosen_segments_keep_what_was_before_them(recorded) -> None:
    _, data = recorded
    some = data.of_segments(np.array([1, 3]))
    np.testing.assert_array_equal(some.earlier, data.earlier[:, [1, 3]])
    np.testing.assert_array_equal(some.moving, data.moving[[1, 3]])


@pytest.mark.parametrize("change", [{"moving": np.zeros(1)}, {"u": np.zeros((1, ROWS))}, {"run": np.zeros(0)}])
def test_rows_of_other_segments_are_refused(recorded, change) -> None:
    """The compiled loop would read what is behind them in memory."""
    _, data = recorded
    with pytest.raises(ValueError, match="all rows must be in"):
        replace(data, **change)


def test_a_gap_ends_what_is_known(door) -> None:
    """Nobody knows what was commanded while nothing was recorded."""
    z = 0.6 + 0.4 * np.sin(0.11 * np.arange(ROWS))
    recording = plants.door_recording([(z, 0.001 * np.arange(ROWS))])
    kept = recording.rows((np.arange(ROWS) < 90) | (np.arange(ROWS) > 110))
    (data,) = coordinate_data_of(door, tracks(door, kept))
    behind = data.time[:, 0] > recording.time[100]
    begins = behind & (data.time[:, 0] == data.time[behind, 0].min())
    assert begins.any()
    assert np.isnan(data.earlier[:, begins]).all()
    assert (data.moving[begins] == 0.0).all()
