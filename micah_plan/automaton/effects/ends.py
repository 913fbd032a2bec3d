"""Effects on ends of motion, realised as changes of an automaton's guards and invariants."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import final

import numpy as np

from micah_plan.arrays import EQUAL, NEAR_STDS
from micah_plan.automaton.augmented import mapped
from micah_plan.automaton.effects.fit_start import CoordinateSeries, FitStart, command_sizes
from micah_plan.automaton.effects.form import EffectForm, Operations, Parameter, Value, Values
from micah_plan.automaton.effects.geometry import rigid_at
from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Mode, Pin, Reset
from micah_plan.automaton.region import HalfSpace, Region, above, below
from micah_plan.errors import InputError

# A threshold that lies further away than this share of the range is no shifted one but another stop.
_LARGEST_SHIFT = 0.15


@final
class Limit(EffectForm):
    """A stop inside of the model's range, at its upper (side 1) or lower (side -1) end."""

    name = "limit"
    sentence = "The motion is stopped inside of the range that the model knows."
    source = "Lygeros, Sastry and Tomlin, Hybrid systems: an invariant that is smaller than modelled"
    parameters = (Parameter("at", "coordinate"), Parameter("side", "1", None, -1.0, 1.0))
    complexity_rank = 12
    experiments = (
        (
            "guard_shift",
            "push the part against the end and look whether it latches: a shifted threshold changes "
            "the mode, a stop not",
        ),
    )

    def stops(self, ops: Operations, lower: Value, upper: Value, p: Values) -> tuple[Value, Value]:
        low = ops.where(p[1] < 0, ops.maximum(lower, p[0]), lower)
        high = ops.where(p[1] > 0, ops.minimum(upper, p[0]), upper)
        return low, high

    def rebuilt(self, automaton: HybridAutomaton, coordinate: int, p: Sequence[float]) -> HybridAutomaton:
        """The automaton with its end moved there, or with new clamps where it has none."""
        end = range_of(automaton, coordinate)[p[1] > 0]
        if math.isfinite(end):
            return with_end_moved(automaton, coordinate, end, p[0])
        return _with_clamps(automaton, coordinate, p[0], p[1] > 0)

    def initial_guess(self, data: CoordinateSeries) -> FitStart | None:
        low, high = data.visited
        starts = [[low + share * (high - low), 1.0] for share in (0.4, 0.6, 0.8, 0.95, 1.0)]
        starts += [[low + share * (high - low), -1.0] for share in (0.0, 0.05, 0.2, 0.4, 0.6)]
        return FitStart(starts, (0,), [0.1 * (high - low) + 1e-6])


@final
class GuardShift(EffectForm):
    """The threshold at one end of the range, upper (side 1) or lower (side -1), is shifted."""

    name = "guard_shift"
    sentence = "The threshold at which the motion changes lies elsewhere than in the model."
    source = "Lygeros, Sastry and Tomlin, Hybrid systems: guards"
    parameters = (Parameter("shift", "coordinate", 0.0), Parameter("side", "1", None, -1.0, 1.0))
    complexity_rank = 11

    def stops(self, ops: Operations, lower: Value, upper: Value, p: Values) -> tuple[Value, Value]:
        return ops.where(p[1] < 0, lower + p[0], lower), ops.where(p[1] > 0, upper + p[0], upper)

    def rebuilt(self, automaton: HybridAutomaton, coordinate: int, p: Sequence[float]) -> HybridAutomaton:
        end = range_of(automaton, coordinate)[p[1] > 0]
        if not math.isfinite(end):
            name, side = automaton.coordinates[coordinate].name, "upper" if p[1] > 0 else "lower"
            raise InputError(f"the range of {name} has no {side} end to shift")
        return with_end_moved(automaton, coordinate, end, end + p[0])

    def initial_guess(self, data: CoordinateSeries) -> FitStart | None:
        low, high = data.visited
        width, starts = high - low + 1e-6, []
        for end, side, reached in ((data.lower, -1.0, low), (data.upper, 1.0, high)):
            if np.isfinite(end):
                starts += [[reached - end, side], [0.05 * width, side], [-0.05 * width, side]]
        bounds = {0: (-_LARGEST_SHIFT * width, _LARGEST_SHIFT * width)}
        return FitStart(starts, (0,), [0.05 * width], bounds) if starts else None


