"""Limits of a problem: the largest step of each input and the range of each coordinate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.effects.motion import CoordinateMotion, displaced, motions
from micah_plan.automaton.hybrid import HybridAutomaton, Mode
from micah_plan.planning.zero_time_transitions import ZeroTimeEdge
from micah_plan.task.problem import Problem

# Steps that cross a coordinate's whole range when neither the settings nor the automaton limit the input.
STEPS_PER_RANGE = 20.0
_HALVINGS = 40
# Of the largest input: where a drift takes all of it, a motion against it takes that many times as long.
_LEAST_ROOM = 0.02


@dataclass(frozen=True, eq=False)
class Limits:
    """Bounds of a plan.

    Attributes:
        max_step: (m,) largest |u| per step [rad or m]; none that effects on the command cut off.
        lower, upper: (n,) range in which the search looks for states [rad or m]; finite.
        speed: (n,) largest motion of each coordinate in one step, by inputs or otherwise by drift; 1 where there is
            none.
    """

    max_step: Floats
    lower: Floats
    upper: Floats
    speed: Floats


def limits_of(problem: Problem) -> Limits:
    """Limits from the settings, else from the admissible inputs, else from the coordinates' ranges."""
    automaton = problem.automaton
    lower, upper = _coordinate_range(problem)
    if problem.settings.max_step is not None:
        max_step = np.array(problem.settings.max_step, dtype=float)
    else:
        max_step = np.array([_default_step(automaton, j, upper - lower) for j in range(automaton.m)])
    if automaton.effects:
        max_step = np.array([_useful_step(automaton, j, float(most)) for j, most in enumerate(max_step)])
    gains = np.max([np.abs(motion_per_input(automaton, mode.name, max_step)) for mode in automaton.modes], axis=0)
    speed, start = gains @ max_step, np.array(problem.start.mean)
    by_itself = np.max([np.abs(drift_of(automaton, mode, start)) for mode in automaton.modes], axis=0)
    speed = np.where(speed > 0, speed, by_itself)
    return Limits(max_step, lower, upper, np.where(speed > 0, speed, 1.0))


def motion_per_input(automaton: HybridAutomaton, mode: str, largest: Floats) -> Floats:
    """(n, m) secant gain of a mode's flow between the largest inputs (m,) and their negatives.

    So larger corrections still count where a dead zone or a saturation has no slope.
    """
    B = automaton.mode(mode).B
    if not automaton.effects:
        return B
    inputs = np.concatenate([np.diag(largest), -np.diag(largest)])
    moved = displaced(automaton, automaton.mode(mode), np.zeros((len(inputs), automaton.n)), inputs)[0]
    return np.asarray((moved[: automaton.m] - moved[automaton.m :]).T / (2.0 * largest))


def drift_of(automaton: HybridAutomaton, mode: Mode, x: Floats) -> Floats:
    """(n,) drift per step of the coordinates that no input of a mode moves, at a state x (n,)."""
    if not automaton.effects:
        return np.zeros(automaton.n)
    moved = displaced(automaton, mode, x[None], np.zeros((1, automaton.m)))[0][0]
    return np.asarray(np.where(mode.driven | ~mode.free, 0.0, moved))


def drifts(problem: Problem) -> bool:
    """Whether a coordinate drifts without an input, so that time matters."""
    automaton, start = problem.automaton, np.array(problem.start.mean)
    return any(drift_of(automaton, mode, start).any() for mode in automaton.modes)


def holding_inputs(automaton: HybridAutomaton, mode: str, x: Floats, B: Floats) -> Floats:
    """(..., m) inputs that hold states x (..., n) against a bias, a spring or gravity.

    Args:
        B: (n, m) by which inputs move the mode.
    """
    nothing = np.zeros((*x.shape[:-1], automaton.m))
    if not automaton.effects:
        return nothing
    drift = displaced(automaton, automaton.mode(mode), x, nothing)[0]
    return np.asarray(-drift @ np.linalg.pinv(B).T)


def room_for_motion(held: Floats, max_step: Floats) -> Floats:
    """(..., m) largest inputs minus the share needed to hold still (..., m), at least a small remainder."""
    return np.asarray(np.maximum(max_step - np.abs(held), _LEAST_ROOM * max_step))


def input_length(path: Floats, B: Floats, bounds: tuple[Floats, Floats], held: Floats, drift: Floats) -> float:
    """Minimum number of steps (not rounded) along waypoints (w, n), by inputs through B (n, m) and drift.

    Args:
        bounds: (m,) lowest and (m,) highest inputs.
        held: (w, m) inputs that keep it at each waypoint.
        drift: (n,) per step, of coordinates that no input moves.
    """
    away, most = np.diff(path, axis=0), np.maximum(np.abs(held[:-1]), np.abs(held[1:]))
    u = away @ np.linalg.pinv(B).T
    lowest, highest = bounds
    steps = np.max(np.abs(u) / room_for_motion(most, np.where(u < 0.0, -lowest, highest)), axis=1, initial=0.0)
    moving = drift != 0.0
    waited = np.max(away[:, moving] / drift[moving], axis=1, initial=0.0)
    return float(np.sum(np.maximum(steps, waited)))


