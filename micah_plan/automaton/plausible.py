"""Plausibility checks of usable automata: nothing is refused, each suspicion is one line.

- **Sizes.** Every number of a file is compared with the scale that the rest of the file gives it (`Amount`): the noise
  of one step, the stds of a measurement, a pin or a threshold, and the target of a reset with the range of the
  coordinate; lengths with a room; bodies with what a hand can see and hold.
- **Jumps.** A part is where it was when a transition is taken. If the joints of its two modes place it more than
  `LARGEST_JUMP_M` apart, one of them was probably edited. Smaller jumps are common: joints are estimates.
- **Never taken.** Of transitions that are possible at one instant the first listed is taken, so one that is listed
  behind a more general one is not.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton import messages
from micah_plan.automaton.check import preceding
from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Part, Primitive
from micah_plan.automaton.joint import radius
from micah_plan.automaton.motion_of_joints import turns_and_translations
from micah_plan.quantities import FARTHEST_M

LARGEST_JUMP_M = 0.2
FARTHEST_SOLID_M = 1000.0
"""Solids may be further: domains of 100 m are planned in."""
_THINNEST_M = 1e-4
"""A sheet of paper: what is thinner is no solid that a hand or a tracker meets."""


@dataclass(frozen=True)
class Amount:
    """A number of a file with the scale it is compared to.

    Attributes:
        place: its key.
        size: the number, in `unit`; its sign does not count.
        most: warn above it, in the same unit; not finite or not above 0: not compared.
        than: description of `most`, after "is more than"; empty: a length that is too large for metres.
        least: warn below it.
    """

    place: str
    size: float
    unit: str
    most: float
    than: str = ""
    least: float = 0.0


def implausible(amounts: Iterable[Amount]) -> Iterator[str]:
    """One line for each amount beyond its scale: place, amount, scale, remedy."""
    for amount in amounts:
        size = abs(amount.size)
        found = amount.place, size, amount.unit
        if size > amount.most and 0.0 < amount.most < math.inf:
            if amount.than:
                yield messages.number_too_large(*found, amount.most, amount.than)
            else:
                yield messages.length_too_large(*found)
        elif 0.0 < size < amount.least:
            yield messages.number_too_small(*found, amount.least)


def suspicions_of_automaton(automaton: HybridAutomaton) -> tuple[str, ...]:
    """Suspicious values of an automaton, one line each with its place; empty if there are none."""
    jumps = (line for edge in automaton.edges if not edge.is_self_transition for line in _jumps(automaton, edge))
    sizes = implausible((*_distances(automaton), *part_amounts(automaton.parts), *_along_coordinates(automaton)))
    return (*sizes, *implausible(_of_actions(automaton)), *jumps, *never_taken(automaton))


def part_amounts(parts: Iterable[Part]) -> Iterator[Amount]:
    """Handles and solids of parts, compared with the size of a room."""
    for part in parts:
        if part.handle is not None:
            yield Amount(f"parts.{part.name}.handle", length(part.handle), "m", FARTHEST_M)
        yield from solid_amounts(f"parts.{part.name}", [shape for shape in part.shapes if isinstance(shape, Primitive)])


def solid_amounts(place: str, shapes: Sequence[Primitive]) -> Iterator[Amount]:
    """Sizes and places of solids, compared with the largest domain and the thinnest material."""
    for i, shape in enumerate(shapes):
        for size in shape.size:
            yield Amount(f"{place}.shapes.{i}.size", size, "m", FARTHEST_SOLID_M, least=_THINNEST_M)
        yield Amount(f"{place}.shapes.{i}.position", length(shape.position), "m", FARTHEST_SOLID_M)


def whole_range(automaton: HybridAutomaton, i: int) -> float:
    """Extent of a coordinate's ranges [rad or m]; infinite if unbounded."""
    ranges = automaton.ranges(i)
    return ranges[-1][1] - ranges[0][0] if ranges else math.inf


def length(vector: Sequence[float]) -> float:
    """Euclidean norm, in the vector's unit."""
    return float(np.linalg.norm(vector))


def _distances(automaton: HybridAutomaton) -> Iterator[Amount]:
    for mode in automaton.modes:
        for link, joint in zip(automaton.links, mode.joints, strict=True):
            place = f"modes.{mode.name}.joints.{link.child}"
            yield Amount(place, length(joint.position), "m", FARTHEST_M)
            yield Amount(f"{place}: radius", radius(joint), "m", FARTHEST_M)
    for i, coordinate in enumerate(automaton.coordinates):
        whole = whole_range(automaton, i)
        if coordinate.unit == "m" and math.isfinite(whole):
            yield Amount(f"coordinates.{coordinate.name}: range", whole, "m", FARTHEST_M)


