"""The library's forms that are one formula each: on a command without and with memory, on the motion, on the reading.

Those that change guards or joints are in `ends` and `geometry`.
"""

from __future__ import annotations

import math
from typing import final

import numpy as np

from micah_plan.automaton.effects.form import EffectForm, Memory, Operations, Parameter, Value, Values

LONGEST_DELAY = 12
"""The longest delay [steps]."""
SMOOTH_BUMPS = 12
"""Bumps over the range of an unexplained correction."""


@final
class Gain(EffectForm):
    """v -> gain v."""

    name, layer = "gain", "command"
    sentence = "Every commanded displacement is carried out by a constant factor too far or too short."
    source = "Siciliano et al., Robotics, ch. 6: calibration of drives"
    parameters = (Parameter("gain", "1", 1.0),)

    def command(self, ops: Operations, v: Value, p: Values) -> Value:
        return p[0] * v


@final
class Bias(EffectForm):
    """v -> v + bias."""

    name, layer = "bias", "command"
    sentence = "Every step moves by the same amount more, whatever is commanded."
    source = "Siciliano et al., Robotics, ch. 6: offset of a drive"
    parameters = (Parameter("bias", "coordinate", 0.0),)

    def command(self, ops: Operations, v: Value, p: Values) -> Value:
        return v + p[0]


@final
class Saturation(EffectForm):
    """v -> v, at most `largest` in size."""

    name, layer = "saturation", "command"
    sentence = "No step is larger than a limit, however large the command."
    source = "Khalil, Nonlinear Systems, 3rd ed., section 1.2.7"
    parameters = (Parameter("largest", "coordinate", None, 0.0),)

    def command(self, ops: Operations, v: Value, p: Values) -> Value:
        return ops.maximum(ops.minimum(v, p[0]), -p[0])


@final
class DeadZone(EffectForm):
    """v -> 0 for |v| <= width, else v less `lost` times the width."""

    name, layer = "dead_zone", "command"
    sentence = "Commands smaller than a threshold move nothing (dry friction); larger ones may lose as much."
    source = "Khalil, Nonlinear Systems, 3rd ed., sections 1.2.3 and 1.2.7; Armstrong-Helouvry et al., Automatica 1994"
    parameters = (Parameter("width", "coordinate", 0.0, 0.0), Parameter("lost", "1", None, 0.0, 1.0))

    def command(self, ops: Operations, v: Value, p: Values) -> Value:
        return ops.where(ops.abs(v) <= p[0], 0.0 * v, v - ops.sign(v) * p[0] * p[1])


@final
class Delay(EffectForm):
    """v_t -> v_(t-delay), linear between whole steps."""

    name, layer = "delay", "memory"
    sentence = "Commands take effect later than they were given."
    source = "Laakso et al., Splitting the unit delay, IEEE Signal Processing Magazine 1996 (linear interpolation)"
    parameters = (Parameter("steps", "step", 0.0, 0.0, float(LONGEST_DELAY)),)

    def at_rest(self, p: Values) -> Memory:
        # Many delays at once share a line for the longest.
        return (0.0,) * (LONGEST_DELAY if np.ndim(p[0]) else math.ceil(p[0]))

    def remember(self, ops: Operations, v: Value, memory: Memory, p: Values) -> tuple[Value, Memory]:
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

    def at_rest(self, p: Values) -> Memory:
        return (0.0,)

    def remember(self, ops: Operations, v: Value, memory: Memory, p: Values) -> tuple[Value, Memory]:
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

    def at_rest(self, p: Values) -> Memory:
        return (0.5 * p[0] * p[1],)

    def remember(self, ops: Operations, v: Value, memory: Memory, p: Values) -> tuple[Value, Memory]:
        ahead = memory[0] + v
        kept = ops.maximum(ops.minimum(ahead, 0.5 * p[0]), -0.5 * p[0])
        return ahead - kept, (kept,)