@final
class GuardHysteresis(EffectForm):
    """A reached end is left only by a command larger than `width`.

    It acts at the ends where modes hold the coordinate; if none does, at every end, which then gets a mode that holds
    it there.
    """

    name = "guard_hysteresis"
    sentence = "A threshold that was crossed in one direction takes more to be crossed in the other."
    source = "Goebel, Sanfelice and Teel, Hybrid dynamical systems, 2009: hysteresis"
    parameters = (Parameter("width", "coordinate", 0.0, 0.0),)
    complexity_rank = 14
    experiments = (("guard_shift", "go through the threshold in both directions"),)

    def release(self, p: Values) -> Value:
        return p[0]

    def rebuilt(self, automaton: HybridAutomaton, coordinate: int, p: Sequence[float]) -> HybridAutomaton:
        if not any(is_held(automaton, coordinate, end) for end in range_of(automaton, coordinate)):
            return _with_holds(automaton, coordinate, p[0])

        def half_space(h: HalfSpace) -> HalfSpace:
            return h if h.on_state or not h.b[coordinate] else h.moved(p[0] * abs(h.b[coordinate]))

        def edge(original: Edge) -> Edge:
            pinned = not automaton.mode(original.source).free[coordinate]
            return replace(original, guard=original.guard.mapped(half_space)) if pinned else original

        return mapped(automaton, edge=edge)

    def initial_guess(self, data: CoordinateSeries) -> FitStart | None:
        """Starts only where the part may be held at an end that the recording reaches."""
        low, high = data.visited
        reach = 0.05 * (high - low)
        clings = (data.clings[0] and low < data.lower + reach) or (data.clings[1] and high > data.upper - reach)
        at = command_sizes(data, 0.3, 0.7, 0.95) if clings else []
        return FitStart([[q] for q in at], (0,), [0.3 * data.command_size]) if at else None


def range_of(automaton: HybridAutomaton, coordinate: int) -> tuple[float, float]:
    """(low, high) over which some mode moves a coordinate; infinite where unbounded."""
    moving = [mode.invariant.interval(coordinate) for mode in automaton.modes if mode.driven[coordinate]]
    return (min(low for low, _ in moving), max(high for _, high in moving)) if moving else (0.0, 0.0)


def is_held(automaton: HybridAutomaton, coordinate: int, end: float) -> bool:
    """Whether a mode holds a coordinate at an end of its range; otherwise that end is only the farthest row seen."""
    pins = (pin for mode in automaton.modes for pin in mode.pins)
    return any(pin.coordinate == coordinate and abs(pin.value - end) <= EQUAL for pin in pins)


def with_end_moved(automaton: HybridAutomaton, i: int, old: float, new: float) -> HybridAutomaton:
    """The automaton with one end of a coordinate's range moved, together with the pins there."""

    def moved(region: Region, *, all_of_it: bool = False) -> Region:
        """The region with the half-spaces on the coordinate alone moved, if they are at the old end."""
        return region.mapped(lambda h: _moved(h, i, new - old, None if all_of_it else old))

    def moved_mode(mode: Mode) -> Mode:
        if not any(pin.coordinate == i and abs(pin.value - old) <= EQUAL for pin in mode.pins):
            return replace(mode, invariant=moved(mode.invariant))
        pins = (replace(pin, value=pin.value + new - old) if pin.coordinate == i else pin for pin in mode.pins)
        joints = (
            rigid_at(automaton.moving_joint(number), joint.fixed_at + new - old, joint)
            if link.coordinate == i and not joint.moves
            else joint
            for number, (link, joint) in enumerate(zip(automaton.links, mode.joints, strict=True))
        )
        invariant = moved(mode.invariant, all_of_it=True)
        return replace(mode, pins=tuple(pins), joints=tuple(joints), invariant=invariant)

    def moved_edge(edge: Edge) -> Edge:
        reset = edge.reset
        if edge.is_self_transition and reset.c is not None and abs(reset.c[i] - old) <= EQUAL:
            reset = replace(reset, c=tuple(new if k == i else value for k, value in enumerate(reset.c)))
        return replace(edge, guard=moved(edge.guard), reset=reset)

    return mapped(automaton, moved_mode, moved_edge)


