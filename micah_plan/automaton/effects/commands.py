"""Effects between a command and the joint that have no memory."""

from __future__ import annotations

from typing import final

from micah_plan.automaton.effects.form import EffectForm, Operations, Parameter, Value, Values

_SPEED = Parameter("width", "coordinate", 0.0, 0.0)


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
    parameters = (_SPEED, Parameter("lost", "1", None, 0.0, 1.0))

    def command(self, ops: Operations, v: Value, p: Values) -> Value:
        return ops.where(ops.abs(v) <= p[0], 0.0 * v, v - ops.sign(v) * p[0] * p[1])
