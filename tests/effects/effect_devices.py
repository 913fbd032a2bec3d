"""Effects with a memory as the devices that they are: an oracle that shares nothing with their formula."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from micah_plan.automaton.effects.form import EffectForm
from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.hybrid import HybridAutomaton


class Line:
    """Commands on their way for a number of steps, the last ones first."""

    def __init__(self, steps: float) -> None:
        self._whole, self._part = math.floor(steps), steps % 1.0
        self._sent: list[Any] = [0.0] * (self._whole + 2)

    def send(self, v: Any) -> Any:
        self._sent = [v, *self._sent[:-1]]
        return (1.0 - self._part) * self._sent[self._whole] + self._part * self._sent[self._whole + 1]


class FirstOrder:
    """The fraction `kept` of what came out before, and for the rest what goes in."""

    def __init__(self, time_constant: float) -> None:
        self._kept = math.exp(-1.0 / time_constant) if time_constant > 0.0 else 0.0
        self._out: Any = 0.0

    def send(self, v: Any) -> Any:
        self._out = self._kept * self._out + (1.0 - self._kept) * v
        return self._out


class Slewed:
    """A speed that is turned up or down, by so much at once."""

    def __init__(self, change: float) -> None:
        self._change, self._speed = change, 0.0

    def send(self, v: Any) -> Any:
        self._speed = np.clip(v, self._speed - self._change, self._speed + self._change)
        return self._speed


class Play:
    """A part that stands still while the drive moves from one of its two stops to the other."""

    def __init__(self, width: float, side: float) -> None:
        self._width, self._part = width, 0.0
        self._drive: Any = 0.5 * width * side

    def send(self, v: Any) -> Any:
        self._drive = self._drive + v
        before = self._part
        self._part = np.clip(before, self._drive - 0.5 * self._width, self._drive + 0.5 * self._width)
        return self._part - before


class Grip:
    """A spring between drive and part, which lets go all at once when it is wound as far as it holds."""

    def __init__(self, grip: float) -> None:
        self._grip, self._drive, self._part = grip, 0.0, 0.0

    def send(self, v: Any) -> Any:
        self._drive = self._drive + v
        before = self._part
        self._part = np.where(np.abs(self._drive - before) < self._grip, before, self._drive)
        return self._part - before


class ByForm:
    """An effect that is not of the library, by its formula."""

    def __init__(self, own: EffectForm, p: Sequence[float]) -> None:
        self._own, self._p, self._memory = own, p, own.at_rest(p)

    def send(self, v: Any) -> Any:
        out, self._memory = self._own.remember(np, v, self._memory, self._p)
        return out


class Motor:
    """A speed that a command sets, in a hundred instants of a step, with a dead zone about a neutral, and a curve."""

    def __init__(
        self,
        gain: float,
        lag: float,
        delay: float,
        neutral: float,
        width: float,
        backward: float,
        curve: float,
        speed: float = math.inf,
    ) -> None:
        self._gain, self._ways, self._neutral, self._width = gain, (1.0, backward), neutral, width
        self._curve, self._late, self._speed, self._most = curve, round(100 * delay), 0.0, speed
        self._kept = math.exp(-0.01 / lag) if lag > 0.0 else 0.0
        self._lag, self._sent = lag, [0.0] * (self._late + 100)

    def _told(self, v: float) -> float:
        away = v - self._neutral
        beyond = max(abs(away) - self._width, 0.0)
        steeper = 1.0 + abs(self._curve) * beyond
        flow = self._gain * beyond * (steeper if self._curve > 0.0 else 1.0 / steeper)
        return min(flow * self._ways[0], self._most) if away > 0.0 else -min(flow * self._ways[1], self._most)

    def send(self, v: float) -> float:
        self._sent, way = [*self._sent, *[float(v)] * 100], 0.0
        for instant in range(100):
            told = self._told(self._sent[-100 + instant - self._late])
            before, self._speed = self._speed, told + self._kept * (self._speed - told)
            # The lag holds back what the speed has not gained yet.
            way += 0.01 * told - self._lag * (self._speed - before)
        return way


DEVICES = {"delay": Line, "lag": FirstOrder, "ramp": Slewed, "backlash": Play, "stick_slip": Grip, "drive": Motor}


def device(effect: Effect) -> Any:
    """What an effect does to one command after the other."""
    known = DEVICES.get(effect.name)
    return ByForm(form(effect.name), effect.values) if known is None else known(*effect.values)


class DeviceChannel:
    """As `InputChannel` for one run of an object with one coordinate, moved by its input."""

    def __init__(self, automaton: HybridAutomaton) -> None:
        remembering = [effect for effect in automaton.effects if form(effect.name).layer == "memory"]
        self._devices = [(effect, device(effect)) for effect in remembering]

    def pass_on(self, u: ArrayLike, mode: str = "") -> NDArray[np.float64]:
        """The input (1,) that reaches the automaton when u (1,) is commanded."""
        passed = np.array(u, dtype=float)
        for effect, own in self._devices:
            out = own.send(passed[0])
            passed[0] = out if effect.acts_in(mode) else passed[0]
        return passed
