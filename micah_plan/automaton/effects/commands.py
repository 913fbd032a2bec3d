"""Effects on a command, without a memory."""

from __future__ import annotations

from typing import final

import numpy as np

from micah_plan.arrays import ROUND_OFF
from micah_plan.automaton.effects.fit_start import CoordinateSeries, FitStart, command_sizes, step_sizes
from micah_plan.automaton.effects.form import EffectForm, Operations, Parameter, Value, Values

# Smaller commands, as a share of the usual one, have no direction; with fewer rows than that share none is identified.
_TO_REST, _FEW = 0.05, 0.05


@final
class Gain(EffectForm):
    """v -> gain v."""

    name = "gain"
    sentence = "Every commanded displacement is carried out by a constant factor too far or too short."
    source = "Siciliano et al., Robotics, ch. 6: calibration of drives"
    parameters = (Parameter("gain", "1", 1.0),)
    complexity_rank = 0

    def command(self, ops: Operations, v: Value, p: Values) -> Value:
        return p[0] * v

    def initial_guess(self, data: CoordinateSeries) -> FitStart | None:
        """Start at 0.9 and at the regression of steps on commands: commands may be in millimetres."""
        starts = data.counted_starts[:, :-1]
        u, moved = data.u[:, :-1][starts], np.diff(data.z, axis=1)[starts]
        regressed = float(u @ moved) / max(float(u @ u), ROUND_OFF)
        return FitStart([[0.9], [regressed]], (0,), [0.3])


@final
class DirectionGain(EffectForm):
    """v -> forward v for v > 0, backward v for v < 0."""

    name = "direction_gain"
    sentence = "Motions one way are carried out by another share of the command than those the other way."
    source = "Armstrong-Helouvry et al., Automatica 1994, section 2: friction that depends on the direction"
    parameters = (Parameter("forward", "1", 1.0, 0.0), Parameter("backward", "1", 1.0, 0.0))
    complexity_rank = 18
    experiments = (("bias", "command steps of very different sizes: a gain takes a share of each, a bias the same"),)

    def command(self, ops: Operations, v: Value, p: Values) -> Value:
        return p[0] * ops.maximum(v, 0.0) + p[1] * ops.minimum(v, 0.0)

    def initial_guess(self, data: CoordinateSeries) -> FitStart | None:
        u = data.u[data.counted_starts]
        ways = [float((sign * u > _TO_REST * data.command_size).mean()) for sign in (1.0, -1.0)]
        if min(ways) < _FEW:
            return None
        return FitStart([[0.9, 0.7], [0.7, 0.9]], (0, 1), [0.3, 0.3])


@final
class Bias(EffectForm):
    """v -> v + bias."""

    name = "bias"
    sentence = "Every step moves by the same amount more, for any command."
    source = "Siciliano et al., Robotics, ch. 6: offset of a drive"
    parameters = (Parameter("bias", "coordinate", 0.0),)
    complexity_rank = 1

    def command(self, ops: Operations, v: Value, p: Values) -> Value:
        return v + p[0]


@final
class Saturation(EffectForm):
    """v -> v, at most `largest` in size."""

    name = "saturation"
    sentence = "No step is larger than a limit, however large the command."
    source = "Khalil, Nonlinear Systems, 3rd ed., section 1.2.7"
    parameters = (Parameter("largest", "coordinate", None, 0.0),)
    complexity_rank = 5
    experiments = (("gain", "command small and large steps: a limit only cuts the large ones"),)

    def command(self, ops: Operations, v: Value, p: Values) -> Value:
        return ops.maximum(ops.minimum(v, p[0]), -p[0])

    def initial_guess(self, data: CoordinateSeries) -> FitStart | None:
        # For commands that are places, or far larger than the limit, the motion determines it.
        at = [*command_sizes(data, 0.3, 0.6, 0.85), *step_sizes(data, 0.9, 0.98)]
        return FitStart([[q] for q in at], (0,), [0.3 * data.command_size]) if at else None


@final
class DeadZone(EffectForm):
    """v -> 0 for |v| <= width, else |v| minus `lost` times the width, with the sign of v."""

    name = "dead_zone"
    sentence = "Commands smaller than a threshold move nothing (dry friction); larger ones may lose as much."
    source = "Khalil, Nonlinear Systems, 3rd ed., sections 1.2.3 and 1.2.7; Armstrong-Helouvry et al., Automatica 1994"
    parameters = (Parameter("width", "coordinate", 0.0, 0.0), Parameter("lost", "1", None, 0.0, 1.0))
    complexity_rank = 4
    experiments = (("gain", "command steps of very different sizes: friction takes as much off each"),)

    def command(self, ops: Operations, v: Value, p: Values) -> Value:
        return ops.where(ops.abs(v) <= p[0], 0.0 * v, v - ops.sign(v) * p[0] * p[1])

    def initial_guess(self, data: CoordinateSeries) -> FitStart | None:
        at = command_sizes(data, 0.03, 0.1, 0.25, 0.45, 0.7)
        return FitStart([[q, lost] for q in at for lost in (0.0, 1.0)], (0,), [0.2 * data.command_size]) if at else None
