"""Effects on the reading: what the sensor says of a configuration."""

from __future__ import annotations

from typing import final

from micah_plan.automaton.effects.form import EffectForm, Operations, Parameter, Value, Values


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
class Drift(EffectForm):
    """z = c + rate t, with t from the start of the run."""

    name, layer = "drift", "sensor"
    sentence = "The reading wanders away at a constant rate while the part may rest."
    source = "Titterton and Weston, Strapdown inertial navigation, ch. 4"
    parameters = (Parameter("rate", "coordinate/s", 0.0),)

    def measured(self, ops: Operations, c: Value, time: Value, p: Values) -> Value:
        return c + p[0] * time
