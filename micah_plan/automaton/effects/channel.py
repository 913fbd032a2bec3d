"""The channel of commands with a memory: what a sequence of inputs becomes before it reaches the automaton's step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.effects.form import EffectForm
from micah_plan.automaton.effects.registry import form

if TYPE_CHECKING:
    from micah_plan.automaton.hybrid import HybridAutomaton

Floats = NDArray[np.float64]


@dataclass
class _Remembering:
    coordinate: int
    modes: tuple[str, ...]
    form: EffectForm
    p: tuple[float, ...]
    memory: tuple[Any, ...]


@dataclass
class InputChannel:
    """The memory of one run; `pass_on` is called once per step. Without such effects it passes everything on.

    An effect that acts in some modes only keeps its memory up to date in the others, without changing the input there.
    """

    automaton: HybridAutomaton
    _parts: list[_Remembering] = field(init=False)

    def __post_init__(self) -> None:
        self._parts = []
        for effect in self.automaton.effects:
            own = form(effect.name)
            if own.layer == "memory":
                index = self.automaton.index(effect.coordinate)
                self._parts.append(_Remembering(index, effect.modes, own, effect.values, own.at_rest(effect.values)))

    def pass_on(self, u: Sequence[float] | Floats, mode: str = "") -> Floats:
        """The input (m,) that reaches the automaton when u (m,) is commanded in a mode."""
        passed = np.array(u, dtype=float)
        for part in self._parts:
            out, part.memory = part.form.remember(np, passed[part.coordinate], part.memory, part.p)
            if not part.modes or mode in part.modes:
                passed[part.coordinate] = out
        return passed


def left_out(automaton: HybridAutomaton) -> tuple[str, ...]:
    """One line per effect that prediction and calibration know, and planner, filter and nominal plant do not."""
    reasons = {
        "memory": "it depends on earlier inputs",
        "sensor": "measurements are taken as they are",
        "frame": "commands are given in the base frame",
    }
    layers = [(effect, form(effect.name).layer) for effect in automaton.effects]
    return tuple(
        f"planner, filter and nominal plant leave out the {effect.name} of {effect.coordinate}: {reasons[layer]}"
        for effect, layer in layers
        if layer in reasons
    )