def limited_input(mode: Mode, x: Floats, u: Floats, max_step: Floats) -> Floats:
    """(..., m) inputs cut to |u| <= max_step and to the half-spaces of the mode's admissible inputs at x (..., n).

    A half-space that an input violates is met by the smallest change of u; one without input weights is left alone.
    """
    cut = np.clip(u, -max_step, max_step)
    for half_space in mode.inputs.half_spaces:
        b = np.array(half_space.b)
        if b.any():
            shortage = np.maximum(0.0, -half_space.margin(x, cut))
            cut = cut + b * (shortage[..., None] / float(b @ b))
    return np.asarray(np.clip(cut, -max_step, max_step))


def named_values(problem: Problem) -> list[list[float]]:
    """Values of each coordinate that occur in problem and model: start, goal, pins, boundaries and resets.

    A coordinate that follows others in a mode gets the range to which they take it.
    """
    automaton = problem.automaton
    values = [[float(mean)] for mean in problem.start.mean]
    for index, value, _ in problem.goal.target:
        values[index].append(value)
    for pin in (pin for mode in automaton.modes for pin in mode.pins):
        values[pin.coordinate].append(pin.value)
    regions = [mode.invariant for mode in automaton.modes]
    regions += [edge.guard for edge in automaton.edges if not isinstance(edge, ZeroTimeEdge)]
    for bound in (half_space.bound for region in regions for half_space in region.half_spaces):
        if bound is not None:
            values[bound.coordinate].append(bound.value)
    for edge in automaton.edges:
        if edge.reset.A is not None and edge.reset.c is not None:
            for i in np.flatnonzero(~np.any(edge.reset.A, axis=1)):
                values[i].append(float(edge.reset.c[i]))
    for tie in (tie for mode in automaton.modes for tie in mode.ties):
        led = [(w * min(v), w * max(v)) for w, v in zip(tie.weights, values, strict=True) if w]
        values[tie.coordinate] += [tie.offset + sum(map(pick, led)) for pick in (min, max)]
    return values


def _coordinate_range(problem: Problem) -> tuple[Floats, Floats]:
    """(n,) smallest and largest such values, extended where no invariant bounds a side."""
    values = named_values(problem)
    lower, upper = np.array([min(value) for value in values]), np.array([max(value) for value in values])
    inside = [h.bound for mode in problem.automaton.modes for h in mode.invariant.half_spaces if h.bound]
    bounded = {(bound.coordinate, bound.is_lower) for bound in inside}
    below, above = ([(i, is_lower) in bounded for i in range(len(values))] for is_lower in (True, False))
    room = np.where(upper > lower, 0.5 * (upper - lower), 1.0)
    return np.where(below, lower, lower - room), np.where(above, upper, upper + room)


def _default_step(automaton: HybridAutomaton, index: int, width: Floats) -> float:
    """Largest admissible |u| if the modes bound it on both sides, else a fraction of the range that it moves."""
    rows = [h for mode in automaton.modes for h in mode.inputs.half_spaces]
    rows = [h for h in rows if not h.on_state and np.count_nonzero(h.b) == 1 and h.b[index] != 0]
    if {np.sign(h.b[index]) for h in rows} == {-1.0, 1.0}:
        return float(max(abs(h.c / h.b[index]) for h in rows))
    gains = np.max([np.abs(mode.B[:, index]) for mode in automaton.modes], axis=0)
    steps = [width[i] / STEPS_PER_RANGE / gain for i, gain in enumerate(gains) if gain > 0 and width[i] > 0]
    return float(min(steps, default=1.0 / STEPS_PER_RANGE))


def _useful_step(automaton: HybridAutomaton, index: int, largest: float) -> float:
    """The smallest input with the effect of the largest: beyond a saturation more input has no effect.

    An optimiser that starts beyond would see no slope, and a search would count with steps that are never made.
    """
    useful = 0.0
    for mode in automaton.modes:
        acting = motions(automaton, mode)
        for i in np.flatnonzero(mode.B[:, index]):
            if i not in acting:
                return largest
            for sign in (1.0, -1.0):
                useful = max(useful, _reach(acting[int(i)], sign * float(mode.B[i, index]), largest))
    return useful or largest


def _reach(motion: CoordinateMotion, gain: float, largest: float) -> float:
    """The smallest input whose command has the effect of the largest input's; by bisection."""
    full = abs(motion.commanded(np, gain * largest))
    low, high = 0.0, largest
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if abs(motion.commanded(np, gain * middle)) >= full else (middle, high)
    return high
