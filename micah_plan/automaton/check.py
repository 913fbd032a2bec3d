"""Validation of hybrid automata: errors of model files or Python code, each in one line with its place.

Each element is checked separately, then their consistency: pins, rigid joints, and targets of transitions. Only what is
certainly wrong is refused: bounding boxes are compared (half-spaces that couple coordinates are ignored), and
deviations up to the model's own std accepted.

Consistency of an automaton: units of joints and inputs, transitions that repeat each other or are always taken,
duplicate effects, limits and weights beyond physical sizes.

`check` refuses elements that cannot be used at all. Here each element could be used, but not all together. Only what is
certainly wrong is refused; `plausible` warns of likely mistakes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from micah_plan.arrays import EQUAL, ROUND_OFF
from micah_plan.automaton.effects.add import check_effect
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.feasibility import is_empty
from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Mode, Pin, Tie
from micah_plan.automaton.joint import KINDS
from micah_plan.automaton.memo import memoised
from micah_plan.automaton.region import UNLIMITED, HalfSpace, Interval, Region
from micah_plan.errors import InputError, shown
from micah_plan.quantities import LARGEST

UNITS = ("rad", "m")
Place = tuple[str | int, ...]

LARGEST_WEIGHT = 1e9  # as gains of plans; the reciprocal is the smallest: smaller ones have no effect


def check_automaton(automaton: HybridAutomaton) -> None:
    """Refuse an automaton that violates the assumptions of the algorithms.

    Raises:
        InputError: names that are not unique or not known, an invariant, guard or set of inputs that is empty, a pin on
            a coordinate that moves or outside its invariant, a rigid joint fixed elsewhere than pinned, a transition
            that leads out of its target's invariant, a self transition without effect, a mode that is not connected,
            process noise below 0, observation noise not above 0; and inconsistent elements (`contradictions`).
    """
    for _, check in checks(automaton):
        check()


def checks(automaton: HybridAutomaton) -> Iterator[tuple[Place, Callable[[], None]]]:
    """The checks of `check_automaton` in order, each with its place in the automaton.

    Each must pass before the next is run. Places are (field,), (field, name or index) or further keys of it.
    """
    yield (), partial(_check_names, automaton)
    yield ("links",), partial(_check_links, automaton)
    yield ("noise",), partial(_check_noise, automaton)
    for mode in automaton.modes:
        yield ("modes", mode.name), partial(_check_mode, automaton, mode)
    for i, edge in enumerate(automaton.edges):
        yield ("edges", i), partial(_check_edge, automaton, edge)
    for i, (name, region) in enumerate(automaton.init):
        yield ("init", i, "mode"), partial(_check_init, automaton, name, region)
    for mode in automaton.modes:
        for pin in mode.pins:
            name = automaton.coordinates[pin.coordinate].name
            yield ("modes", mode.name, "pins", name, "value"), partial(_check_pin, automaton, mode, pin)
        for k, link in enumerate(automaton.links):
            yield ("modes", mode.name, "joints", link.child, "held"), partial(_check_fixed_at, automaton, mode, k)
    for i, effect in enumerate(automaton.effects):
        yield ("effects", i), partial(check_effect, automaton, effect)
    for i, edge in enumerate(automaton.edges):
        yield ("edges", i, "guard"), partial(_check_entry, automaton, edge)
    for mode in automaton.modes:
        yield ("modes", mode.name), partial(_check_connected, automaton, mode)
    yield from contradictions(automaton)


def _check_init(automaton: HybridAutomaton, name: str, region: Region) -> None:
    automaton.mode(name)
    _check_region(region, f"init of mode {name}")


def _check_names(automaton: HybridAutomaton) -> None:
    groups = (
        ("mode", automaton.mode_names),
        ("coordinate", automaton.coordinate_names),
        ("input", automaton.input_names),
        ("part", [part.name for part in automaton.parts]),
    )
    for what, names in groups:
        for i, name in enumerate(names):
            if name in names[:i]:
                raise InputError(f"{what} names must be unique. Got {shown(name)} twice")
    if not automaton.modes or not automaton.coordinates:
        raise InputError("an automaton must have at least one coordinate and one mode")
    for coordinate in (*automaton.coordinates, *automaton.inputs):
        if coordinate.unit not in UNITS:
            raise InputError(
                f"unit of {coordinate.name} must be one of {', '.join(UNITS)}. Got {shown(coordinate.unit)}"
            )


def _check_links(automaton: HybridAutomaton) -> None:
    placed = {BASE}
    for link in automaton.links:
        if not 0 <= link.coordinate < automaton.n:
            raise InputError(f"link to {link.child}: coordinate must be 0 to {automaton.n - 1}. Got {link.coordinate}")
        if link.parent not in placed:
            raise InputError(
                f"link to {link.child}: parent must be {BASE} or the child of an earlier link. Got {shown(link.parent)}"
            )
        if link.child in placed:
            raise InputError(f"part {link.child} must be the child of one link. Got a second one")
        placed.add(link.child)


def _check_mode(automaton: HybridAutomaton, mode: Mode) -> None:
    n, where = automaton.n, f"mode {mode.name}"
    _check_finite(mode.input_matrix, f"{where}: input matrix B")
    for what, region in (("invariant", mode.invariant), ("admissible inputs", mode.inputs)):
        _check_region(region, f"{where}: {what}")
    for pin in mode.pins:
        if not 0 <= pin.coordinate < n:
            raise InputError(f"{where}: pinned coordinate must be 0 to {n - 1}. Got {pin.coordinate}")
        if any(mode.input_matrix[pin.coordinate]):
            name = automaton.coordinates[pin.coordinate].name
            raise InputError(f"{where}: B must have a zero row for the pinned coordinate {name}")
        if not (math.isfinite(pin.value) and math.isfinite(pin.std) and pin.std > 0):
            raise InputError(f"{where}: a pin must have a finite value and a std > 0. Got {pin.value}, {pin.std}")
    for coordinate, std in mode.observation_std:
        if not 0 <= coordinate < n:
            raise InputError(f"{where}: measured coordinate must be 0 to {n - 1}. Got {coordinate}")
        # Likelihoods of modes can be compared only if all of them explain the same measured values.
        if not (math.isfinite(std) and std > 0 and math.isfinite(automaton.noise.observation_std[coordinate])):
            name = automaton.coordinates[coordinate].name
            everywhere = automaton.noise.observation_std[coordinate]
            raise InputError(
                f"{where}: observation_std of {name} must be a finite number > 0, here and in the model's noise. "
                f"Got {std} and {everywhere}"
            )
    for tie in mode.ties:
        _check_tie(automaton, mode, tie)


def _check_tie(automaton: HybridAutomaton, mode: Mode, tie: Tie) -> None:
    n, where = automaton.n, f"mode {mode.name}: a tie"
    if not 0 <= tie.coordinate < n or len(tie.weights) != n or tie.weights[tie.coordinate] != 0:
        raise InputError(f"{where} needs {n} weights, 0 for its own coordinate. Got {tie.coordinate}, {tie.weights}")
    if not all(map(math.isfinite, (*tie.weights, tie.offset))):
        raise InputError(f"{where}: weights and offset must be finite. Got {tie.weights}, {tie.offset}")
    flow = np.array(tie.weights) @ mode.B
    if not np.allclose(flow, mode.B[tie.coordinate], rtol=1e-9, atol=1e-12):
        name = automaton.coordinates[tie.coordinate].name
        raise InputError(f"{where}: the flow must keep it. Got B = {mode.B[tie.coordinate]} for '{name}', not {flow}")


def _check_edge(automaton: HybridAutomaton, edge: Edge) -> None:
    where = f"edge {edge.name}"
    for end in (edge.source, edge.target):
        if not automaton.has_mode(end):
            remedy = f"choose one of {', '.join(automaton.mode_names)}"
            raise InputError(f"{where}: unknown mode {shown(end)}", remedy=remedy)
    if edge.guard.is_everything:
        raise InputError(f"{where}: a guard must have at least one half-space, otherwise its mode is left at once")
    _check_region(edge.guard, f"{where}: guard")
    if not (math.isfinite(edge.threshold_std) and edge.threshold_std >= 0):
        raise InputError(f"{where}: threshold_std must be a finite number >= 0. Got {edge.threshold_std}")
    if edge.is_self_transition and edge.reset.is_identity:
        raise InputError(f"{where}: a self transition must have a reset, otherwise it has no effect")
    for name, matrix in (("matrix A", edge.reset.A), ("matrix B", edge.reset.B), ("offset c", (edge.reset.c or (),))):
        _check_finite(matrix or (), f"{where}: reset {name}")


def _check_noise(automaton: HybridAutomaton) -> None:
    """Process noise may be 0 (known motion) and observation noise infinite (a coordinate that is not measured)."""
    n, process, observation = automaton.n, automaton.noise.process_std, automaton.noise.observation_std
    if not all(math.isfinite(std) and std >= 0 for std in process):
        raise InputError(f"noise: process_std must be {n} finite numbers >= 0. Got {shown(list(process))}")
    if not all(std > 0 for std in observation):
        raise InputError(f"noise: observation_std must be {n} numbers > 0. Got {shown(list(observation))}")
    light = automaton.noise.light
    if light is None:
        return
    if not light.at or not all(0 <= i < n and math.isfinite(value) for i, value in light.at):
        raise InputError(f"noise: a light must be at finite values of coordinates 0 to {n - 1}. Got {shown(light.at)}")
    if len(light.growth) != n or not all(math.isfinite(growth) and growth >= 0 for growth in light.growth):
        raise InputError(f"noise: growth of a light must be {n} finite numbers >= 0. Got {shown(list(light.growth))}")


def _check_pin(automaton: HybridAutomaton, mode: Mode, pin: Pin) -> None:
    """Refuse a pin farther outside its mode's invariant than its std."""
    low, high = mode.invariant.interval(pin.coordinate)
    room = ROUND_OFF * max(1.0, abs(pin.value)) + pin.std
    if not low - room <= pin.value <= high + room:
        coordinate = automaton.coordinates[pin.coordinate]
        raise InputError(
            f"mode {mode.name}: the pin of {coordinate.name}, {pin.value:.9g} {coordinate.unit}, lies outside of the "
            f"mode's invariant {_text((low, high))}",
            remedy="move the pin or the invariant",
        )


