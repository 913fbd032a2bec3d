"""What looks like a mistake in an automaton that can be used. Nothing is refused: each suspicion is one line.

- **Jumps.** A part is where it was when a transition is taken. If the joints of its two modes place it more than
  `LARGEST_JUMP_M` apart, one of them was probably edited. Smaller ones are common: joints are estimates.
- **Never taken.** Of transitions that are possible at one instant the first listed is taken, so one that is listed
  behind a more general one is not.
- **Millimetres.** A part farther than `FARTHEST_M` from the part that it is linked to was probably given in
  millimetres. Solids do not show it: domains of 100 m are planned in.
- **Larger than the range.** What one step adds (noise, drift), or what is not known of a measurement or a threshold, is
  less than all that a coordinate can be.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.consistency import preceding
from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Part
from micah_plan.automaton.motion_of_joints import turns_and_translations
from micah_plan.quantities import quantity

LARGEST_JUMP_M = 0.2
FARTHEST_M = 50.0
_IN_METRES = "lengths are in m: are these millimetres? then divide them by 1000"


def suspicions(automaton: HybridAutomaton) -> tuple[str, ...]:
    """What looks wrong in an automaton, one line each, with its place; empty if nothing does."""
    jumps = (line for edge in automaton.edges if not edge.is_self_transition for line in _jumps(automaton, edge))
    far = (*_millimetres(automaton), *far_handles(automaton.parts))
    return (*far, *_beyond_the_range(automaton), *jumps, *never_taken(automaton))


def never_taken(automaton: HybridAutomaton) -> tuple[str, ...]:
    """One line for each transition instead of which one that leads elsewhere is taken wherever it is possible."""
    pairs = ((edge, preceding(automaton, i)) for i, edge in enumerate(automaton.edges))
    return tuple(
        f"transition {edge.name} ('{edge.guard.name}') is never taken: {first.name} ('{first.guard.name}'), listed "
        "before it, is possible wherever it is; list the more general one last"
        for edge, first in pairs
        if first is not None and (first.target, first.reset) != (edge.target, edge.reset)
    )


def far_handles(parts: Iterable[Part]) -> Iterator[str]:
    """Handles that lie farther from their part than a room is wide."""
    for part in parts:
        distance = 0.0 if part.handle is None else float(np.linalg.norm(part.handle))
        if distance > FARTHEST_M:
            yield f"parts.{part.name}.handle: {quantity(distance, 'm')} from the part; {_IN_METRES}"


def _millimetres(automaton: HybridAutomaton) -> Iterator[str]:
    for mode in automaton.modes:
        for link, joint in zip(automaton.links, mode.joints, strict=True):
            distance = float(np.linalg.norm(joint.position))
            if distance > FARTHEST_M:
                parent = "the base frame" if link.parent == "base" else f"part {link.parent}"
                yield f"modes.{mode.name}.joints.{link.child}: {quantity(distance, 'm')} from {parent}; {_IN_METRES}"


def _beyond_the_range(automaton: HybridAutomaton) -> Iterator[str]:
    """What is said of one step or one measurement, and is more than the whole range of its coordinate."""
    for i, coordinate in enumerate(automaton.coordinates):
        ranges = automaton.ranges(i)
        whole = ranges[-1][1] - ranges[0][0] if ranges else 0.0
        if not 0.0 < whole < math.inf:
            continue
        noise = automaton.noise
        sizes = [
            (f"noise.process_std.{coordinate.name}", noise.process_std[i], "a step"),
            (f"noise.observation_std.{coordinate.name}", noise.observation_std[i], "a measurement"),
        ]
        sizes += [
            (f"transition {edge.name}: threshold_std", edge.threshold_std, "where it is taken")
            for edge in automaton.edges
            if any(half_space.a[i] for half_space in edge.guard.half_spaces)
        ]
        sizes += [
            (f"modes.{', '.join(one.modes)}: drift of {coordinate.name}", abs(dict(one.parameters)["bias"]), "a step")
            for one in automaton.effects
            if one.name == "bias" and one.coordinate == coordinate.name and one.modes
        ]
        for place, size, of in sizes:
            if size > whole:
                yield (
                    f"{place}: {quantity(size, coordinate.unit)} for {of}, but {coordinate.name} has a range of "
                    f"{quantity(whole, coordinate.unit)}; check the units"
                )


def _jumps(automaton: HybridAutomaton, edge: Edge) -> Iterator[str]:
    """Parts that a transition moves by itself, relative to the parts that they are linked to."""
    source, target = automaton.mode(edge.source), automaton.mode(edge.target)
    before = _crossing(automaton, edge)
    after = np.array(edge.reset.apply(before, np.zeros(automaton.m)))
    for pin in target.pins:
        after[pin.coordinate] = pin.value
    for link, left, entered in zip(automaton.links, source.joints, target.joints, strict=True):
        _, old = turns_and_translations(left, before[link.coordinate])
        _, new = turns_and_translations(entered, after[link.coordinate])
        jump = float(np.linalg.norm(new - old))
        if jump > LARGEST_JUMP_M:
            yield (
                f"transition {edge.name}: part {link.child} jumps by {quantity(jump, 'm')} between the joints of "
                "its modes; check position, axis and center of both"
            )


def _crossing(automaton: HybridAutomaton, edge: Edge) -> Floats:
    """A state (n,) in which a transition is taken: the middle of what its guard and both modes leave."""
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