def _of_actions(automaton: HybridAutomaton) -> Iterator[Amount]:
    """Values of the learned action channel, as used by `predict`."""
    for i, edge in enumerate(automaton.learned):
        if edge.certainty is not None and edge.certainty.channel is not None:
            place, channel = f"learned.{i}.actions", edge.certainty.channel
            yield Amount(f"{place}.gain", channel.gain, "", 100.0, "a hand can gain")
            yield Amount(f"{place}.delay", channel.delay, "s", 60.0, "an object waits for")
            yield Amount(f"{place}.frame_rotation", length(channel.frame_rotation), "rad", 2.0 * math.pi, "a turn")


def _along_coordinates(automaton: HybridAutomaton) -> Iterator[Amount]:
    """Steps, measurements and places, compared with the range of their coordinate."""
    resets = [(edge, edge.reset.matrices(automaton.n, automaton.m)) for edge in automaton.edges]
    for i, coordinate in enumerate(automaton.coordinates):
        name, unit, whole = coordinate.name, coordinate.unit, whole_range(automaton, i)
        middle = sum((automaton.ranges(i)[0][0], automaton.ranges(i)[-1][1])) / 2 if math.isfinite(whole) else 0.0
        than = f"the whole range of {name}"
        noise = automaton.noise
        yield Amount(f"noise.process_std.{name}", noise.process_std[i], unit, whole, than)
        yield Amount(f"noise.observation_std.{name}", noise.observation_std[i], unit, whole, than)
        for edge in automaton.edges:
            if any(half_space.a[i] for half_space in edge.guard.half_spaces):
                yield Amount(f"transition {edge.name}: threshold_std", edge.threshold_std, unit, whole, than)
        for edge, (A, _, c) in resets:
            if not A[i].any():  # it puts the coordinate at c
                place = f"transition {edge.name}: reset of {name} leads"
                yield Amount(place, c[i] - middle, unit, whole, f"{than} away from its middle")
        for mode in automaton.modes:
            for pin in mode.pins:
                if pin.coordinate == i:
                    yield Amount(f"modes.{mode.name}.pins.{name}.std", pin.std, unit, whole, than)
        for effect in automaton.effects:
            if effect.name == "bias" and effect.coordinate == name and effect.modes:
                place = f"modes.{', '.join(effect.modes)}: drift of {name}"
                yield Amount(place, dict(effect.parameters)["bias"], unit, whole, than)


def never_taken(automaton: HybridAutomaton) -> tuple[str, ...]:
    """One line for each transition that an earlier one to another target always preempts."""
    pairs = ((edge, preceding(automaton, i)) for i, edge in enumerate(automaton.edges))
    return tuple(
        messages.transition_never_taken((edge.name, edge.guard.name), (first.name, first.guard.name))
        for edge, first in pairs
        if first is not None and (first.target, first.reset) != (edge.target, edge.reset)
    )


def _jumps(automaton: HybridAutomaton, edge: Edge) -> Iterator[str]:
    """Amounts by which a transition moves parts relative to their parents without motion."""
    source, target = automaton.mode(edge.source), automaton.mode(edge.target)
    before = _state_at_guard(automaton, edge)
    after = np.array(edge.reset.apply(before, np.zeros(automaton.m)))
    for pin in target.pins:
        after[pin.coordinate] = pin.value
    for link, exited, entered in zip(automaton.links, source.joints, target.joints, strict=True):
        _, old = turns_and_translations(exited, before[link.coordinate])
        _, new = turns_and_translations(entered, after[link.coordinate])
        jump = float(np.linalg.norm(new - old))
        if jump > LARGEST_JUMP_M:
            yield messages.part_jumps(edge.name, link.child, jump)


def _state_at_guard(automaton: HybridAutomaton, edge: Edge) -> Floats:
    """A state (n,) at which a transition is taken: the middle of the guard and both modes."""
    source, target = automaton.mode(edge.source), automaton.mode(edge.target)
    state = np.zeros(automaton.n)
    for i in range(automaton.n):
        limits = [source.interval(i), edge.guard.interval(i)]
        limits += [target.invariant.interval(i)] if edge.reset.is_identity else []
        low, high = max(low for low, _ in limits), min(high for _, high in limits)
        ends = [end for end in (low, high) if math.isfinite(end)]
        state[i] = sum(ends) / len(ends) if ends else 0.0
    for half_space in edge.guard.half_spaces:  # of several coordinates: the nearest place where it holds
        a = np.array(half_space.a)
        if np.count_nonzero(a) > 1 and not half_space.on_input:
            state = state + a * max(0.0, half_space.c - float(a @ state)) / float(a @ a)
    return state