def _check_fixed_at(automaton: HybridAutomaton, mode: Mode, link: int) -> None:
    """Refuse a rigid joint at another configuration than the one its mode pins."""
    joint, index = mode.joints[link], automaton.links[link].coordinate
    for pin in mode.pins:
        if not joint.moves and pin.coordinate == index and not abs(joint.fixed_at - pin.value) <= EQUAL:
            coordinate = automaton.coordinates[index]
            raise InputError(
                f"mode {mode.name}: the rigid joint of {automaton.links[link].child} is fixed at {joint.fixed_at:.9g} "
                f"{coordinate.unit}, but the pin of {coordinate.name} is at {pin.value:.9g} {coordinate.unit}",
                remedy="give both the same value",
            )


def _check_connected(automaton: HybridAutomaton, mode: Mode) -> None:
    """Refuse an isolated mode, unless it is the only one."""
    if len(automaton.modes) > 1 and mode.name not in _connected(automaton):
        raise InputError(
            f"mode {mode.name} is not connected: no transition enters or leaves it",
            remedy="add a transition or remove the mode",
        )


@memoised
def _connected(automaton: HybridAutomaton) -> frozenset[str]:
    """The modes with a transition in or out."""
    changes = [edge for edge in automaton.edges if not edge.is_self_transition]
    return frozenset(name for edge in changes for name in (edge.source, edge.target))


