"""Exceeded ranges: ends of a model's range beyond which a recording continues.

The range of a model is the range of its demonstration. If a mode holds the part at an end, the range ends there;
otherwise a recording may go beyond, and the model's joint is extended.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from micah_plan.arrays import NEAR_STDS, Floats
from micah_plan.automaton.effects.ends import is_held, range_of, with_end_moved
from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.message import Message
from micah_plan.residual import messages
from micah_plan.residual.compared_runs import white_noise_of

# A recording goes beyond an end if so many rows do, by so many standard deviations of a measurement; or if a run starts
# further beyond it than is normal, since a filter's first belief has no other information.
_ROWS_BEYOND, _STDS_BEYOND = 3, 5.0
# How far the joint then goes on, as a share of what was seen: no end is known.
_ONWARD = 0.5
_STOP, _SHIFT = "limit", "guard_shift"


@dataclass(frozen=True)
class RangeExceeded:
    """An end of a coordinate's range that a recording exceeds.

    Attributes:
        coordinate: its index; name, unit: of the coordinate; side: 0 lower, 1 upper.
        end: of the model [rad or m]; reached: furthest that was measured; onward: end that stands for none.
        step: longest measured one; the joint can be expected to go at least that much further.
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
        """Whether an effect on an end concerns this one."""
        return effect.coordinate == self.name and (dict(effect.parameters)["side"] > 0) == bool(self.side)

    def is_stopped_by(self, effect: Effect) -> bool:
        return effect.name == _STOP and self.is_at(effect)

    def is_explained_by(self, effect: Effect) -> bool:
        """Whether an effect explains the rows beyond: a moved end, or a sensor error."""
        if form(effect.name).layer == "sensor":
            return effect.coordinate == self.name
        return effect.name == _SHIFT and self.is_at(effect)

    def as_shift(self, effect: Effect) -> Effect:
        """A stop expressed as a shift of this end."""
        at, side = effect.values
        return replace(effect, name=_SHIFT, parameters=(("shift", at - self.end), ("side", side)))

    @property
    def message(self) -> Message:
        """The finding in a sentence."""
        return messages.range_exceeded(self.name, self.unit, self.reached, self.end, self.is_all)

    def __str__(self) -> str:
        return self.message


def ranges_exceeded(automaton: HybridAutomaton, runs: Sequence[Floats]) -> tuple[RangeExceeded, ...]:
    """Ends that measured configurations (T, n) of runs exceed where no mode holds the part."""
    excesses = []
    for i, coordinate in enumerate(automaton.coordinates):
        c = np.concatenate([x[:, i] for x in runs])
        step = max(float(np.abs(np.diff(x[:, i])).max()) for x in runs)
        std = max(float(np.median([white_noise_of(x)[i] for x in runs])), automaton.noise.observation_std[i])
        for side, end in enumerate(range_of(automaton, i)):
            sign = 1.0 if side else -1.0
            away = sign * (c - end)
            starts_beyond = any(sign * (x[0, i] - end) > NEAR_STDS * std for x in runs)
            goes_beyond = starts_beyond or (away > _STDS_BEYOND * std).sum() >= _ROWS_BEYOND
            if np.isfinite(end) and not is_held(automaton, i, end) and goes_beyond:
                reached = end + sign * float(away.max())
                onward = reached + sign * _ONWARD * float(np.ptp(c))
                is_all = bool((away > 0).all())
                excesses.append(
                    RangeExceeded(i, coordinate.name, coordinate.unit, side, end, reached, onward, step, is_all, std)
                )
    return tuple(excesses)


def with_extended_range(automaton: HybridAutomaton, exceeded: Sequence[RangeExceeded]) -> HybridAutomaton:
    """The automaton with its ranges extended beyond the exceeded ends."""
    for excess in exceeded:
        automaton = with_end_moved(automaton, excess.coordinate, excess.end, excess.onward)
    return automaton


def with_shifts(effects: Sequence[Effect], exceeded: Sequence[RangeExceeded]) -> list[Effect]:
    """The effects with a stop found beyond an end expressed as a shift of that end."""
    return [
        next((excess.as_shift(effect) for excess in exceeded if excess.is_stopped_by(effect)), effect)
        for effect in effects
    ]


def without_old_ends(effects: Sequence[Effect], exceeded: Sequence[RangeExceeded]) -> list[Effect]:
    """The effects without stops that coincide with an end of the model."""

    def is_old(effect: Effect) -> bool:
        return effect.name == _SHIFT and any(
            excess.is_at(effect) and abs(effect.values[0]) < excess.std for excess in exceeded
        )

    return [effect for effect in effects if not is_old(effect)]


def with_range_ends(
    automaton: HybridAutomaton, exceeded: Sequence[RangeExceeded], effects: Sequence[Effect]
) -> HybridAutomaton:
    """The extended automaton with ranges that end a step beyond the recording, unless an effect explains the excess."""
    for excess in exceeded:
        is_moved = any(excess.is_explained_by(effect) for effect in effects)
        measured = excess.reached + (excess.step if excess.side else -excess.step)
        automaton = with_end_moved(automaton, excess.coordinate, excess.onward, excess.end if is_moved else measured)
    return automaton
