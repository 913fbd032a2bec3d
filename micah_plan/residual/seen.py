"""What a recording shows of time and range before anything is predicted: missing rows, and ends that are none.

The range of a model is where a demonstration went. Where a mode holds the part, it ends there; elsewhere a recording
may go on, and then the model's joint goes on as well. A row that is missing takes its command with it, so what happened
from the row before to the row after is not told: those are not consecutive, as time stamps show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from micah_plan.arrays import Floats, robust_std
from micah_plan.automaton.effects.ends import is_held, range_of, with_end_moved
from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.tracks import Track
from micah_plan.quantities import quantity

# Rows that a run needs to show its own noise.
_ROWS_FOR_NOISE = 8
# A recording goes beyond an end if so many rows do, by so many standard deviations of a measurement.
_ROWS_BEYOND, _STDS_BEYOND = 3, 5.0
# How far the joint then goes on, as a share of what was seen: no end is known.
_ONWARD = 0.5
# A pause that is so many times the usual one, and so many standard deviations longer, is a missing row.
_LONGER, _STDS_LONGER = 1.5, 6.0
_STOP, _SHIFT = "limit", "guard_shift"


@dataclass(frozen=True)
class Beyond:
    """An end of a coordinate's range that a recording went beyond.

    Attributes:
        coordinate: its index; name, unit: of the coordinate; side: 0 lower, 1 upper.
        end: of the model [rad or m]; reached: furthest that was measured; onward: end that stands for none.
        step: longest that was measured: so far beyond what was reached the joint may well go.
        is_all: whether all rows lie beyond; std: of a measurement.
    """

    coordinate: int
    name: str
    unit: str
    side: int
    end: float
    reached: float
    onward: float
    step: float
    is_all: bool
    std: float

    def is_at(self, effect: Effect) -> bool:
        """Whether an effect on an end is on this one."""
        return effect.coordinate == self.name and (dict(effect.parameters)["side"] > 0) == bool(self.side)

    def is_stopped_by(self, effect: Effect) -> bool:
        return effect.name == _STOP and self.is_at(effect)

    def is_told_by(self, effect: Effect) -> bool:
        """Whether an effect says why rows lie beyond: the end is elsewhere, or only readings go on."""
        if form(effect.name).layer == "sensor":
            return effect.coordinate == self.name
        return effect.name == _SHIFT and self.is_at(effect)

    def as_shift(self, effect: Effect) -> Effect:
        """The stop as a shift of this end."""
        at, side = effect.values
        return replace(effect, name=_SHIFT, parameters=(("shift", at - self.end), ("side", side)))

    def __str__(self) -> str:
        ended, reached = quantity(self.end, self.unit), quantity(self.reached, self.unit)
        told = f"{self.name} was measured up to {reached}, beyond the model's range, which ends at {ended} with no stop"
        return f"{told}; all rows lie there: this may be another object" if self.is_all else told


def beyond_range(automaton: HybridAutomaton, runs: Sequence[Floats]) -> tuple[Beyond, ...]:
    """The ends that measured configurations (T, n) of runs lie beyond, where no mode holds the part."""
    found = []
    for i, coordinate in enumerate(automaton.coordinates):
        c = np.concatenate([x[:, i] for x in runs])
        step = max(float(np.abs(np.diff(x[:, i])).max()) for x in runs)
        std = max(float(np.median([noise_of(x)[i] for x in runs])), automaton.noise.observation_std[i])
        for side, end in enumerate(range_of(automaton, i)):
            sign = 1.0 if side else -1.0
            away = sign * (c - end)
            if (
                np.isfinite(end)
                and not is_held(automaton, i, end)
                and (away > _STDS_BEYOND * std).sum() >= _ROWS_BEYOND
            ):
                reached = end + sign * float(away.max())
                onward = reached + sign * _ONWARD * float(np.ptp(c))
                is_all = bool((away > 0).all())
                found.append(Beyond(i, coordinate.name, coordinate.unit, side, end, reached, onward, step, is_all, std))
    return tuple(found)


def opened(automaton: HybridAutomaton, beyond: Sequence[Beyond]) -> HybridAutomaton:
    """The automaton whose joints go on beyond those ends."""
    for one in beyond:
        automaton = with_end_moved(automaton, one.coordinate, one.end, one.onward)
    return automaton


def with_shifts(effects: Sequence[Effect], beyond: Sequence[Beyond]) -> list[Effect]:
    """Effects on the opened automaton as those of the model: a stop that was found beyond an end is that end, moved."""
    return [next((one.as_shift(effect) for one in beyond if one.is_stopped_by(effect)), effect) for effect in effects]


def without_old_ends(effects: Sequence[Effect], beyond: Sequence[Beyond]) -> list[Effect]:
    """The effects that say something: a stop at the end that the model has already (readings went on) says nothing."""

    def is_old(effect: Effect) -> bool:
        return effect.name == _SHIFT and any(one.is_at(effect) and abs(effect.values[0]) < one.std for one in beyond)

    return [effect for effect in effects if not is_old(effect)]


def closed(automaton: HybridAutomaton, beyond: Sequence[Beyond], effects: Sequence[Effect]) -> HybridAutomaton:
    """The opened automaton with ranges that end a step beyond the recording, or as before where an effect says why."""
    for one in beyond:
        is_moved = any(one.is_told_by(own) for own in effects)
        seen = one.reached + (one.step if one.side else -one.step)
        automaton = with_end_moved(automaton, one.coordinate, one.onward, one.end if is_moved else seen)
    return automaton


def noise_of(x: Floats) -> Floats:
    """(n,) std of measured configurations (T, n), as third differences show it: no smooth motion has any."""
    if len(x) < _ROWS_FOR_NOISE:
        return np.zeros(x.shape[1])
    third = np.diff(x, 3, axis=0)
    # Third differences of white noise have 1 + 9 + 9 + 1 times its variance.
    # They lie about 0.
    return np.asarray(robust_std(np.concatenate([third, -third])) / np.sqrt(20.0))


def sections(time: Floats) -> list[tuple[int, int]]:
    """(first row, end) of the rows (T,) that follow one another without a gap."""
    if len(time) < _ROWS_FOR_NOISE:
        return [(0, len(time))]
    pause = np.diff(time)
    usual = float(np.median(pause))
    missing = pause > max(_LONGER * usual, usual + _STDS_LONGER * float(robust_std(pause)))
    edges = [0, *(np.flatnonzero(missing) + 1).tolist(), len(time)]
    return list(pairwise(edges))


def without_gaps(track: Track) -> list[Track]:
    """The parts of a run in which rows are consecutive, of two rows or more."""
    return [_rows(track, a, b) for a, b in sections(track.time) if b - a > 1]


def _rows(track: Track, first: int, end: int) -> Track:
    own, steps = slice(first, end), slice(first, end - 1)
    return replace(
        track,
        time=track.time[own],
        position=track.position[own],
        quaternion=None if track.quaternion is None else track.quaternion[own],
        x=track.x[own],
        u=None if track.u is None else track.u[steps],
        action=None if track.action is None else track.action[steps],
        believed=None if track.believed is None else track.believed[own],
    )
