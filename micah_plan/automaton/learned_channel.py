"""What learning found between a demonstration's actions and the motion, as effects of the model.

The channel belongs to the recording, not to the object: another hand, or this project's own logs, give their actions in
another way. So a model does not have it, and prediction takes it only where it is asked to.
"""

from __future__ import annotations

from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.memory import LONGEST_DELAY
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.errors import InputError


def with_learned_channel(automaton: HybridAutomaton, period: float) -> HybridAutomaton:
    """The automaton for recordings whose actions are like those that it was learned from.

    Args:
        automaton: with what learning was sure of.
        period: time from row to row [s] of such a recording.

    Raises:
        InputError: if learning found no channel: the model was not learned, or without actions.
    """
    found: list[Effect] = []
    for edge in automaton.learned:
        channel = None if edge.certainty is None else edge.certainty.channel
        links = [link for link in automaton.links if (link.parent, link.child) == (edge.parent, edge.child)]
        if channel is None or not links:
            continue
        name = automaton.coordinates[links[0].coordinate].name
        turn = tuple((f"rotation_{k + 1}", value) for k, value in enumerate(channel.frame_rotation))
        steps = min(max(channel.delay, 0.0) / period, float(LONGEST_DELAY))  # motion before its action: no effect
        found += [Effect("frame_rotation", name, turn), Effect("gain", name, (("gain", channel.gain),))]
        found += [Effect("delay", name, (("steps", steps),))]
    if not found:
        raise InputError("the model holds no action channel", remedy="learn it from a recording with actions")
    return with_effect(automaton, *found)
