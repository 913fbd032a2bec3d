"""Add effects to an automaton: the transition, the compiler, the filter and the plants then have them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.errors import InputError, shown


def with_effect(automaton: HybridAutomaton, *effects: Effect) -> HybridAutomaton:
    """A new automaton with these effects added, in order.

    Raises:
        InputError: for an unknown effect, coordinate, mode or set of parameters.
    """
    for effect in effects:
        check_effect(automaton, effect)
        rebuilt = form(effect.name).rebuilt(automaton, automaton.index(effect.coordinate), effect.values)
        automaton = replace(rebuilt, effects=(*automaton.effects, effect))
    return automaton


def check_effect(automaton: HybridAutomaton, effect: Effect) -> None:
    """Refuse an effect that does not fit.

    Raises:
        InputError: see `with_effect`.
    """
    own = form(effect.name)
    automaton.index(effect.coordinate)
    for name in effect.modes:
        automaton.mode(name)
    names, known = [name for name, _ in effect.parameters], [p.name for p in own.parameters]
    if names != known:
        raise InputError(f"effect {effect.name} must have the parameters {', '.join(known)}. Got {shown(names)}")
    if effect.std and len(effect.std) != len(known):
        raise InputError(f"effect {effect.name} must have {len(known)} stds or none. Got {len(effect.std)}")
    for value, parameter in zip(effect.values, own.parameters, strict=True):
        if not (np.isfinite(value) and parameter.lower <= value <= parameter.upper):
            bounds = f"{parameter.lower:g} to {parameter.upper:g}"
            raise InputError(f"effect {effect.name}: {parameter.name} must be finite, {bounds}. Got {value}")