@final
class StickSlip(EffectForm):
    """What is commanded adds up while the part sticks, and arrives at once when it is more than a grip."""

    name, layer = "stick_slip", "memory"
    sentence = "The part sticks until what was commanded has added up, and then makes up for it at once."
    source = (
        "Karnopp, Computer simulation of stick-slip friction, ASME J. Dynamic Systems 1985 (without the slip's time)"
    )
    parameters = (Parameter("grip", "coordinate", 0.0, 0.0),)

    def at_rest(self, p: Values) -> Memory:
        return (0.0 * p[0],)

    def remember(self, ops: Operations, v: Value, memory: Memory, p: Values) -> tuple[Value, Memory]:
        wound = memory[0] + v
        gone = ops.where(ops.abs(wound) < p[0], 0.0 * wound, wound)
        return gone, (wound - gone,)


@final
class Follow(EffectForm):
    """Commands are places r_t = c_t + v_t, and the part goes after them, wherever it is:

    c_(t+1) - c_t = momentum (c_t - c_(t-1)) + share z(gain r_(t-delay) + offset - c_t), with
    z(e) = sign(e) max(|e| - width, 0).

    First order without a momentum, second order with one. A place stays where it is in the base frame: what the part
    missed before is made up for. With all parameters neutral the part is at the place after each step.
    """

    name, layer = "follow", "place"
    sentence = "Commands are places: the part goes a share of the way to the commanded place in each step."
    source = "Astrom and Wittenmark, Computer-Controlled Systems, 3rd ed., ch. 2; Hogan, Impedance control, 1985"
    parameters = (
        Parameter("share", "1", 1.0, 0.0, 2.0),
        Parameter("offset", "coordinate", 0.0),
        Parameter("gain", "1", 1.0, 0.0, 3.0),
        Parameter("delay", "step", 0.0, 0.0, float(LONGEST_DELAY)),
        Parameter("momentum", "1", 0.0, -0.5, 0.995),
        Parameter("width", "coordinate", 0.0, 0.0),
    )

    def at_rest_in(self, c: Value, p: Values) -> Memory:
        count = LONGEST_DELAY if np.ndim(p[3]) else math.ceil(p[3])
        return (c, *(c,) * count)

    def respond(self, ops: Operations, c: Value, v: Value, memory: Memory, p: Values) -> tuple[Value, Memory]:
        late, line = Delay().remember(ops, c + v, memory[1:], p[3:4])
        away = p[2] * late + p[1] - c
        beyond = ops.maximum(away - p[5], 0.0) + ops.minimum(away + p[5], 0.0)
        return p[4] * (c - memory[0]) + p[0] * beyond, (c, *line)


@final
class Spring(EffectForm):
    """-stiffness (c + ahead v - rest): `ahead` 1 is a spring that acts where the step ends, 0 where it starts."""

    name, layer = "spring", "force"
    sentence = "The joint is pulled towards a rest position, the more the further it is from it."
    source = "Hogan, Impedance control, J. Dyn. Sys. Meas. Control 1985: equilibrium of a spring and a compliant hand"
    parameters = (
        Parameter("stiffness", "1", 0.0, 0.0, 0.9),
        Parameter("rest", "coordinate"),
        Parameter("ahead", "1", None, 0.0, 1.0),
    )

    def force(self, ops: Operations, c: Value, v: Value, p: Values) -> Value:
        return -p[0] * (c + p[2] * v - p[1])


@final
class Gravity(EffectForm):
    """along + sine sin c + cosine cos c: the pull of gravity along the motion; `along` for slides, else 0."""

    name, layer = "gravity", "force"
    sentence = "The joint sags under its weight, by an amount that depends on where it is."
    source = "Murray, Li and Sastry, ch. 4: torque of gravity about a fixed axis"
    parameters = (Parameter("sine", "rad", 0.0), Parameter("cosine", "rad", 0.0))

    def force(self, ops: Operations, c: Value, v: Value, p: Values) -> Value:
        return p[0] * ops.sin(c) + p[1] * ops.cos(c)


