"""Effects from an earlier calibration: whether a new recording replaces them.

A later recording may separate effects that an earlier one could not. So a model with estimated effects is calibrated
twice, with and without them, and the likelier result is kept. The evidence of earlier recordings is only in the model:
an effect can be replaced only by one that it was tied with, or by itself with other parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.residual.contenders import Contender

_ON_MOTION = ("command", "memory", "force", "place")


def estimated_effects(automaton: HybridAutomaton) -> tuple[Effect, ...]:
    """The effects on motion that a calibration estimated, recognised by their std."""
    return tuple(effect for effect in automaton.effects if effect.std and form(effect.name).layer in _ON_MOTION)


def without_estimated(automaton: HybridAutomaton) -> HybridAutomaton:
    """The model without effects of earlier calibrations (`estimated_effects`)."""
    estimated = estimated_effects(automaton)
    return replace(automaton, effects=tuple(effect for effect in automaton.effects if effect not in estimated))


def replaces(found: Sequence[Effect], earlier: Sequence[Effect]) -> bool:
    """Whether each earlier effect is among those found, as itself or as one of its ties."""
    return all(any(_may_be(new, old) for new in found) for old in earlier)


def settles_a_tie(found: Sequence[Effect], earlier: Sequence[Effect]) -> bool:
    """Whether an effect that an earlier recording left tied is resolved by this one."""
    return any(
        new.name in old.tied and old.name not in new.tied and new.coordinate == old.coordinate
        for old in earlier
        for new in found
    )


def _may_be(new: Effect, old: Effect) -> bool:
    same = {old.name, *old.tied} & {new.name, *new.tied}
    return bool(same) and new.coordinate == old.coordinate


def evidence_of(finals: Sequence[Contender]) -> float:
    """Log evidence of a recording [nats], summed over its coordinates."""
    return sum(final.evidence for final in finals)
