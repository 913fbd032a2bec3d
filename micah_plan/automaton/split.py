"""Splitting a mode at a place where the motion changes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

from micah_plan.automaton.check import check_automaton
from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Mode
from micah_plan.automaton.region import HalfSpace, Interval, Region, above, below
from micah_plan.errors import InputError


def with_split(automaton: HybridAutomaton, coordinate: int, at: float) -> HybridAutomaton:
    """The automaton with each mode that moves a coordinate through a place split there into two equal ones.

    The first half keeps the mode's name, the second is called ``"<name> from <place>"``. Effects that acted in the mode
    act in both.

    Args:
        at: configuration [rad or m] from which on the second half applies.

    Raises:
        InputError: if no mode moves the coordinate through that place.
    """
    label, n, m = automaton.coordinates[coordinate].name, automaton.n, automaton.m
    inside = below(coordinate, at, n, m, name=label), above(coordinate, at, n, m, name=label)
    entered = below(coordinate, at, n, m, strict=True, name=label), inside[1]
    halves = {
        mode.name: (mode.name, f"{mode.name} from {at:.3g}")
        for mode in automaton.modes
        if mode.driven[coordinate] and _is_around(mode.invariant.interval(coordinate), at)
    }
    if not halves:
        raise InputError(f"no mode moves {label} through {at:g}")
    modes: list[Mode] = []
    for mode in automaton.modes:
        for name, side in zip(halves.get(mode.name, ()), inside, strict=False):
            modes.append(replace(mode, name=name, invariant=_with(mode.invariant, side)))
        if mode.name not in halves:
            modes.append(mode)
    kept = [half for edge in automaton.edges for half in _halved_edges(automaton, edge, halves, coordinate, entered)]
    crossings = [
        edge
        for first, second in halves.values()
        for edge in (Edge(first, second, Region(entered[1:])), Edge(second, first, Region(entered[:1])))
    ]
    # Changes of mode come before the clamps, as everywhere.
    edges = sorted([*kept, *crossings], key=lambda edge: edge.is_self_transition)
    split = replace(
        automaton,
        modes=tuple(modes),
        edges=tuple(edges),
        init=tuple((half, region) for name, region in automaton.init for half in halves.get(name, (name,))),
        effects=tuple(
            replace(effect, modes=tuple(half for name in effect.modes for half in halves.get(name, (name,))))
            for effect in automaton.effects
        ),
    )
    check_automaton(split)
    return split


def _halved_edges(
    automaton: HybridAutomaton,
    edge: Edge,
    halves: Mapping[str, tuple[str, str]],
    coordinate: int,
    entered: tuple[HalfSpace, HalfSpace],
) -> Iterator[Edge]:
    """Transitions between halves: from each that can reach the guard, to the one of arrival."""
    source, place = automaton.mode(edge.source), entered[1].c
    low, high = edge.guard.interval(coordinate)
    for half, name in enumerate(halves.get(edge.source, (edge.source,))):
        sides: tuple[int, ...] = (0, 1) if source.free[coordinate] else (int(source.interval(coordinate)[0] >= place),)
        if edge.source in halves:
            sides = (half,) if (high > place if half else low < place) else ()
        if edge.target not in halves:
            sides = sides[:1]
        for side in sides:
            target = halves.get(edge.target, (edge.target,) * 2)[side]
            guard = edge.guard if len(sides) == 1 else _with(edge.guard, entered[side])
            yield replace(edge, source=name, target=target, guard=guard)


def _is_around(interval: Interval, at: float) -> bool:
    return interval[0] < at < interval[1]


def _with(region: Region, further: HalfSpace) -> Region:
    return Region((*region.half_spaces, further))
