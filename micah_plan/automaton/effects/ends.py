"""Effects on where motion ends and begins. An automaton takes them in by moving its guards."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

from micah_plan.automaton.effects.form import EffectForm, Operations, Parameter, Value, Values
from micah_plan.automaton.effects.structure import with_end, with_release, with_shifted_end
from micah_plan.automaton.hybrid import HybridAutomaton


@final
class Limit(EffectForm):
    """A stop inside of the model's range, at its upper (side 1) or lower (side -1) end."""

    name, layer = "limit", "guard"
    sentence = "The motion is stopped inside of the range that the model knows."
    source = "Lygeros, Sastry and Tomlin, Hybrid systems: an invariant that is smaller than modelled"
    parameters = (Parameter("at", "coordinate"), Parameter("side", "1", None, -1.0, 1.0))

    def stops(self, ops: Operations, lower: Value, upper: Value, p: Values) -> tuple[Value, Value]:
        low = ops.where(p[1] < 0, ops.maximum(lower, p[0]), lower)
        high = ops.where(p[1] > 0, ops.minimum(upper, p[0]), upper)
        return low, high

    def rebuilt(self, automaton: HybridAutomaton, coordinate: int, p: Sequence[float]) -> HybridAutomaton:
        return with_end(automaton, coordinate, p[0], p[1] > 0)


@final
class GuardShift(EffectForm):
    """The threshold at one end of the range, upper (side 1) or lower (side -1), lies elsewhere."""

    name, layer = "guard_shift", "guard"
    sentence = "The threshold at which the motion changes lies elsewhere than in the model."
    source = "Lygeros, Sastry and Tomlin, Hybrid systems: guards"
    parameters = (Parameter("shift", "coordinate", 0.0), Parameter("side", "1", None, -1.0, 1.0))

    def stops(self, ops: Operations, lower: Value, upper: Value, p: Values) -> tuple[Value, Value]:
        return ops.where(p[1] < 0, lower + p[0], lower), ops.where(p[1] > 0, upper + p[0], upper)

    def rebuilt(self, automaton: HybridAutomaton, coordinate: int, p: Sequence[float]) -> HybridAutomaton:
        return with_shifted_end(automaton, coordinate, p[0], p[1] > 0)


@final
class GuardHysteresis(EffectForm):
    """An end that was reached is left only by a command larger than `width`."""

    name, layer = "guard_hysteresis", "guard"
    sentence = "A threshold that was crossed in one direction takes more to be crossed in the other."
    source = "Goebel, Sanfelice and Teel, Hybrid dynamical systems, 2009: hysteresis"
    parameters = (Parameter("width", "coordinate", 0.0, 0.0),)

    def release(self, p: Values) -> Value:
        return p[0]

    def rebuilt(self, automaton: HybridAutomaton, coordinate: int, p: Sequence[float]) -> HybridAutomaton:
        return with_release(automaton, coordinate, p[0])
