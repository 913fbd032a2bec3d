"""Guards, pins and joints of an automaton, moved as a whole: what effects on ends and geometry do to it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Mode, Reset
from micah_plan.automaton.joint import Joint, rigid
from micah_plan.automaton.region import HalfSpace, Region, above, below
from micah_plan.errors import InputError

_SAME = 1e-6


def range_of(automaton: HybridAutomaton, coordinate: int) -> tuple[float, float]:
    """(low, high) over which some mode moves a coordinate; infinite where nothing ends it."""
    lows, highs = [], []
    for mode in automaton.modes:
        if not mode.driven[coordinate]:
            continue
        low, high = mode.invariant.interval(coordinate)
        lows.append(low)
        highs.append(high)
    return (min(lows), max(highs)) if lows else (0.0, 0.0)


def with_shifted_end(automaton: HybridAutomaton, coordinate: int, shift: float, is_upper: bool) -> HybridAutomaton:
    """The automaton with the upper or lower end of a coordinate's range moved, and what is held there with it."""
    end = range_of(automaton, coordinate)[1 if is_upper else 0]
    if not math.isfinite(end):
        name = automaton.coordinates[coordinate].name
        raise InputError(f"the range of {name} has no {'upper' if is_upper else 'lower'} end to shift")
    return _moved(automaton, coordinate, end, end + shift)


def with_end(automaton: HybridAutomaton, coordinate: int, at: float, is_upper: bool) -> HybridAutomaton:
    """The automaton with a stop at a configuration: its own end moved there, or new clamps where it has none."""
    end = range_of(automaton, coordinate)[1 if is_upper else 0]
    if math.isfinite(end):
        return _moved(automaton, coordinate, end, at)
    return _clamped(automaton, coordinate, at, is_upper)


def with_release(automaton: HybridAutomaton, coordinate: int, release: float) -> HybridAutomaton:
    """The automaton with modes that hold the coordinate left only by commands larger than `release`."""
    edges = []
    for edge in automaton.edges:
        holds = any(pin.coordinate == coordinate for pin in automaton.mode(edge.source).pins)
        rows = tuple(
            replace(h, c=h.c + release * abs(h.b[coordinate])) if h.b[coordinate] and not h.on_state else h
            for h in edge.guard.half_spaces
        )
        edges.append(replace(edge, guard=Region(rows)) if holds else edge)
    return replace(automaton, edges=tuple(edges))


def with_joints(automaton: HybridAutomaton, coordinate: int, change: Callable[[Joint], Joint]) -> HybridAutomaton:
    """The automaton with the joints of a coordinate changed, and rigid ones where the changed motion leads."""
    modes = []
    for mode in automaton.modes:
        joints = []
        for number, (link, joint) in enumerate(zip(automaton.links, mode.joints, strict=True)):
            if link.coordinate != coordinate:
                joints.append(joint)
            elif joint.kind == "rigid":
                joints.append(_held(change(_moving(automaton, number)), joint.held, joint))
            else:
                joints.append(change(joint))
        modes.append(replace(mode, joints=tuple(joints)))
    return replace(automaton, modes=tuple(modes))


def _moving(automaton: HybridAutomaton, link: int) -> Joint:
    joints = [mode.joints[link] for mode in automaton.modes]
    return next((joint for joint in joints if joint.kind != "rigid"), joints[0])


def _held(moving: Joint, at: float, before: Joint) -> Joint:
    if moving.kind == "rigid":
        return replace(before, held=at)
    from micah_plan.automaton.kinematics import forward

    pose = forward(moving, at)[0]
    return rigid(pose.translation, pose.rotation.as_quat(), at)


def _moved(automaton: HybridAutomaton, coordinate: int, old: float, new: float) -> HybridAutomaton:
    modes = tuple(_moved_mode(automaton, mode, coordinate, old, new) for mode in automaton.modes)
    edges = tuple(_moved_edge(edge, coordinate, old, new) for edge in automaton.edges)
    return replace(automaton, modes=modes, edges=edges)


def _moved_mode(automaton: HybridAutomaton, mode: Mode, i: int, old: float, new: float) -> Mode:
    pinned = any(pin.coordinate == i and abs(pin.value - old) <= _SAME for pin in mode.pins)
    pins = tuple(
        replace(pin, value=pin.value + new - old) if pinned and pin.coordinate == i else pin for pin in mode.pins
    )
    joints = []
    for number, (link, joint) in enumerate(zip(automaton.links, mode.joints, strict=True)):
        holds = pinned and link.coordinate == i and joint.kind == "rigid"
        joints.append(_held(_moving(automaton, number), joint.held + new - old, joint) if holds else joint)
    region = _moved_region(mode.invariant, i, None if pinned else old, new - old)
    return replace(mode, pins=pins, joints=tuple(joints), invariant=region)


def _moved_edge(edge: Edge, i: int, old: float, new: float) -> Edge:
    reset = edge.reset
    if edge.is_self_transition and reset.c is not None and abs(reset.c[i] - old) <= _SAME:
        reset = replace(reset, c=tuple(new if k == i else value for k, value in enumerate(reset.c)))
    return replace(edge, guard=_moved_region(edge.guard, i, old, new - old), reset=reset)


def _moved_region(region: Region, i: int, old: float | None, by: float) -> Region:
    """The region with its half-spaces on coordinate i alone moved: those at `old`, or all if that is None."""
    rows = []
    for half_space in region.half_spaces:
        bound = half_space.bound
        if bound is None or bound.coordinate != i or (old is not None and abs(bound.value - old) > _SAME):
            rows.append(half_space)
        else:
            threshold = half_space.c + half_space.a[i] * by
            rows.append(replace(half_space, c=threshold, name=_renamed(half_space, bound.value, bound.value + by)))
    return Region(tuple(rows))


def _renamed(half_space: HalfSpace, old: float, new: float) -> str:
    """The label with its number changed if it ends with the threshold; labels that people chose stay."""
    label = half_space.name
    return label.removesuffix(f"{old:g}") + f"{new:g}" if label.endswith(f" {old:g}") else label


def _clamped(automaton: HybridAutomaton, i: int, at: float, is_upper: bool) -> HybridAutomaton:
    n, m, label = automaton.n, automaton.m, automaton.coordinates[i].name
    guard = (above if is_upper else below)(i, at, n, m, strict=True, name=label)
    inside = (below if is_upper else above)(i, at, n, m, name=label)
    keep = tuple(tuple(float(r == k and r != i) for k in range(n)) for r in range(n))
    offset = tuple(at if k == i else 0.0 for k in range(n))
    moving = [mode.name for mode in automaton.modes if mode.driven[i]]
    modes = tuple(
        replace(mode, invariant=Region((*mode.invariant.half_spaces, inside))) if mode.name in moving else mode
        for mode in automaton.modes
    )
    clamps = tuple(Edge(name, name, Region((guard,)), Reset(A=keep, c=offset)) for name in moving)
    return replace(automaton, modes=modes, edges=(*automaton.edges, *clamps))
