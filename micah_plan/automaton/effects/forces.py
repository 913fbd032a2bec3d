"""Effects that add a motion depending on the configuration, including the unnamed correction."""

from __future__ import annotations

from typing import final

import numpy as np

from micah_plan.automaton.effects.fit_start import CoordinateSeries, EquivalentEffect, FitStart
from micah_plan.automaton.effects.form import EffectForm, Operations, Parameter, Value, Values

SMOOTH_BUMPS = 12
"""Bumps over the range of an unexplained correction."""


@final
class Spring(EffectForm):
    """-stiffness (c + ahead v - rest): `ahead` 1 is a spring that acts where the step ends, 0 where it starts."""

    name = "spring"
    sentence = "The joint is pulled towards a rest position, the more the further it is from it."
    source = "Hogan, Impedance control, J. Dyn. Sys. Meas. Control 1985: equilibrium of a spring and a compliant hand"
    parameters = (
        Parameter("stiffness", "1", 0.0, 0.0, 0.9),
        Parameter("rest", "coordinate"),
        Parameter("ahead", "1", None, 0.0, 1.0),
    )
    complexity_rank = 2
    experiments = (
        ("gain", "hold the commands at zero far from the rest position: only a spring moves the part"),
        ("bias", "visit the whole range: a spring's pull changes its sign, a bias does not"),
    )

    def force(self, ops: Operations, c: Value, v: Value, p: Values) -> Value:
        return -p[0] * (c + p[2] * v - p[1])

    def initial_guess(self, data: CoordinateSeries) -> FitStart | None:
        low, high = data.visited
        width = high - low + 1e-6
        rests = (low, 0.5 * (low + high), high)
        starts = [[0.05, rest, ahead] for rest in rests for ahead in (0.0, 1.0)]
        return FitStart(starts, (0, 1), [0.1, 0.5 * (high - low) + 1e-6], {1: (low - width, high + width)})


@final
class Gravity(EffectForm):
    """along + sine sin c + cosine cos c: gravity along the motion; only `along` for slides."""

    name = "gravity"
    sentence = "The joint sags under its weight, by an amount that depends on where it is."
    source = "Murray, Li and Sastry, ch. 4: torque of gravity about a fixed axis"
    parameters = (Parameter("sine", "rad", 0.0), Parameter("cosine", "rad", 0.0))
    complexity_rank = 3
    experiments = (
        ("bias", "visit the whole range: gravity changes with the angle, a bias does not"),
        ("spring", "visit a wider range of angles: gravity bends back, a spring does not"),
    )

    def force(self, ops: Operations, c: Value, v: Value, p: Values) -> Value:
        return p[0] * ops.sin(c) + p[1] * ops.cos(c)

    def initial_guess(self, data: CoordinateSeries) -> FitStart | None:
        return FitStart([[0.0, 0.0]], (0, 1), [0.3 * data.command_size] * 2)

    def equivalent_effect(self, data: CoordinateSeries) -> EquivalentEffect | None:
        """A bias, for slides."""
        return None if data.unit == "rad" else EquivalentEffect("bias")


@final
class Latch(EffectForm):
    """-strength x exp((1 - x²) / 2) with x = (c - at) / reach: the largest pull, `strength`, is at distance `reach`."""

    name = "latch"
    sentence = "Close to one configuration the joint is drawn to it, as by a magnet or a ball catch."
    source = "gradient of a Gaussian potential well; Koditschek, potential functions in robot navigation, 1989"
    parameters = (
        Parameter("strength", "coordinate", 0.0, 0.0),
        Parameter("at", "coordinate"),
        Parameter("reach", "coordinate", None, 1e-6),
    )
    complexity_rank = 13
    experiments = (("spring", "visit places far from the attraction: a spring pulls on, a latch lets go"),)

    def force(self, ops: Operations, c: Value, v: Value, p: Values) -> Value:
        x = (c - p[1]) / p[2]
        return -p[0] * x * ops.exp(0.5 - 0.5 * x * x)

    def initial_guess(self, data: CoordinateSeries) -> FitStart | None:
        low, high = data.visited
        width, reach, size = high - low + 1e-6, 0.08 * (high - low) + 1e-6, data.command_size
        starts = [[0.3 * size, at, reach] for at in np.linspace(low, high, 7)]
        return FitStart(
            starts, (0, 1, 2), [0.3 * size, reach, reach], {1: (low, high), 2: (0.01 * width, 0.25 * width)}
        )


@final
class Unexplained(EffectForm):
    """A smooth unnamed correction: radial basis functions of the configuration, alone and times the command.

    Parameters: `low` end and `width` of the range, `scale` of a command, `square`, `size` and `side` (factors of
    v |v| / scale, |v| and tanh(v / scale)), then `push_1..` and `gain_1..` of the bumps.
    """

    name = "unexplained"
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
    in_library = False

    def force(self, ops: Operations, c: Value, v: Value, p: Values) -> Value:
        low, width, scale = p[0], p[1], p[2]
        size = v / scale
        side = 1.0 - 2.0 / (1.0 + ops.exp(ops.minimum(ops.maximum(2.0 * size, -40.0), 40.0)))
        added = p[3] * v * ops.abs(size) + p[4] * ops.abs(v) + p[5] * side
        spacing = width / (SMOOTH_BUMPS - 1)
        x = (ops.minimum(ops.maximum(c, low), low + width) - low) / spacing
        # The sum of w_k exp(-(x - k)² / 2) is a polynomial in exp(x) times exp(-x² / 2): two exponentials, not twelve.
        pushes, gains, further = 0.0, 0.0, ops.exp(x)
        for k in reversed(range(SMOOTH_BUMPS)):
            lower = float(np.exp(-0.5 * k * k))
            pushes = pushes * further + lower * p[6 + k]
            gains = gains * further + lower * p[6 + SMOOTH_BUMPS + k]
        return added + ops.exp(-0.5 * x * x) * (pushes + gains * v)
