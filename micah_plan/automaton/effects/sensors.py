"""Effects on sensor readings: affine functions of the configuration, which can be removed from logs."""

from __future__ import annotations

from typing import final

from micah_plan.automaton.effects.fit_start import CoordinateSeries, EquivalentEffect, FitStart
from micah_plan.automaton.effects.form import EffectForm, Operations, Parameter, Value, Values


@final
class SensorScale(EffectForm):
    """z = scale c."""

    name = "sensor_scale"
    sentence = "The sensor's unit is off by a factor."
    source = "Siciliano et al., Robotics, ch. 5: sensor calibration"
    parameters = (Parameter("scale", "1", 1.0, 0.2, 5.0),)
    complexity_rank = 16
    experiments = (
        (
            "gain",
            "drive the part against a stop whose place is known: a sensor's scale moves the stop's "
            "reading, a gain does not",
        ),
        ("guard_shift", "compare readings with a ruler in the middle of the range"),
    )

    def measured(self, ops: Operations, c: Value, time: Value, p: Values) -> Value:
        return p[0] * c

    def initial_guess(self, data: CoordinateSeries) -> FitStart | None:
        """Start on both sides of 1: with a wrong scale, rows at an end of the range are far off under any noise."""
        return FitStart([[0.9], [1.0], [1.1]], (0,), [0.3])

    def equivalent_effect(self, data: CoordinateSeries) -> EquivalentEffect | None:
        """A gain, unless an end of the range is visited, where sensor and motion errors differ."""
        return None if data.visits_end() else EquivalentEffect("gain")


@final
class SensorOffset(EffectForm):
    """z = c + offset."""

    name = "sensor_offset"
    sentence = "The sensor reads the same amount too much everywhere."
    source = "Siciliano et al., Robotics, ch. 5: sensor calibration"
    parameters = (Parameter("offset", "coordinate", 0.0),)
    in_library = False

    def measured(self, ops: Operations, c: Value, time: Value, p: Values) -> Value:
        return c + p[0]


@final
class Drift(EffectForm):
    """z = c + rate t, with t from the start of the run."""

    name = "drift"
    sentence = "The reading wanders away at a constant rate while the part may rest."
    source = "Titterton and Weston, Strapdown inertial navigation, ch. 4"
    parameters = (Parameter("rate", "coordinate/s", 0.0),)
    complexity_rank = 15
    experiments = (
        ("bias", "let the part rest against a stop: a sensor that drifts goes on, a bias does not"),
        ("guard_shift", "rest at the end for a while: a drifting reading goes on"),
    )

    def measured(self, ops: Operations, c: Value, time: Value, p: Values) -> Value:
        return c + p[0] * time

    def initial_guess(self, data: CoordinateSeries) -> FitStart | None:
        return FitStart([[0.0]], (0,), [0.3 * data.command_size / data.period])

    def equivalent_effect(self, data: CoordinateSeries) -> EquivalentEffect | None:
        """A bias, unless an end of the range is visited, where sensor and motion errors differ."""
        return None if data.visits_end() else EquivalentEffect("bias")
