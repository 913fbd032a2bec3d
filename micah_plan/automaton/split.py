"""One mode as two: where the motion changes at a place that the automaton does not know of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from micah_plan.automaton.check import check_automaton
from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Mode
from micah_plan.automaton.region import Region, above, below
from micah_plan.errors import InputError


def with_split(automaton: HybridAutomaton, coordinate: int, at: float) -> HybridAutomaton:
    """The automaton with each mode that moves a coordinate through a place cut there into two that move alike.

    The first half keeps the mode's name, the second is called ``"<name> from <place>"``. Effects that acted in the mode
    act in both.

    Args:
        at: configuration [rad or m] from which on the second half applies.

    Raises:
        InputError: if no mode moves the coordinate through that place.
    """
    label, n, m = automaton.coordinates[coordinate].name, automaton.n, automaton.m
    below_it, from_it = below(coordinate, at, n, m, name=label), above(coordinate, at, n, m, name=label)
    leaves = below(coordinate, at, n, m, strict=True, name=label)
    halves = {
        mode.name: (mode.name, f"{mode.name} from {at:.3g}") for mode in automaton.modes if _cut(mode, coordinate, at)
    }
    if not halves:
        raise InputError(f"no mode moves {label} through {at:g}")
    modes: list[Mode] = []
    for mode in automaton.modes:
        names = halves.get(mode.name)
        if names is None:
            modes.append(mode)
            continue
        for name, side in zip(names, (below_it, from_it), strict=True):
            modes.append(replace(mode, name=name, invariant=Region((*mode.invariant.half_spaces, side))))
    kept = [own for edge in automaton.edges for own in _halved(automaton, edge, halves, coordinate, at)]
    crossings = [
        edge
        for first, second in halves.values()
        for edge in (Edge(first, second, Region((from_it,))), Edge(second, first, Region((leaves,))))
    ]
    split = replace(
        automaton,
        modes=tuple(modes),
        # Changes of mode come before the clamps, as everywhere.
        edges=(
            *(edge for edge in kept if not edge.is_self_transition),
            *crossings,
            *(edge for edge in kept if edge.is_self_transition),
        ),
        init=tuple((half, region) for name, region in automaton.init for half in halves.get(name, (name,))),
        effects=tuple(
            replace(effect, modes=tuple(half for name in effect.modes for half in halves.get(name, (name,))))
            for effect in automaton.effects
        ),
    )
    check_automaton(split)
    return split


def _cut(mode: Mode, i: int, at: float) -> bool:
    """Whether a mode moves a coordinate on both sides of a place."""
    low, high = mode.invariant.interval(i)
    return bool(mode.driven[i]) and low < at < high


def _halved(
    automaton: HybridAutomaton, edge: Edge, halves: Mapping[str, tuple[str, str]], i: int, at: float
) -> list[Edge]:
    """A transition between halves: from each that can reach its guard, to the one in which it arrives."""
    sources = halves.get(edge.source, (edge.source,))
    targets = halves.get(edge.target, (edge.target,))
    found = []
    for source in sources:
        side = sources.index(source) if len(sources) == 2 else _side(automaton.mode(edge.source), i, at)
        if len(sources) == 2 and not _reaches(edge.guard, i, at, side == 1):
            continue
        if len(targets) == 1:
            found.append(replace(edge, source=source, target=targets[0]))
        elif side is not None:
            found.append(replace(edge, source=source, target=targets[side]))
        else:
            found += [_into(automaton, edge, targets[k], k, i, at) for k in (0, 1)]
    return found


def _into(automaton: HybridAutomaton, edge: Edge, target: str, side: int, i: int, at: float) -> Edge:
    """The transition where the state is on one side of the place."""
    label, n, m = automaton.coordinates[i].name, automaton.n, automaton.m
    where = above(i, at, n, m, name=label) if side else below(i, at, n, m, strict=True, name=label)
    return replace(edge, target=target, guard=Region((*edge.guard.half_spaces, where)))


def _side(mode: Mode, i: int, at: float) -> int | None:
    """The half in which a mode pins the coordinate; None if it does not pin it."""
    return None if mode.free[i] else int(mode.interval(i)[0] >= at)


def _reaches(guard: Region, i: int, at: float, is_beyond: bool) -> bool:
    """Whether a guard holds anywhere on one side of the place."""
    low, high = guard.interval(i)
    return high > at if is_beyond else low < at
