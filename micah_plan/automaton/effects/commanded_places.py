"""Position commands without further information: the part is at the commanded position after each step.

That is the effect `follow` with neutral parameters. It moves roll-outs from any place to the places of the log, and is
the starting point of calibration; it does not change a step of the model itself.
"""

from __future__ import annotations

from dataclasses import replace

from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.memories import AS_COMMANDED, Follow, is_as_commanded
from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.errors import InputError
from micah_plan.recording.commands import command_meaning
from micah_plan.recording.value import Recording


def as_commanded(automaton: HybridAutomaton, recording: Recording) -> HybridAutomaton:
    """The model for a recording: its coordinates follow positions where the recording says that commands are positions.

    If the recording does not state it, the model's own setting counts.

    Raises:
        InputError: if the recording has displacements, but the model has an effect of a machine that follows places.
    """
    meaning = command_meaning(recording)
    if meaning is None:
        return automaton
    told_places = {effect.coordinate for effect in automaton.effects if form(effect.name).layer == "place"}
    if meaning == "position":
        moved = [
            coordinate.name
            for i, coordinate in enumerate(automaton.coordinates)
            if any(mode.driven[i] for mode in automaton.modes) and coordinate.name not in told_places
        ]
        return with_effect(automaton, *(Effect(Follow.name, name, AS_COMMANDED) for name in moved))
    kept = tuple(effect for effect in automaton.effects if not is_as_commanded(effect))
    following = next((effect for effect in kept if form(effect.name).layer == "place"), None)
    if following is not None:
        problem = f"the recording's commands are displacements, but in the model {following.coordinate} follows places"
        raise InputError(problem, remedy="use the model as it was learned, or add --commands position")
    return automaton if len(kept) == len(automaton.effects) else replace(automaton, effects=kept)


def without_superseded(automaton: HybridAutomaton) -> HybridAutomaton:
    """The automaton without neutral `follow` effects that another position effect of the coordinate replaces."""
    following = [effect for effect in automaton.effects if form(effect.name).layer == "place"]
    known = {effect.coordinate for effect in following if not is_as_commanded(effect)}
    superseded = [effect for effect in following if is_as_commanded(effect) and effect.coordinate in known]
    if not superseded:
        return automaton
    return replace(automaton, effects=tuple(effect for effect in automaton.effects if effect not in superseded))