def _check_entry(automaton: HybridAutomaton, edge: Edge) -> None:
    """Refuse a change of mode whose reset puts a coordinate outside the target's invariant."""
    if edge.is_self_transition:
        return
    source, target = automaton.mode(edge.source), automaton.mode(edge.target)
    before = _leaving_box(source, edge)
    if any(low > high for low, high in before):
        return  # the guard holds nowhere in the source; the edge is useless but leads nowhere wrong
    for index, (low, high) in enumerate(_after_reset(automaton, edge, before)):
        allowed = target.invariant.interval(index)
        if allowed[0] <= low and high <= allowed[1]:
            continue
        room = EQUAL * max([1.0, *(abs(v) for v in (low, high, *allowed) if math.isfinite(v))])
        room += sum(pin.std for mode in (source, target) for pin in mode.pins if pin.coordinate == index)
        if low > allowed[1] + room or high < allowed[0] - room:
            name = automaton.coordinates[index].name
            raise InputError(
                f"edge {edge.name}: enters mode {target.name} at {name} = {_text((low, high))}, outside of its "
                f"invariant {_text(allowed)}",
                remedy="move the guard or the invariant, or give a reset",
            )


def _leaving_box(source: Mode, edge: Edge) -> list[Interval]:
    """Per coordinate, the interval of states at which an edge is taken within the source's invariant."""
    box = list(source.intervals)
    bounds = [half_space.bound for half_space in edge.guard.half_spaces]
    only = bounds[0] if len(bounds) == 1 else None
    for i, (low, high) in enumerate(box):
        least, most = edge.guard.interval(i)
        if only is not None and only.coordinate == i and source.driven[i]:
            _, value, is_lower = only
            if (low < value) if is_lower else (high > value):
                # The motion comes from where the guard does not hold, so the edge is taken on the guard's boundary.
                box[i] = (value, value)
                continue
        box[i] = (max(low, least), min(high, most))
    return box


