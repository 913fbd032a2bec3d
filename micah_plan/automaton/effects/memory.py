"""Effects between a command and the joint that remember earlier commands."""

from __future__ import annotations

import math
from typing import final

import numpy as np

from micah_plan.automaton.effects.form import EffectForm, Operations, Parameter, Value, Values

LONGEST_DELAY = 12


@final
class Delay(EffectForm):
    """v_t -> v_(t-delay), linear between whole steps."""

    name, layer = "delay", "memory"
    sentence = "Commands take effect later than they were given."
    source = "Laakso et al., Splitting the unit delay, IEEE Signal Processing Magazine 1996 (linear interpolation)"
    parameters = (Parameter("steps", "step", 0.0, 0.0, float(LONGEST_DELAY)),)

    def at_rest(self, p: Values) -> tuple[Value, ...]:
        # Many delays at once share a line for the longest.
        return (0.0,) * (LONGEST_DELAY if np.ndim(p[0]) else math.ceil(p[0]))

    def remember(
        self, ops: Operations, v: Value, memory: tuple[Value, ...], p: Values
    ) -> tuple[Value, tuple[Value, ...]]:
        sent = (v, *memory)
        # Of one delay only the whole steps before and after it count; many at once share the line.
        ages = range(len(sent)) if np.ndim(p[0]) else range(int(p[0]), min(int(p[0]) + 2, len(sent)))
        late = 0.0 * v
        for age in ages:
            late = late + ops.maximum(0.0, 1.0 - ops.abs(p[0] - age)) * sent[age]
        return late, sent[:-1]


@final
class Lag(EffectForm):
    """First-order lag with a time constant tau in steps: out_t = out_(t-1) + (1 - exp(-1 / tau)) (v_t - out_(t-1))."""

    name, layer = "lag", "memory"
    sentence = "The motion follows the command only gradually."
    source = "Astrom and Wittenmark, Computer-Controlled Systems, 3rd ed., section 2.3: sampled first-order system"
    parameters = (Parameter("steps", "step", 0.0, 0.0, 30.0),)

    def at_rest(self, p: Values) -> tuple[Value, ...]:
        return (0.0,)

    def remember(
        self, ops: Operations, v: Value, memory: tuple[Value, ...], p: Values
    ) -> tuple[Value, tuple[Value, ...]]:
        out = memory[0] + (1.0 - ops.exp(-1.0 / ops.maximum(p[0], 1e-3))) * (v - memory[0])
        return out, (out,)


@final
class Backlash(EffectForm):
    """Play of a width between drive and part; the memory is where the drive is within it.

    `side` says where it is at first: -1 and 1 at the ends (1: a positive command moves the part at once), 0 in the
    middle.
    """

    name, layer = "backlash", "memory"
    sentence = "When the direction reverses, a part of the motion is lost before the part follows."
    source = "Nordin and Gutman, Controlling mechanical systems with backlash, Automatica 2002 (play model)"
    parameters = (Parameter("width", "coordinate", 0.0, 0.0), Parameter("side", "1", None, -1.0, 1.0))

    def at_rest(self, p: Values) -> tuple[Value, ...]:
        return (0.5 * p[0] * p[1],)

    def remember(
        self, ops: Operations, v: Value, memory: tuple[Value, ...], p: Values
    ) -> tuple[Value, tuple[Value, ...]]:
        ahead = memory[0] + v
        kept = ops.maximum(ops.minimum(ahead, 0.5 * p[0]), -0.5 * p[0])
        return ahead - kept, (kept,)
