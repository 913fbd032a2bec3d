"""Ends of one coordinate's motion in each measured row, from the mode and the other coordinates.

A drawer behind a door cannot move while the door is shut, and the door does not shut while the drawer is out. Ends are
where the automaton's own step takes a coordinate that is pushed too far. Noise may leave it open whether another
coordinate blocks it. Then such ends, and steps that depend on them, do not count against the model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from micah_plan.arrays import NEAR_STDS, Booleans, Floats, Ints
from micah_plan.automaton.drawn_thresholds import threshold_stds
from micah_plan.automaton.effects.ends import range_of
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.tracks import Track
from micah_plan.automaton.transition import TransitionBatch
from micah_plan.belief.filter import predict_belief, update
from micah_plan.errors import InputError
from micah_plan.residual.prediction import first_belief, inputs_of

_FAR = 10.0


@dataclass(frozen=True, eq=False)
class RowEnds:
    """The ends of T rows.

    Attributes:
        low, high: (T,) widest ends that noise leaves open, infinite where there is none [rad or m].
        narrow: (2, T) narrowest ends.
    """

    low: Floats
    high: Floats
    narrow: Floats

    def depends_on_noise(self, x: Floats, v: Floats) -> Booleans:
        """(T,) whether the result of a motion v (T,) from x (T,) depends on noise."""
        aim = x + v
        return np.asarray(np.clip(aim, self.low, self.high) != np.clip(aim, *self._reached(x)))

    def _reached(self, x: Floats) -> tuple[Floats, Floats]:
        """(lower, upper) ends of rows, extended to where they were measured [rad or m]."""
        # A part that was measured beyond a narrow end is not drawn back to it.
        return np.minimum(self.narrow[0], np.maximum(x, self.low)), np.maximum(self.narrow[1], np.minimum(x, self.high))


def row_modes(automaton: HybridAutomaton, x: Floats) -> Ints:
    """(T,) mode of each state (T, n): the one whose invariant and pins are violated least."""
    std = np.array([min(s, 1.0) for s in automaton.noise.observation_std])
    u = np.zeros((len(x), automaton.m))
    misses = []
    for mode in automaton.modes:
        worst = np.zeros(len(x))
        if mode.invariant.half_spaces:
            worst = np.maximum(worst, -mode.invariant.margins(x, u).min(axis=-1) / std.min())
        for pin in mode.pins:
            away = np.abs(x[:, pin.coordinate] - pin.value) / max(pin.std, std[pin.coordinate])
            worst = np.maximum(worst, np.where(away > 2.0, away, 0.0))
        # Being held is more specific than being somewhere in a range, so it comes first where both fit.
        misses.append(worst - 0.1 * bool(mode.pins) * (worst == 0))
    return np.asarray(np.argmin(np.stack(misses), axis=0))


@dataclass(frozen=True, eq=False)
class RowsSeen:
    """Model-based annotation of T rows: (T,) mode indices, and (T, n) measurement stds [rad or m]."""

    modes: Ints
    stds: Floats


def annotated_rows(automaton: HybridAutomaton, track: Track) -> RowsSeen:
    """Modes and noise of the rows of a run: from the configuration if one coordinate moves, else from a filter.

    With several moving coordinates, the mode at a place near a guard is ambiguous and follows from the rows before. The
    precision of a measurement depends on the true place, not on the reading: so it is evaluated at the predicted place.
    """
    sensing = [automaton.sensing(mode) for mode in automaton.modes]
    is_known = automaton.n == 1 and all(sensing.is_uniform for sensing in sensing)
    plain = replace(automaton, effects=())
    try:
        belief = None if is_known else first_belief(plain, track)
    except InputError:  # it starts where no mode is
        belief = None
    if belief is None:
        modes = row_modes(automaton, track.x)
        return RowsSeen(modes, np.stack([sensing.std_at(track.x) for sensing in sensing])[modes, np.arange(len(modes))])
    found = [belief.most_likely]
    stds = [sensing[belief.most_likely].std_over(belief.mean, belief.covariance)]
    for u, x in zip(inputs_of(track), track.x[1:], strict=True):
        ahead = predict_belief(plain, belief, u)
        belief = update(plain, ahead, x)
        found.append(belief.most_likely)
        stds.append(sensing[belief.most_likely].std_over(ahead.mean, ahead.covariance))
    return RowsSeen(np.array(found), np.array(stds))


def row_ends(automaton: HybridAutomaton, x: Floats, modes: Ints, i: int) -> RowEnds:
    """Ends of coordinate i in measured rows (T, n) with modes (T,)."""
    plain = replace(automaton, effects=())
    every = [_ends_of_push(plain, at, modes, i) for at in _alternatives(automaton, x, i)]
    lows, highs = np.stack([low for low, _ in every]), np.stack([high for _, high in every])
    return RowEnds(lows.min(axis=0), highs.max(axis=0), np.stack([lows.max(axis=0), highs.min(axis=0)]))


def _alternatives(automaton: HybridAutomaton, x: Floats, i: int) -> list[Floats]:
    """The rows, and variants with each other coordinate displaced by its noise."""
    configurations = [x]
    for j in range(automaton.n):
        for side in (-NEAR_STDS, NEAR_STDS) if j != i else ():
            configurations.append(x.copy())
            configurations[-1][:, j] += side * automaton.noise.observation_std[j]
    return configurations


def _ends_of_push(automaton: HybridAutomaton, x: Floats, modes: Ints, i: int) -> tuple[Floats, Floats]:
    """(low, high) that coordinate i reaches under a push far beyond the range; infinite where unbounded.

    A held coordinate moves only by an input: where it does, the required input is known (`CoordinateData.release`).
    """
    lower, upper = range_of(automaton, i)
    x = x.copy()
    x[:, i] = np.clip(x[:, i], lower, upper)
    finite = [end for end in (lower, upper) if np.isfinite(end)]
    far = _FAR * (np.ptp([*finite, *x[:, i]]) + 1.0)
    batch = TransitionBatch(automaton, np.zeros((len(x), len(threshold_stds(automaton)))))
    held = ~np.array([mode.free[i] for mode in automaton.modes])[modes]
    per_input = np.asarray(next(mode.B[i] for mode in automaton.modes if mode.driven[i]))
    ends = []
    for side in (-1.0, 1.0):
        push = np.zeros_like(x)
        push[:, i] = np.where(held, 0.0, side * far)
        u = np.outer(held * side * far, per_input / (per_input @ per_input))
        reached = batch.step(modes, x, u, push)[1][:, i]
        is_free = np.abs(reached - x[:, i] - side * far) < 1e-6 * far
        ends.append(np.where(is_free, side * np.inf, reached))
    return ends[0], ends[1]