def _moved(half_space: HalfSpace, i: int, by: float, at: float | None) -> HalfSpace:
    """A half-space on coordinate i alone, moved if its limit is at a value (None: at any).

    A label that ends with the threshold gets the new one; custom labels are kept.
    """
    bound, label = half_space.bound, half_space.name
    if bound is None or bound.coordinate != i or (at is not None and abs(bound.value - at) > EQUAL):
        return half_space
    old = f"{bound.value:g}"
    label = label.removesuffix(old) + f"{bound.value + by:g}" if label.endswith(f" {old}") else label
    return replace(half_space.moved(half_space.a[i] * by), name=label)


def _with_clamps(automaton: HybridAutomaton, i: int, at: float, is_upper: bool) -> HybridAutomaton:
    """The automaton with a stop where a coordinate's range had no end."""
    n, m, label = automaton.n, automaton.m, automaton.coordinates[i].name
    guard = (above if is_upper else below)(i, at, n, m, strict=True, name=label)
    inside = (below if is_upper else above)(i, at, n, m, name=label)

    def with_clamp(mode: Mode) -> Mode:
        return replace(mode, invariant=Region((*mode.invariant.half_spaces, inside))) if mode.driven[i] else mode

    moving = (mode.name for mode in automaton.modes if mode.driven[i])
    clamps = tuple(Edge(name, name, Region((guard,)), Reset.to({i: at}, n)) for name in moving)
    return replace(mapped(automaton, with_clamp), edges=(*automaton.edges, *clamps))


def _with_holds(automaton: HybridAutomaton, i: int, width: float) -> HybridAutomaton:
    """The automaton with a mode in place of each clamp of a coordinate: it holds the part until a command releases it.

    Each has the other coordinates' motion of its mode.
    """
    for side, end in enumerate(range_of(automaton, i)):
        for mode in automaton.modes:
            if any(_clamps(edge, mode, i, end) for edge in automaton.edges):
                automaton = _with_hold(automaton, mode, i, end, side, width)
    return automaton


def _with_hold(automaton: HybridAutomaton, mode: Mode, i: int, end: float, side: int, width: float) -> HybridAutomaton:
    n, m, label, std = automaton.n, automaton.m, automaton.coordinates[i].name, automaton.noise.observation_std[i]
    flow = tuple(tuple(0.0 for _ in row) if k == i else row for k, row in enumerate(mode.input_matrix))
    joints = (
        rigid_at(joint, end, joint) if link.coordinate == i and joint.moves else joint
        for link, joint in zip(automaton.links, mode.joints, strict=True)
    )
    others = tuple(h for h in mode.invariant.half_spaces if h.bound is None or h.bound.coordinate != i)
    near = (above(i, end - NEAR_STDS * std, n, m, name=label), below(i, end + NEAR_STDS * std, n, m, name=label))
    held = replace(
        mode,
        name=f"{mode.name} held at {end:.3g}",
        joints=tuple(joints),
        input_matrix=flow,
        invariant=Region((*others, *near)),
        pins=(*mode.pins, Pin(i, end, std)),
    )
    sign = -1.0 if side else 1.0
    away = HalfSpace((0.0,) * n, tuple(sign * b for b in mode.input_matrix[i]), width, True, f"{label} pulled off")
    reached = (above if side else below)(i, end, n, m, strict=not side, name=label)
    edges = [
        Edge(mode.name, held.name, Region((reached,))) if _clamps(edge, mode, i, end) else edge
        for edge in automaton.edges
    ]
    kept = [
        replace(edge, source=held.name, target=held.name if edge.is_self_transition else edge.target)
        for edge in automaton.edges
        if edge.source == mode.name and not _is_of(edge, i)
    ]
    edges = sorted(
        [*edges, Edge(held.name, mode.name, Region((away,))), *kept], key=lambda edge: edge.is_self_transition
    )
    return replace(automaton, modes=(*automaton.modes, held), edges=tuple(edges))


def _clamps(edge: Edge, mode: Mode, i: int, end: float) -> bool:
    c = edge.reset.c
    is_own = edge.source == mode.name and edge.is_self_transition and c is not None and _is_of(edge, i)
    return is_own and c is not None and abs(c[i] - end) <= EQUAL


def _is_of(edge: Edge, i: int) -> bool:
    return any(h.a[i] != 0.0 for h in edge.guard.half_spaces)
