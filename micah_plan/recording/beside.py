"""Joining a robot's commands to a recording with another clock, including the clock offset.

If the offset is not given, it is estimated from the correlation of the part's speed and the commanded speed, which does
not depend on the frame of the commands; its std is that of the shift of a signal in white noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.errors import InputError
from micah_plan.recording.commands import command_meaning
from micah_plan.recording.value import Recording

_LEAST_CORRELATION = 0.5
# Share of the shorter of both that must overlap, and rows of the finest grid of offsets.
_LEAST_OVERLAP, _MOST_OFFSETS = 0.5, 20_000
_SMOOTHED = 3  # rows that a speed is the mean of, to each side


@dataclass(frozen=True)
class ClockOffset:
    """Time of the commands minus time of the recording [s].

    Attributes:
        std: of it [s]; 0 where it was given.
        correlation: of both speeds there; None where it was given.
        part: that moves as was commanded.
    """

    seconds: float
    std: float
    correlation: float | None
    part: str


def with_commands_beside(
    recording: Recording, commands: Recording, offset: float | None = None
) -> tuple[Recording, ClockOffset]:
    """The recording with the commands between its rows, and the clock offset.

    Args:
        recording: poses of one run.
        commands: one run with actions, in a frame of its own (`learn` finds how it is turned).
        offset: time of the commands minus time of the recording [s]; None: found from the motion.

    Raises:
        InputError: if there are no actions, several runs, or no offset at which the part moves as commanded.
    """
    if commands.action is None or not np.isfinite(commands.action).any():
        remedy = "give a table with ax,ay,az, or with target columns (see --columns)"
        raise InputError("expected commands, found none", remedy=remedy)
    if len(recording.runs) > 1 or len(commands.runs) > 1 or len(commands.parts) > 1:
        raise InputError("expected one run of one part", remedy="join each run with its own commands")
    time, total = _commanded(commands, commands.action)
    found = _found(recording, time, total) if offset is None else _given(recording, time, total, offset)
    action = np.zeros((len(recording), 3))
    rows = recording.index(part=found.part)
    reached = _at(time, total, recording.time[rows] + found.seconds)
    action[rows[:-1]] = np.diff(reached, axis=0)
    for part in recording.parts:
        action[recording.index(part=part)[-1]] = np.nan
    return replace(recording, action=action), found


def _commanded(commands: Recording, action: Floats) -> tuple[Floats, Floats]:
    """Times (n,) and the commanded path (n, 3) [m]: positions, or summed displacements."""
    if command_meaning(commands) == "position":
        is_told = np.isfinite(action).all(axis=1)
        return commands.time[is_told], (commands.position + action)[is_told]
    steps = np.nan_to_num(action[:-1])
    return commands.time, np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def _at(time: Floats, total: Floats, when: Floats) -> Floats:
    """(k, 3) values at times `when` (k,), interpolated linearly."""
    return np.stack([np.interp(when, time, column) for column in total.T], axis=1)


def _given(recording: Recording, time: Floats, total: Floats, offset: float) -> ClockOffset:
    first, last = recording.time.min() + offset, recording.time.max() + offset
    if first > time[-1] or last < time[0]:
        problem = f"at this offset the commands are from {time[0] - offset:.3g} to {time[-1] - offset:.3g} s"
        raise InputError(problem, source="--offset", remedy="give the time of the commands minus that of the video")
    scores = {part: _correlation(recording, part, time, total, np.array([offset]))[0] for part in recording.parts}
    part = max(scores, key=lambda name: scores[name])
    return ClockOffset(offset, 0.0, None, part)


def _found(recording: Recording, time: Floats, total: Floats) -> ClockOffset:
    step = 0.5 * float(np.median(np.diff(np.unique(recording.time))))
    spans = float(np.ptp(recording.time)), float(np.ptp(time))
    shared = _LEAST_OVERLAP * min(spans)
    low = float(time[0] - recording.time.max()) + shared
    high = float(time[-1] - recording.time.min()) - shared
    offsets = np.linspace(low, high, int(np.clip((high - low) / step, 3, _MOST_OFFSETS)))
    scores = {part: _correlation(recording, part, time, total, offsets) for part in recording.parts}
    part = max(scores, key=lambda name: float(scores[name].max()))
    own = scores[part]
    k = int(own.argmax())
    if own[k] < _LEAST_CORRELATION:
        problem = "at no offset between the clocks does a part move as commanded"
        raise InputError(problem, source="--actions", remedy="give --offset, or leave out the commands")
    between = float(offsets[1] - offsets[0])
    before, after = own[max(k - 1, 0)], own[min(k + 1, len(own) - 1)]
    bend = float(2.0 * own[k] - before - after)
    shift = 0.5 * float(after - before) / bend if bend > 0.0 and 0 < k < len(own) - 1 else 0.0
    # Of a shifted signal in white noise: the variance left, over rows and the bend of the correlation.
    rows = len(recording.index(part=part))
    std = between * float(np.sqrt(max(1.0 - own[k] ** 2, 1e-6) / (rows * max(bend, 1e-9))))
    return ClockOffset(float(offsets[k]) + shift * between, min(std, float(high - low)), float(own[k]), part)


def _correlation(recording: Recording, part: str, time: Floats, total: Floats, offsets: Floats) -> Floats:
    """(k,) correlation of the speed of a part with that of the commands, at each offset."""
    rows = recording.index(part=part)
    when = recording.time[rows]
    moved = _speed(recording.position[rows])
    scores = []
    for offset in offsets.tolist():
        commanded = _speed(_at(time, total, when + offset))
        both = moved - moved.mean(), commanded - commanded.mean()
        size = float(np.linalg.norm(both[0]) * np.linalg.norm(both[1]))
        scores.append(float(both[0] @ both[1]) / size if size > 0.0 else 0.0)
    return np.array(scores)


def _speed(position: Floats) -> Floats:
    """(n,) distance between the smoothing window's ends around each row."""
    n = len(position)
    before, after = (np.clip(np.arange(n) + sign * _SMOOTHED, 0, n - 1) for sign in (-1, 1))
    return np.asarray(np.linalg.norm(position[after] - position[before], axis=1))
