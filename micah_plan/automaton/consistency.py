"""Whether the values of an automaton agree with each other: pins, rigid joints, and where transitions lead.

Only what is certainly wrong is refused. Sets are boxes here (half-spaces that couple coordinates are left out, which
makes the sets larger), and a std that the model states itself is granted.
"""

from __future__ import annotations

import math

from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Mode, Pin
from micah_plan.automaton.region import Interval
from micah_plan.errors import InputError

_PIN_ROOM = 1e-9
_HELD_ROOM = 1e-6
_ENTRY_ROOM = 1e-6
_EVERYTHING = (-math.inf, math.inf)


def check_pin(automaton: HybridAutomaton, mode: Mode, pin: Pin) -> None:
    """Refuse a pin further outside of its own mode's invariant than its std."""
    low, high = mode.invariant.interval(pin.coordinate)
    room = _PIN_ROOM * max(1.0, abs(pin.value)) + pin.std
    if not low - room <= pin.value <= high + room:
        coordinate = automaton.coordinates[pin.coordinate]
        raise InputError(
            f"mode {mode.name}: the pin of {coordinate.name}, {pin.value:.9g} {coordinate.unit}, lies outside of the "
            f"mode's invariant {_text((low, high))}",
            remedy="move the pin or the invariant",
        )


def check_held(automaton: HybridAutomaton, mode: Mode, link: int) -> None:
    """Refuse a rigid joint that stands for another configuration than the one its mode pins."""
    joint, index = mode.joints[link], automaton.links[link].coordinate
    for pin in mode.pins:
        if joint.kind == "rigid" and pin.coordinate == index and not abs(joint.held - pin.value) <= _HELD_ROOM:
            coordinate = automaton.coordinates[index]
            raise InputError(
                f"mode {mode.name}: the rigid joint of {automaton.links[link].child} is held at {joint.held:.9g} "
                f"{coordinate.unit}, but the pin of {coordinate.name} says {pin.value:.9g} {coordinate.unit}",
                remedy="give both the same value",
            )


def check_connected(automaton: HybridAutomaton, mode: Mode) -> None:
    """Refuse a mode that no transition enters or leaves, where there are other modes."""
    changes = [edge for edge in automaton.edges if not edge.is_self_transition]
    if len(automaton.modes) > 1 and not any(mode.name in (edge.source, edge.target) for edge in changes):
        raise InputError(
            f"mode {mode.name} is not connected: no transition enters or leaves it",
            remedy="add a transition or remove the mode",
        )


def check_entry(automaton: HybridAutomaton, edge: Edge) -> None:
    """Refuse a change of mode that puts a coordinate outside of what the target's invariant allows for it."""
    if edge.is_self_transition:
        return
    source, target = automaton.mode(edge.source), automaton.mode(edge.target)
    before = _leaving_box(automaton, source, edge)
    if any(low > high for low, high in before):
        return  # the guard holds nowhere in the source; the edge is useless but leads nowhere wrong
    for index, (low, high) in enumerate(_after_reset(automaton, edge, before)):
        allowed = target.invariant.interval(index)
        room = _ENTRY_ROOM * max(1.0, *(abs(v) for v in (low, high, *allowed) if math.isfinite(v)))
        room += sum(pin.std for mode in (source, target) for pin in mode.pins if pin.coordinate == index)
        if low > allowed[1] + room or high < allowed[0] - room:
            name = automaton.coordinates[index].name
            raise InputError(
                f"edge {edge.name}: enters mode {target.name} at {name} = {_text((low, high))}, outside of its "
                f"invariant {_text(allowed)}",
                remedy="move the guard or the invariant, or give a reset",
            )


def _leaving_box(automaton: HybridAutomaton, source: Mode, edge: Edge) -> list[Interval]:
    """Per coordinate, where the state is when the edge is taken from within the source's invariant."""
    box = [source.interval(i) for i in range(automaton.n)]
    bounds = [half_space.bound for half_space in edge.guard.half_spaces]
    for i, (low, high) in enumerate(box):
        least, most = edge.guard.interval(i)
        only = bounds[0] if len(bounds) == 1 else None
        if only is not None and only.coordinate == i and source.driven[i]:
            _, value, is_lower = only
            if (low < value) if is_lower else (high > value):
                # The motion comes from where the guard does not hold, so the edge is taken on the guard's boundary.
                box[i] = (value, value)
                continue
        box[i] = (max(low, least), min(high, most))
    return box


def _after_reset(automaton: HybridAutomaton, edge: Edge, box: list[Interval]) -> list[Interval]:
    """A box that holds the reset's image of a box; without limits where the input or an unlimited state counts."""
    if edge.reset.is_identity:
        return box
    a, b, c = (matrix.tolist() for matrix in edge.reset.matrices(automaton.n, automaton.m))
    image = []
    for weights, inputs, offset in zip(a, b, c, strict=True):
        ends = [sorted((w * low, w * high)) for w, (low, high) in zip(weights, box, strict=True) if w]
        low, high = (offset + sum(end[k] for end in ends) for k in (0, 1))
        image.append(_EVERYTHING if any(inputs) or math.isnan(low) or math.isnan(high) else (low, high))
    return image


def _text(interval: Interval) -> str:
    low, high = interval
    return f"{low:.9g}" if low == high else f"[{low:.9g}, {high:.9g}]"