def _after_reset(automaton: HybridAutomaton, edge: Edge, box: list[Interval]) -> list[Interval]:
    """A box that contains the reset's image of a box; unbounded where inputs or unbounded states enter."""
    if edge.reset.is_identity:
        return box
    a, b, c = (matrix.tolist() for matrix in edge.reset.matrices(automaton.n, automaton.m))
    image = []
    for weights, inputs, offset in zip(a, b, c, strict=True):
        ends = [sorted((w * low, w * high)) for w, (low, high) in zip(weights, box, strict=True) if w]
        low, high = (offset + sum(end[k] for end in ends) for k in (0, 1))
        image.append(UNLIMITED if any(inputs) or math.isnan(low) or math.isnan(high) else (low, high))
    return image


def _text(interval: Interval) -> str:
    low, high = interval
    return f"{low:.9g}" if low == high else f"[{low:.9g}, {high:.9g}]"


def _check_finite(matrix: Sequence[Sequence[float]], where: str) -> None:
    if not all(math.isfinite(value) for row in matrix for value in row):
        raise InputError(f"{where} must be finite. Got {shown(matrix)}")


def _check_region(region: Region, where: str) -> None:
    if is_empty(region):
        names = " and ".join(half_space.name or "an unnamed half-space" for half_space in region.half_spaces)
        raise InputError(f"{where} must not be empty. Got {names}")


def contradictions(automaton: HybridAutomaton) -> Iterator[tuple[Place, Callable[[], None]]]:
    """Errors of an automaton with their places; see `check.checks`."""
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
    """A coordinate has the unit of one of its joints; other joints of the chain may have their own."""
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


def _check_unit_of_input(automaton: HybridAutomaton, coordinate: Coordinate) -> None:
    """An input with the name of a coordinate is its commanded change."""
    unit = next((item.unit for item in automaton.coordinates if item.name == coordinate.name), coordinate.unit)
    if unit != coordinate.unit:
        raise InputError(
            f"input {coordinate.name}: expected the unit {unit} of the coordinate {coordinate.name} that it moves, "
            f"found {coordinate.unit}",
            remedy=f"write {unit}, or give the input a name of its own",
        )


