"""A tracker that is slower than the log writes each pose several times: that is no delay, lag or play of the part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planted_effects import door_recording, honest, loose, runs_of, short_steps

from micah_plan.message import codes_of
from micah_plan.residual.calibrate import calibrate

RUNS, ROWS = 8, 80


def seen_now_and_then(recording, period, first=0):
    """The same log with the poses that a tracker with a clock of its own has read so far."""
    kept = np.arange(len(recording))
    for run in recording.runs:
        rows = np.flatnonzero(recording.run == run)
        ticks = np.floor((np.arange(len(rows)) - first) / period)
        new = np.append(True, np.diff(ticks) > 0)
        kept[rows] = rows[np.maximum.accumulate(np.where(new, np.arange(len(rows)), 0))]
    return replace(recording, position=recording.position[kept], quaternion=recording.quaternion[kept])


@pytest.mark.sweep
@pytest.mark.parametrize(("period", "first"), [(3, 1), (2, 0), (3, 0), (10 / 3, 0), (5, 2)])
def test_a_part_that_follows_its_commands_lacks_nothing(door, period, first) -> None:
    recording = seen_now_and_then(door_recording(runs_of(honest, RUNS, ROWS, 1)), period, first)
    found = calibrate(door, recording)
    assert found.verdict == "none"
    assert "rows_without_measurement" in codes_of(found.notes)


@pytest.mark.sweep
@pytest.mark.parametrize(("period", "first"), [(3, 1), (2, 0), pytest.param(10 / 3, 0, marks=pytest.mark.evidence)])
def test_what_the_part_does_is_found_all_the_same(door, period, first) -> None:
    recording = seen_now_and_then(door_recording(runs_of(short_steps, RUNS, ROWS, 2)), period, first)
    (gain,) = calibrate(door, recording).effects
    assert gain.effect.name == "gain"
    assert gain.effect.values[0] == pytest.approx(0.8, abs=0.03)


def test_play_is_play(door) -> None:
    recording = seen_now_and_then(door_recording(runs_of(loose, RUNS, ROWS, 3)), 2)
    (play,) = calibrate(door, recording).effects
    assert play.effect.name == "backlash"
    assert play.effect.values[0] == pytest.approx(0.06, abs=0.01)
