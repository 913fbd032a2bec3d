"""Adding effects to an automaton, for the transition, compiler, filter and plants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from micah_plan.automaton.effects.form import Parameter
from micah_plan.automaton.effects.memories import AS_COMMANDED, LONGEST_DELAY, Follow, is_as_commanded
from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.errors import InputError, shown
from micah_plan.recording.value import Recording


def with_effect(automaton: HybridAutomaton, *effects: Effect) -> HybridAutomaton:
    """A new automaton with these effects added, in order.

    Raises:
        InputError: for an unknown effect, coordinate, mode or set of parameters.
    """
    for effect in effects:
        effect = _with_options(effect)
        check_effect(automaton, effect)
        rebuilt = form(effect.name).rebuilt(automaton, automaton.index(effect.coordinate), effect.values)
        automaton = replace(rebuilt, effects=(*automaton.effects, effect))
    return automaton


def _with_options(effect: Effect) -> Effect:
    """The effect with omitted parameters appended at their defaults."""
    given = [name for name, _ in effect.parameters]
    left_out = [pair for pair in form(effect.name).options().items() if pair[0] not in given]
    std = (*effect.std, *(0.0 for _ in left_out)) if effect.std else ()
    return replace(effect, parameters=(*effect.parameters, *left_out), std=std)


def check_effect(automaton: HybridAutomaton, effect: Effect) -> None:
    """Refuse an effect that does not fit the automaton.

    Raises:
        InputError: see `with_effect`.
    """
    effect_form = form(effect.name)
    automaton.index(effect.coordinate)
    for name in effect.modes:
        automaton.mode(name)
    names, expected = [name for name, _ in effect.parameters], [p.name for p in effect_form.parameters]
    if names != expected:
        raise InputError(f"effect {effect.name} must have the parameters {', '.join(expected)}. Got {shown(names)}")
    if effect.since is not None and effect_form.layer in ("guard", "geometry"):
        problem = f"effect {effect.name} changes the model itself, so it cannot begin (key 'since')"
        raise InputError(problem, remedy="leave 'since' out: the model is that of the object as it is now")
    if effect.std and len(effect.std) != len(expected):
        raise InputError(f"effect {effect.name} must have {len(expected)} stds or none. Got {len(effect.std)}")
    for value, parameter in _impossible(effect):
        bounds = f"{parameter.lower:g} to {parameter.upper:g}"
        raise InputError(f"effect {effect.name}: {parameter.name} must be finite, {bounds}. Got {value}")


def is_possible(effect: Effect) -> bool:
    """Whether an effect's parameters are within their bounds."""
    return not _impossible(effect)


def _impossible(effect: Effect) -> list[tuple[float, Parameter]]:
    """(value, parameter) of each value that is not finite or outside its bounds."""
    pairs = zip(effect.values, form(effect.name).parameters, strict=True)
    return [
        (value, parameter)
        for value, parameter in pairs
        if not ((np.isfinite(value) or value == parameter.neutral) and parameter.lower <= value <= parameter.upper)
    ]


def for_demonstrations(automaton: HybridAutomaton, recording: Recording) -> HybridAutomaton:
    """The model for recordings whose actions passed through the same channel as the demonstration's.

    Raises:
        InputError: if learning has no estimate for the actions.
    """
    steps = [np.diff(recording.select(run=run, part=recording.parts[0]).time) for run in recording.runs]
    return with_learned_channel(automaton, float(np.median(np.concatenate(steps))))


def with_learned_channel(automaton: HybridAutomaton, period: float) -> HybridAutomaton:
    """The automaton with the learned action channel as effects, for recordings like its demonstration.

    Learning estimates the channel between a demonstration's actions and the motion. It belongs to the recording, not to
    the object: with another hand, or in this project's own logs, actions are given in another way. So a model does not
    contain it, and prediction uses it only on request.

    Args:
        automaton: with the action channel that learning found.
        period: time from row to row [s] of such a recording.

    Raises:
        InputError: if learning found no channel: the model was not learned, or without actions.
    """
    effects, is_known = list[Effect](), False
    for edge in automaton.learned:
        channel = None if edge.certainty is None else edge.certainty.channel
        links = [link for link in automaton.links if (link.parent, link.child) == (edge.parent, edge.child)]
        if channel is None or not links:
            continue
        name, is_known = automaton.coordinates[links[0].coordinate].name, True
        turn = tuple((f"rotation_{k + 1}", value) for k, value in enumerate(channel.frame_rotation))
        steps = min(max(channel.delay, 0.0) / period, float(LONGEST_DELAY))  # motion before its action: no effect
        if channel.commands == "position":
            automaton = _with_delay(automaton, name, steps)
            continue
        effects += [Effect("frame_rotation", name, turn), Effect("gain", name, (("gain", channel.gain),))]
        effects += [Effect("delay", name, (("steps", steps),))]
    if not is_known:
        raise InputError("the model holds no action channel", remedy="learn it from a recording with actions")
    return with_effect(automaton, *effects)


def _with_delay(automaton: HybridAutomaton, coordinate: str, steps: float) -> HybridAutomaton:
    """The automaton with a delay of commanded positions on a coordinate, unless its servo is known."""
    own = [effect for effect in automaton.effects if effect.coordinate == coordinate and effect.name == Follow.name]
    if not all(map(is_as_commanded, own)):
        return automaton
    automaton = replace(automaton, effects=tuple(effect for effect in automaton.effects if effect not in own))
    return with_effect(automaton, Effect(Follow.name, coordinate, (*(dict(AS_COMMANDED) | {"delay": steps}).items(),)))
