"""Whether what an automaton says can be meant: units against joints and inputs, transitions that repeat each other or
are always taken, effects that are there twice, limits and weights beyond physical sizes.

`check` refuses what cannot be used at all. Here each part by itself could be used, and only together they make no
sense. Only what is certainly wrong is refused; `suspicion` tells what may be meant.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.emptiness import is_empty
from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Mode
from micah_plan.automaton.joint import KINDS
from micah_plan.automaton.region import HalfSpace, Region
from micah_plan.errors import InputError
from micah_plan.quantities import LARGEST

LARGEST_WEIGHT = 1e9  # as gains of plans; the reciprocal is the smallest: what is less moves or bounds nothing
Place = tuple[str | int, ...]


def contradictions(automaton: HybridAutomaton) -> Iterator[tuple[Place, Callable[[], None]]]:
    """The checks in their order, each with the place in the automaton that it is about; see `check.checks`."""
    for coordinate in automaton.coordinates:
        yield ("coordinates", coordinate.name), partial(_check_unit_of_joints, automaton, coordinate)
    for given in automaton.inputs:
        yield ("inputs", given.name), partial(_check_unit_of_input, automaton, given)
    for mode in automaton.modes:
        yield ("modes", mode.name, "invariant"), partial(_check_limits, automaton, mode.invariant, f"mode {mode.name}")
        yield ("modes", mode.name, "inputs"), partial(_check_limits, automaton, mode.inputs, f"mode {mode.name}")
        yield ("modes", mode.name, "step"), partial(_check_step, mode)
    first: dict[tuple[str, str, Region], int] = {}
    for i, edge in enumerate(automaton.edges):
        same = first.setdefault((edge.source, edge.target, edge.guard), i)
        yield ("edges", i, "guard"), partial(_check_limits, automaton, edge.guard, f"edge {edge.name}")
        yield ("edges", i, "reset"), partial(_check_reset, automaton, edge)
        yield ("edges", i), partial(_check_repeated, edge, i, same)
        yield ("edges", i, "guard"), partial(_check_stays, automaton, edge)
    for i, effect in enumerate(automaton.effects):
        yield ("effects", i), partial(_check_effect_once, automaton.effects[:i], effect)


def _check_unit_of_joints(automaton: HybridAutomaton, coordinate: Coordinate) -> None:
    """A coordinate has the unit of one of its joints; the others of a chain of modes count in their own unit."""
    index = automaton.coordinate_names.index(coordinate.name)
    kinds = {
        mode.joints[k].kind: link.child
        for mode in automaton.modes
        for k, link in enumerate(automaton.links)
        if link.coordinate == index and mode.joints[k].moves
    }
    if kinds and coordinate.unit not in {KINDS[kind].unit for kind in kinds}:
        kind, child = next(iter(kinds.items()))
        raise InputError(
            f"coordinate {coordinate.name}: expected the unit {KINDS[kind].unit} of the {kind} joint of {child}, "
            f"found {coordinate.unit}",
            remedy=f"write {KINDS[kind].unit}, or correct the kind of the joint",
        )


def _check_unit_of_input(automaton: HybridAutomaton, given: Coordinate) -> None:
    """An input that is called like a coordinate is its commanded change."""
    unit = next((item.unit for item in automaton.coordinates if item.name == given.name), given.unit)
    if unit != given.unit:
        raise InputError(
            f"input {given.name}: expected the unit {unit} of the coordinate {given.name} that it moves, found "
            f"{given.unit}",
            remedy=f"write {unit}, or give the input a name of its own",
        )


def _check_limits(automaton: HybridAutomaton, region: Region, where: str) -> None:
    """Half-spaces that lie farther away than anything can be, or whose weights make rounding of everything else."""
    for half_space in region.half_spaces:
        bound = half_space.bound
        if bound is not None and not abs(bound.value) <= LARGEST:
            coordinate = automaton.coordinates[bound.coordinate]
            raise InputError(
                f"{where}: expected a limit of {coordinate.name} of at most {LARGEST:g} {coordinate.unit} in size, "
                f"found {bound.value:g}",
                remedy="give it in m or rad",
            )
        weights = (*half_space.a, *half_space.b)
        _check_weights(weights, f"{where}: {half_space.name or 'a half-space'}")
        away = abs(half_space.c) / max(map(abs, weights))
        if not away <= LARGEST:
            problem = f"{where}: {half_space.name or 'a half-space'}: expected one at most {LARGEST:g} away from 0"
            raise InputError(f"{problem}, found {away:g}", remedy="correct its numbers")


def _check_weights(weights: Sequence[float], where: str) -> None:
    """Of one expression: the largest decides, as what is rounding beside it is harmless."""
    largest = max(map(abs, weights), default=0.0)
    if largest and not 1 / LARGEST_WEIGHT <= largest <= LARGEST_WEIGHT:
        expected = f"expected weights of {1 / LARGEST_WEIGHT:g} to {LARGEST_WEIGHT:g} in size"
        raise InputError(f"{where}: {expected}, found {largest:g}", remedy="correct the number before the name")


def _check_step(mode: Mode) -> None:
    for row in mode.input_matrix:
        _check_weights(row, f"mode {mode.name}: step")


def _check_reset(automaton: HybridAutomaton, edge: Edge) -> None:
    a, b, c = edge.reset.matrices(automaton.n, automaton.m)
    for coordinate, *row, constant in zip(automaton.coordinates, *a.T, *b.T, c.tolist(), strict=True):
        where = f"edge {edge.name}: reset of {coordinate.name}"
        _check_weights(row, where)
        if not abs(constant) <= LARGEST:
            problem = f"{where}: expected at most {LARGEST:g} {coordinate.unit} in size, found {constant:g}"
            raise InputError(problem, remedy="give it in m or rad")


def _check_repeated(edge: Edge, number: int, first: int) -> None:
    """Of two transitions with the same guard the second is never taken."""
    if number != first:
        raise InputError(
            f"edge {edge.name}: it has the same modes and guard as transition {first} (counted from 0), so it is never "
            "taken",
            remedy="remove one of the two, or correct the guard",
        )


def preceding(automaton: HybridAutomaton, number: int) -> Edge | None:
    """A transition listed earlier whose guard holds wherever that of another does: the other is never taken.

    Of guards that hold at one instant changes of the mode go first, then the first listed (`transition`).
    """
    own = automaton.edges[number]
    rows = own.guard.half_spaces
    for other in automaton.edges_from(own.source):
        if other is own:
            return None
        is_first = own.is_self_transition or not other.is_self_transition
        if is_first and all(any(_implies(row, h) for row in rows) for h in other.guard.half_spaces):
            return other
    return None


def _implies(one: HalfSpace, other: HalfSpace) -> bool:
    """Whether all that is inside of a half-space is inside of another with the same weights."""
    same = one.a == other.a and one.b == other.b
    return same and (one.c > other.c or (one.c == other.c and (one.strict or not other.strict)))


def _check_stays(automaton: HybridAutomaton, edge: Edge) -> None:
    """Refuse a guard that holds wherever the invariant of its own mode does: the mode would be left at once, always."""
    mode = automaton.mode(edge.source)
    within = mode.invariant.half_spaces + mode.inputs.half_spaces
    if all(is_empty(Region((*within, half_space.opposite))) for half_space in edge.guard.half_spaces):
        names = " and ".join(half_space.name or "an unnamed half-space" for half_space in edge.guard.half_spaces)
        raise InputError(
            f"edge {edge.name}: its guard holds everywhere in mode {mode.name}, which is never stayed in. Got {names}",
            remedy="move the guard to where the mode ends, or widen the mode's invariant",
        )


def _check_effect_once(earlier: tuple[Effect, ...], effect: Effect) -> None:
    own = (effect.name, effect.coordinate, effect.values, effect.modes)
    if any((other.name, other.coordinate, other.values, other.modes) == own for other in earlier):
        raise InputError(
            f"effect {effect.name} of {effect.coordinate} is there twice, with the same values",
            remedy="remove one of the two",
        )