@final
class Latch(EffectForm):
    """-strength x exp((1 - x²) / 2) with x = (c - at) / reach: the pull is largest, `strength`, `reach` away."""

    name, layer = "latch", "force"
    sentence = "Close to one configuration the joint is drawn to it, as by a magnet or a ball catch."
    source = "gradient of a Gaussian potential well; Koditschek, potential functions in robot navigation, 1989"
    parameters = (
        Parameter("strength", "coordinate", 0.0, 0.0),
        Parameter("at", "coordinate"),
        Parameter("reach", "coordinate", None, 1e-6),
    )

    def force(self, ops: Operations, c: Value, v: Value, p: Values) -> Value:
        x = (c - p[1]) / p[2]
        return -p[0] * x * ops.exp(0.5 - 0.5 * x * x)


@final
class Unexplained(EffectForm):
    """A smooth correction without a name: bumps over the configuration, alone and times the command.

    Parameters: `low` end and `width` of the range, `scale` of a command, `square`, `size` and `side` (factors of
    v |v| / scale, |v| and tanh(v / scale)), then `push_1..` and `gain_1..` of the bumps.
    """

    name, layer = "unexplained", "force"
    sentence = "A smooth correction that no named effect accounts for."
    source = "Poggio and Girosi, Networks for approximation and learning, 1990 (radial basis functions)"
    parameters = (
        Parameter("low", "coordinate"),
        Parameter("width", "coordinate", None, 1e-9),
        Parameter("scale", "coordinate", None, 1e-12),
        Parameter("square", "1", 0.0),
        Parameter("size", "1", 0.0),
        Parameter("side", "coordinate", 0.0),
        *(Parameter(f"push_{k + 1}", "coordinate", 0.0) for k in range(SMOOTH_BUMPS)),
        *(Parameter(f"gain_{k + 1}", "1", 0.0) for k in range(SMOOTH_BUMPS)),
    )

    def force(self, ops: Operations, c: Value, v: Value, p: Values) -> Value:
        low, width, scale = p[0], p[1], p[2]
        size = v / scale
        side = 1.0 - 2.0 / (1.0 + ops.exp(ops.minimum(ops.maximum(2.0 * size, -40.0), 40.0)))
        added = p[3] * v * ops.abs(size) + p[4] * ops.abs(v) + p[5] * side
        spacing = width / (SMOOTH_BUMPS - 1)
        inside = ops.minimum(ops.maximum(c, low), low + width)
        for k in range(SMOOTH_BUMPS):
            x = (inside - low - k * spacing) / spacing
            bump = ops.exp(-0.5 * x * x)
            added = added + bump * (p[6 + k] + p[6 + SMOOTH_BUMPS + k] * v)
        return added


@final
class SensorScale(EffectForm):
    """z = scale c."""

    name, layer = "sensor_scale", "sensor"
    sentence = "The sensor's unit is off by a factor."
    source = "Siciliano et al., Robotics, ch. 5: sensor calibration"
    parameters = (Parameter("scale", "1", 1.0, 0.2, 5.0),)

    def measured(self, ops: Operations, c: Value, time: Value, p: Values) -> Value:
        return p[0] * c


@final
class SensorOffset(EffectForm):
    """z = c + offset."""

    name, layer = "sensor_offset", "sensor"
    sentence = "The sensor reads the same amount too much everywhere."
    source = "Siciliano et al., Robotics, ch. 5: sensor calibration"
    parameters = (Parameter("offset", "coordinate", 0.0),)

    def measured(self, ops: Operations, c: Value, time: Value, p: Values) -> Value:
        return c + p[0]


@final
class Drift(EffectForm):
    """z = c + rate t, with t from the start of the run."""

    name, layer = "drift", "sensor"
    sentence = "The reading wanders away at a constant rate while the part may rest."
    source = "Titterton and Weston, Strapdown inertial navigation, ch. 4"
    parameters = (Parameter("rate", "coordinate/s", 0.0),)

    def measured(self, ops: Operations, c: Value, time: Value, p: Values) -> Value:
        return c + p[0] * time
