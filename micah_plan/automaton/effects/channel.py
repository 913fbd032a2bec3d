"""The channel of commands with a memory: what a sequence of inputs becomes before it reaches the automaton's step.

Plants, roll-outs and prediction send inputs through it. The library's three effects are written here a second time, as
the devices they are, and share nothing with their forms or with the states that planner and filter make of them
(`automaton.memory_states`): so a mistake there shows as a difference here. Users' own effects use their form.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from micah_plan.automaton.effects.form import EffectForm
from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.hybrid import HybridAutomaton

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]


class _Device(Protocol):
    def load(self, memory: Sequence[float]) -> None: ...

    def send(self, v: Any) -> Any: ...


class _Line:
    """Commands on their way for a number of steps, the last ones first."""

    def __init__(self, steps: float) -> None:
        self._whole, self._part = math.floor(steps), steps % 1.0
        self._sent: list[Any] = [0.0] * (self._whole + 2)

    def load(self, memory: Sequence[float]) -> None:
        self._sent[: len(memory)] = memory

    def send(self, v: Any) -> Any:
        self._sent = [v, *self._sent[:-1]]
        return (1.0 - self._part) * self._sent[self._whole] + self._part * self._sent[self._whole + 1]


class _FirstOrder:
    """The fraction `kept` of what came out before, and for the rest what goes in."""

    def __init__(self, time_constant: float) -> None:
        self._kept = math.exp(-1.0 / time_constant) if time_constant > 0.0 else 0.0
        self._out: Any = 0.0

    def load(self, memory: Sequence[float]) -> None:
        (self._out,) = memory

    def send(self, v: Any) -> Any:
        self._out = self._kept * self._out + (1.0 - self._kept) * v
        return self._out


class _Play:
    """A part that stands still while the drive moves from one of its two stops to the other."""

    def __init__(self, width: float, side: float) -> None:
        self._width, self._part = width, 0.0
        self._drive: Any = 0.5 * width * side

    def load(self, memory: Sequence[float]) -> None:
        self._drive = memory[0] + self._part

    def send(self, v: Any) -> Any:
        self._drive = self._drive + v
        before = self._part
        self._part = np.clip(before, self._drive - 0.5 * self._width, self._drive + 0.5 * self._width)
        return self._part - before


class _ByForm:
    """Any effect, by its formula."""

    def __init__(self, own: EffectForm, p: Sequence[float]) -> None:
        self._own, self._p, self._memory = own, p, own.at_rest(p)

    def load(self, memory: Sequence[float]) -> None:
        self._memory = tuple(memory)

    def send(self, v: Any) -> Any:
        out, self._memory = self._own.remember(np, v, self._memory, self._p)
        return out


def _device(effect: Effect) -> _Device:
    if effect.name == "delay":
        return _Line(effect.values[0])
    if effect.name == "lag":
        return _FirstOrder(effect.values[0])
    if effect.name == "backlash":
        return _Play(*effect.values)
    return _ByForm(form(effect.name), effect.values)


def _input(automaton: HybridAutomaton, effect: Effect) -> tuple[int, float]:
    """The input that moves an effect's coordinate most, and the command that a unit of it stands for."""
    rows = [mode.input_matrix[automaton.index(effect.coordinate)] for mode in automaton.modes]
    row = next((row for row in rows if any(row)), None)
    if row is None:
        return automaton.index(effect.coordinate), 1.0
    j = int(np.argmax(np.abs(row)))
    return j, row[j]


class InputChannel:
    """The memory of one run, or of t runs side by side; without such effects it passes everything on.

    An effect that acts in some modes only keeps its memory up to date in the others, without changing the input there.
    """

    def __init__(self, automaton: HybridAutomaton, memory: Mapping[Effect, Sequence[float]] | None = None) -> None:
        """Args: the model, and what its effects remember; left out: they are at rest."""
        self._names = automaton.mode_names
        remembering = [effect for effect in automaton.effects if form(effect.name).layer == "memory"]
        self._parts = [(effect, *_input(automaton, effect), _device(effect)) for effect in remembering]
        for effect, _, _, device in self._parts:
            if memory and effect in memory:
                device.load(memory[effect])

    def pass_on(self, u: ArrayLike, mode: str | NDArray[np.int64] = "") -> Floats:
        """The input (..., m) that reaches the automaton when u (..., m) is commanded: one call per step.

        Args:
            mode: name of the mode, or the index of each run's mode (t,).
        """
        passed = np.array(u, dtype=float)
        for effect, j, scale, device in self._parts:
            sent = passed[..., j].copy()
            passed[..., j] = np.where(self._acts(effect, mode), device.send(scale * sent) / scale, sent)
        return passed

    def _acts(self, effect: Effect, mode: str | NDArray[np.int64]) -> bool | Booleans:
        if isinstance(mode, str):
            return effect.acts_in(mode)
        return np.array([effect.acts_in(name) for name in self._names])[mode]