def _check_limits(automaton: HybridAutomaton, region: Region, where: str) -> None:
    """Refuse half-spaces at implausible distances, or with weights whose round-off hides other terms."""
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
    """Refuse an expression whose largest weight is out of range; smaller ones are harmless round-off."""
    largest = max(map(abs, weights), default=0.0)
    if largest and not 1 / LARGEST_WEIGHT <= largest <= LARGEST_WEIGHT:
        expected = f"expected weights of {1 / LARGEST_WEIGHT:g} to {LARGEST_WEIGHT:g} in size"
        raise InputError(f"{where}: {expected}, found {largest:g}", remedy="correct the number before the name")


def _check_step(mode: Mode) -> None:
    for row in mode.input_matrix:
        _check_weights(row, f"mode {mode.name}: step")


def _check_reset(automaton: HybridAutomaton, edge: Edge) -> None:
    if edge.reset.is_identity:
        return
    a, b, c = (matrix.tolist() for matrix in edge.reset.matrices(automaton.n, automaton.m))
    for coordinate, row, inputs, constant in zip(automaton.coordinates, a, b, c, strict=True):
        where = f"edge {edge.name}: reset of {coordinate.name}"
        _check_weights((*row, *inputs), where)
        if not abs(constant) <= LARGEST:
            problem = f"{where}: expected at most {LARGEST:g} {coordinate.unit} in size, found {constant:g}"
            raise InputError(problem, remedy="give it in m or rad")


def _check_repeated(edge: Edge, number: int, first: int) -> None:
    """Refuse a second transition with the same guard, which could never be taken."""
    if number != first:
        raise InputError(
            f"edge {edge.name}: it has the same modes and guard as transition {first} (counted from 0), so it is never "
            "taken",
            remedy="remove one of the two, or correct the guard",
        )


def preceding(automaton: HybridAutomaton, number: int) -> Edge | None:
    """An earlier edge whose guard contains that of another; the other can never be taken.

    Among guards that hold at one instant, changes of the mode come first, then the first listed (`transition`).
    """
    edge = automaton.edges[number]
    rows = edge.guard.half_spaces
    for earlier in automaton.edges_from(edge.source):
        if earlier is edge:
            return None
        is_first = edge.is_self_transition or not earlier.is_self_transition
        if is_first and all(any(_implies(row, h) for row in rows) for h in earlier.guard.half_spaces):
            return earlier
    return None


def _implies(first: HalfSpace, second: HalfSpace) -> bool:
    """Whether one half-space is contained in another with the same weights."""
    same = first.a == second.a and first.b == second.b
    return same and (first.c > second.c or (first.c == second.c and (first.strict or not second.strict)))


def _check_stays(automaton: HybridAutomaton, edge: Edge) -> None:
    """Refuse a guard that holds everywhere in its own mode, which would be left at once."""
    mode = automaton.mode(edge.source)
    within = mode.invariant, mode.inputs
    if all(is_empty(*within, Region((half_space.opposite,))) for half_space in edge.guard.half_spaces):
        names = " and ".join(half_space.name or "an unnamed half-space" for half_space in edge.guard.half_spaces)
        raise InputError(
            f"edge {edge.name}: its guard holds everywhere in mode {mode.name}, which is never stayed in. Got {names}",
            remedy="move the guard to where the mode ends, or widen the mode's invariant",
        )


def _check_effect_once(earlier: tuple[Effect, ...], effect: Effect) -> None:
    key = (effect.name, effect.coordinate, effect.values, effect.modes)
    if any(
        (earlier_effect.name, earlier_effect.coordinate, earlier_effect.values, earlier_effect.modes) == key
        for earlier_effect in earlier
    ):
        raise InputError(
            f"effect {effect.name} of {effect.coordinate} is there twice, with the same values",
            remedy="remove one of the two",
        )
