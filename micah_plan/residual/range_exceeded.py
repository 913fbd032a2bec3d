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

from micah_plan.arrays import ROUND_OFF, Floats, Ints, robust_std, white_std
from micah_plan.automaton.effects.ends import is_held, range_of, with_end_moved
from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.tracks import Track, tracks
from micah_plan.quantities import quantity
from micah_plan.recording.value import Recording
from micah_plan.residual.likelihood import robust_log_density

# Rows that a run needs to show its own noise.
_ROWS_FOR_NOISE = 8
# A recording goes beyond an end if so many rows do, by so many standard deviations of a measurement.
_ROWS_BEYOND, _STDS_BEYOND = 3, 5.0
# How far the joint then goes on, as a share of what was seen: no end is known.
_ONWARD = 0.5
# A pause that is so many times the usual one, and so many standard deviations longer, is a missing row.
_LONGER, _STDS_LONGER = 1.5, 6.0
# Actions are stored at most so many rows late; commands before one's own that a motion may remember.
_MOST_LATE, _PAST = 3, 2
# Columns of a constant and commands, latest first: those up to a motion's own row, and as many up to the next.
_COMPARED = (0, 2, 3, 4), (0, 1, 2, 3)
_FEWEST_STEPS, _FREEDOM = 20, 4.0
# What a later row must foretell better [nats], altogether and per step, and its share of all that commands do.
_LATE_EVIDENCE, _LATE_PER_ROW, _OWN_SHARE = 8.0, 0.05, 0.3
_STOP, _SHIFT = "limit", "guard_shift"


@dataclass(frozen=True)
class RangeExceeded:
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
        sentence = (
            f"{self.name} was measured up to {reached}, beyond the model's range, which ends at {ended} with no stop"
        )
        return f"{sentence}; all rows lie there: this may be another object" if self.is_all else sentence


def read_tracks(automaton: HybridAutomaton, recording: Recording) -> tuple[tuple[Track, ...], int]:
    """Every run of a recording from its first measured row to its last, with actions in the rows that they move.

    Returns:
        The runs, and by how many rows all actions were stored after those rows.

    Raises:
        InputError: see `tracks`.
    """
    excesses = []
    for track in tracks(automaton, recording):
        rows = np.flatnonzero(track.is_measured)
        excesses.append(rows_of(track, int(rows[0]), int(rows[-1]) + 1) if len(rows) else track)
    late = rows_late(excesses)
    return tuple(_taken_back(track, late) for track in excesses if len(track.time) > late), late


def _taken_back(track: Track, late: int) -> Track:
    """A run whose actions are stored `late` rows after those that they move: the last rows then have none."""
    if not late or track.u is None or track.action is None:
        return track
    shorter = rows_of(track, 0, len(track.time) - late)
    return replace(shorter, u=track.u[late:], action=track.action[late:])


def rows_late(runs: Sequence[Track]) -> int:
    """By how many rows actions are stored after those that they move.

    The action of a later row foretells a motion better than its own row's and those before it, and with their sign.
    (Where commands follow what was measured, the next command foretells the noise of a motion with the other sign.)
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
        steps = np.arange(_PAST, len(dx) - late - 1)
        if len(steps):
            designs.append(np.stack([u[steps + late + 1 - k] for k in range(_PAST + 2)], axis=1))
            moved.append(dx[steps])
    if not designs:
        return False
    design, now = np.concatenate(designs), np.concatenate(moved)
    is_finite = np.isfinite(design).all(axis=1)
    design, now = np.column_stack([np.ones(is_finite.sum()), design[is_finite]]), now[is_finite]
    if len(now) < _FEWEST_STEPS or not np.any(now):
        return False
    least = 1e-3 * float(np.std(now)) + ROUND_OFF
    with_it, later = (robust_log_density(design[:, columns], now, _FREEDOM, least) for columns in _COMPARED)
    if later - with_it < max(_LATE_EVIDENCE, _LATE_PER_ROW * len(now)):
        return False
    response = np.linalg.lstsq(design[:, _COMPARED[1]], now, rcond=None)[0][1:]
    return bool(response[0] > _OWN_SHARE * np.abs(response).sum())


def ranges_exceeded(automaton: HybridAutomaton, runs: Sequence[Floats]) -> tuple[RangeExceeded, ...]:
    """The ends that measured configurations (T, n) of runs lie beyond, where no mode holds the part."""
    excesses = []
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
                excesses.append(
                    RangeExceeded(i, coordinate.name, coordinate.unit, side, end, reached, onward, step, is_all, std)
                )
    return tuple(excesses)


def with_extended_range(automaton: HybridAutomaton, exceeded: Sequence[RangeExceeded]) -> HybridAutomaton:
    """The automaton whose joints go on beyond those ends."""
    for excess in exceeded:
        automaton = with_end_moved(automaton, excess.coordinate, excess.end, excess.onward)
    return automaton


def with_shifts(effects: Sequence[Effect], exceeded: Sequence[RangeExceeded]) -> list[Effect]:
    """Effects on the opened automaton as those of the model: a stop that was found beyond an end is that end, moved."""
    return [
        next((excess.as_shift(effect) for excess in exceeded if excess.is_stopped_by(effect)), effect)
        for effect in effects
    ]


def without_old_ends(effects: Sequence[Effect], exceeded: Sequence[RangeExceeded]) -> list[Effect]:
    """The effects that say something: a stop at the end that the model has already (readings went on) says nothing."""

    def is_old(effect: Effect) -> bool:
        return effect.name == _SHIFT and any(
            excess.is_at(effect) and abs(effect.values[0]) < excess.std for excess in exceeded
        )

    return [effect for effect in effects if not is_old(effect)]


def with_range_ends(
    automaton: HybridAutomaton, exceeded: Sequence[RangeExceeded], effects: Sequence[Effect]
) -> HybridAutomaton:
    """The opened automaton with ranges that end a step beyond the recording, or as before where an effect says why."""
    for excess in exceeded:
        is_moved = any(excess.is_told_by(effect) for effect in effects)
        measured = excess.reached + (excess.step if excess.side else -excess.step)
        automaton = with_end_moved(automaton, excess.coordinate, excess.onward, excess.end if is_moved else measured)
    return automaton


def noise_of(x: Floats) -> Floats:
    """(n,) std of measured configurations (T, n), as third differences show it: no smooth motion has any."""
    if len(x) < _ROWS_FOR_NOISE:
        return np.zeros(x.shape[1])
    return white_std(x, 3)


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
