"""Speed-controlled machines: a valve or motor with a neutral, a dead zone, a curve, and a lag."""

from __future__ import annotations

import math
from itertools import product
from typing import final

import numpy as np

from micah_plan.arrays import ROUND_OFF, Booleans, Floats
from micah_plan.automaton.effects.fit_start import CoordinateSeries, FitStart, command_sizes, step_sizes
from micah_plan.automaton.effects.form import EffectForm, InForce, Memory, Operations, Parameter, Value, Values
from micah_plan.automaton.effects.memories import (
    LONGEST_DELAY,
    beyond_zone,
    in_force,
    is_constant,
    left_after,
    limited,
)

# Lags [steps] and dead zones (quantiles of the commands) at which fits begin.
_LAGS, _WIDTHS = (0.5, 1.5, 4.0), (0.1, 0.3)
# The quantile of steps that a limit of speed cuts, and limits over it: one that cuts, and one that does not.
_FASTEST, _LIMITS = 0.98, (1.0, 3.0)
# How much of a speed a regression takes to last from step to step at most.
_SLOWEST = 0.95


@final
class Drive(EffectForm):
    """Speed commands: the part's speed follows with a first-order lag (time constant `lag` in steps):

    e = v - neutral, b = sign(e) max(|e| - width, 0), w = gain b (1 + curve |b|), or gain b / (1 - curve |b|) if the
    curve is negative, times `backward` if it is directed backward, at most `speed` in size; ds/dt = (w - s) / lag, and
    a step is the integral of s over it, with the command v of `delay` steps before.

    A delay that ends within a step uses the older command for a share of it, and then the newer one. A lag behind a
    dead zone goes on where the command is within it, whereas a dead zone behind a lag (`dead_zone`) stops at once.
    """

    name = "drive"
    sentence = "Commands set a speed, as those of a valve or a motor do, and the part gets to it gradually."
    source = (
        "Merritt, Hydraulic Control Systems, 1967, ch. 5 (overlapped valves); Astrom and Wittenmark, "
        "Computer-Controlled Systems, 3rd ed., section 2.3 (sampled first-order system)"
    )
    parameters = (
        Parameter("gain", "1", 1.0),
        Parameter("lag", "step", 0.0, 0.0, 30.0),
        Parameter("delay", "step", 0.0, 0.0, float(LONGEST_DELAY), is_optional=True),
        Parameter("neutral", "coordinate", 0.0, is_optional=True),
        Parameter("width", "coordinate", 0.0, 0.0, is_optional=True),
        Parameter("backward", "1", 1.0, 0.0, is_optional=True),
        Parameter("curve", "1/coordinate", 0.0, is_optional=True),
        Parameter("speed", "coordinate", math.inf, 0.0, is_optional=True),
    )
    experiments = (
        ("dead_zone", "command one long step and then none: a drive goes on moving, friction stops it at once"),
        ("lag", "command steps of very different sizes: a dead zone takes as much off each, a lag the same share"),
    )
    late_by = 2

    def at_rest(self, p: Values) -> Memory:
        return (0.0, *(0.0,) * math.ceil(p[2]))

    def in_motion(self, c: Value, step: Value, p: Values) -> Memory:
        return (step, *self.at_rest(p)[1:])

    def remember(self, ops: Operations, v: Value, memory: Memory, p: Values) -> tuple[Value, Memory]:
        sent, kept = in_force(v, memory[1:], p[2])
        out, speed = self.remember_late(ops, sent, memory[:1], p)
        return out, (*speed, *kept)

    def remember_late(self, ops: Operations, sent: InForce, memory: Memory, p: Values) -> tuple[Value, Memory]:
        gain, lag, _, neutral, width, backward, curve, most = p

        def set_speed(v: Value) -> Value:
            beyond = beyond_zone(ops, v - neutral, width)
            bent = curve * ops.abs(beyond)
            speed = gain * beyond * (1.0 + ops.maximum(bent, 0.0)) / (1.0 - ops.minimum(bent, 0.0))
            return limited(ops, ops.maximum(speed, 0.0) + backward * ops.minimum(speed, 0.0), most)

        def driven(speed: Value, to: Value, share: Value) -> tuple[Value, Value]:
            """(displacement, speed) after a fraction of a step."""
            kept = left_after(ops, share, lag)
            return share * to + lag * (1.0 - kept) * (speed - to), to + kept * (speed - to)

        if is_constant(sent.late) and not sent.late:
            way, speed = driven(memory[0], set_speed(sent.newer), 1.0)
            return way, (speed,)
        first, speed = driven(memory[0], set_speed(sent.older), sent.late)
        second, speed = driven(speed, set_speed(sent.newer), 1.0 - sent.late)
        return first + second, (speed,)

    def initial_guess(self, data: CoordinateSeries) -> FitStart | None:
        """Gain and delay from a regression of steps, combined with several lags, dead zones and limits."""
        gain, delay = _regressed_gain_and_delay(data)
        size, fastest = data.command_size, max(step_sizes(data, _FASTEST), default=data.command_size)
        tried = product(_LAGS, sorted({0.0, delay}), (0.0, *command_sizes(data, *_WIDTHS)), _LIMITS)
        values = [[gain, lag, late, 0.0, width, 1.0, 0.0, limit * fastest] for lag, late, width, limit in tried]
        large = [0.3, 1.0, 1.0, 0.3 * size, 0.2 * size, 0.3, 1.0 / size, 0.3 * fastest]
        return FitStart(values, tuple(range(len(large))), large)


def _regressed_gain_and_delay(data: CoordinateSeries) -> tuple[float, float]:
    """Gain and whole delay [steps] by regression of steps on earlier commands, earlier steps, and a constant."""
    steps = np.diff(data.z, axis=1)
    counts = data.counted_starts[:, :-1]
    longest = max(min(LONGEST_DELAY, steps.shape[1] - 3), 0)
    found = [_regressed_gain(steps, data.u, counts, late) for late in range(longest + 1)]
    _, gain, late = min(found)
    return gain, float(late)


def _regressed_gain(steps: Floats, u: Floats, counts: Booleans, late: int) -> tuple[float, float, int]:
    """(mean squared error, gain, late) of a delay."""
    used = counts[:, late + 1 :] & counts[:, late:-1]
    moved, before = steps[:, late + 1 :][used], steps[:, late:-1][used]
    command = u[:, 1 : steps.shape[1] - late][used]
    if len(moved) < 4 or np.ptp(command) < ROUND_OFF:
        return np.inf, 1.0, late
    given = np.stack([command, before, np.ones(len(moved))], axis=1)
    solution = np.linalg.lstsq(given, moved, rcond=None)[0]
    kept = min(max(float(solution[1]), 0.0), _SLOWEST)
    return float(np.mean((moved - given @ solution) ** 2)), float(solution[0]) / (1.0 - kept), late
