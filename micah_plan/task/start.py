"""Starts: the initial belief, its mode, and sampling of true states."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from micah_plan.arrays import EQUAL, NEAR_STDS, SMALLEST_STD, Booleans, Floats
from micah_plan.automaton.drawn_thresholds import threshold_stds, with_boundary_states
from micah_plan.automaton.hybrid import HybridAutomaton, Mode
from micah_plan.automaton.region import Region
from micah_plan.errors import InputError
from micah_plan.task import messages
from micah_plan.task.reason import Reason

_MOST_DRAWS = 200


@dataclass(frozen=True)
class Start:
    """The initial belief.

    Attributes:
        mean, std: (n,) of the Gaussian over x [rad or m].
        mode: the mode the object is in; None: the first mode whose invariant holds the mean.
        posture: (J,) joints that an arm starts with [rad or m], as a plan has them; None: any that hold the object.
        true: (coordinate, value [rad or m]) of simulated trials' true start, independent of the belief; others are
            drawn.
    """

    mean: tuple[float, ...]
    std: tuple[float, ...]
    mode: str | None = None
    posture: tuple[float, ...] | None = None
    true: tuple[tuple[int, float], ...] = ()


def start_mode(automaton: HybridAutomaton, start: Start) -> tuple[str | None, Reason | None]:
    """(mode of a start, None), or (None, reason) if its mean lies outside of all ranges or the named one.

    A mode's range is its invariant, and the part of it that the automaton's Init allows if there is one.
    """
    # A hair outside of a range is noise of a measurement, not the collision that lies behind.
    modes = modes_to_be_in(automaton) if start.mode is None else (automaton.mode(start.mode),)
    outside = {mode.name: _sigmas_outside(automaton, start, mode) for mode in modes}
    nearest = min(outside, key=outside.__getitem__)
    if outside[nearest] <= NEAR_STDS:
        return nearest, None
    values = zip(automaton.coordinates, start.mean, start.std, strict=True)
    text = ", ".join(f"{c.name} = {mean:g} ± {std:g} {c.unit}" for c, mean, std in values)
    if start.mode is not None:
        sentence, remedy = messages.start_outside_mode(text, nearest), messages.CHANGE_START_OR_MODE
        return None, Reason("start_outside_mode", sentence, (remedy,))
    sentence, remedy = messages.start_in_no_mode(text, tuple(outside)), messages.MOVE_START_INTO_RANGE
    return None, Reason("start_in_no_mode", sentence, (remedy,))


def is_final(automaton: HybridAutomaton, mode: Mode) -> bool:
    """Whether a mode is absorbing: without motion or outgoing transitions, as after a collision."""
    return not mode.B.any() and all(edge.is_self_transition for edge in automaton.edges_from(mode.name))


def modes_to_be_in(automaton: HybridAutomaton) -> tuple[Mode, ...]:
    """The non-final modes; all if all are final."""
    return tuple(mode for mode in automaton.modes if not is_final(automaton, mode)) or automaton.modes


def start_regions(automaton: HybridAutomaton, mode: Mode) -> tuple[Region, ...]:
    """The regions, any of which holds a start in a mode: its invariant, within each of its regions of Init if given."""
    if not automaton.init:
        return (mode.invariant,)
    return tuple(mode.invariant.intersection(region) for name, region in automaton.init if name == mode.name)


def sample_start(automaton: HybridAutomaton, start: Start, rng: np.random.Generator) -> tuple[str, Floats]:
    """A sampled true start: (mode, x (n,)) from the Gaussian conditioned on the mode's invariant (and Init).

    Where the invariant is very improbable under the belief, the mean is taken. Pinned coordinates are at their pins.
    Coordinates with a true start are there, in the believed mode if it allows that, else in one that does.

    Raises:
        InputError: if the start, or the true one, is in no mode.
    """
    name, reason = start_mode(automaton, start)
    if name is None:
        raise InputError(str(reason))
    x = draw_states(automaton, automaton.mode(name), start, rng, np.zeros((1, threshold_stds(automaton).size)))[0]
    return (name, x) if not start.true else _true_start(automaton, start, name, x)


def _true_start(automaton: HybridAutomaton, start: Start, believed: str, x: Floats) -> tuple[str, Floats]:
    """(mode, state (n,)) of a true start that differs from the believed one."""
    for index, value in start.true:
        x[index] = value
    there = replace(start, mean=tuple(x.tolist()), std=(SMALLEST_STD,) * automaton.n, mode=believed)
    name, reason = start_mode(automaton, there)
    if name is None:
        name, reason = start_mode(automaton, replace(there, mode=None))
    if name is None:
        raise InputError(f"the true start is in no mode: {reason}")
    for pin in automaton.mode(name).pins:
        if abs(x[pin.coordinate] - pin.value) > EQUAL:
            coordinate = automaton.coordinates[pin.coordinate]
            text = f"the true start: mode '{name}' holds {coordinate.name} at {pin.value:g} {coordinate.unit}"
            raise InputError(f"{text}, found {x[pin.coordinate]:g}", remedy="start there, or in another mode")
    return name, x


def draw_states(
    automaton: HybridAutomaton, mode: Mode, start: Start, rng: np.random.Generator, shifts: Floats
) -> Floats:
    """(t, n) sampled true states of t objects in a mode, without checking the start's mode.

    Args:
        automaton: the objects' model.
        shifts: (t, b) by how much each object's boundaries are moved (`thresholds.threshold_stds`).
    """
    n, whole = automaton.n, with_boundary_states(automaton)
    mode_of_whole = whole.mode(mode.name)
    rows = mode_of_whole.invariant.half_spaces
    normals, growth = np.split(np.array([h.a for h in rows]).reshape(-1, whole.n), [n], axis=1)
    pins = np.zeros((len(shifts), len(mode_of_whole.pins)))
    for k, pin in enumerate(mode_of_whole.pins):
        pins[:, k] = pin.value + (0.0 if pin.follows is None else shifts[:, pin.follows - n])
    pinned = [pin.coordinate for pin in mode.pins]
    # Thresholds for the drawn coordinates alone, in each half-space of each object.
    least = np.array([h.c for h in rows]) - shifts @ growth.T - pins @ normals[:, pinned].T
    normals[:, pinned] = 0.0
    mean, std = np.array(start.mean, dtype=float), np.array(start.std, dtype=float)
    strict = np.array([h.strict for h in rows], dtype=bool)
    further = [region for name, region in automaton.init if name == mode.name]
    at_rest = np.zeros(automaton.m)
    states = np.repeat(mean[None], len(shifts), axis=0)
    number = tries = 0
    while number < len(states):
        # Each object takes the first draw that suits it, in the order of the draws: at least one each.
        draws = mean + std * rng.standard_normal((len(states) - number, n))
        sums = draws @ normals.T
        of_all, of_some = (_hold(sums, end(least, axis=0), strict).tolist() for end in (np.max, np.min))
        taken: list[tuple[int, int]] = []
        for k, (suits_all, suits_some) in enumerate(zip(of_all, of_some, strict=True)):
            suits = suits_all or (suits_some and bool(_hold(sums[k], least[number], strict)))
            if suits and automaton.init:
                draws[k, pinned] = pins[number]
                suits = any(region.contains(draws[k], at_rest) for region in further)
            if suits:
                taken.append((number, k))
            if suits or (tries := tries + 1) == _MOST_DRAWS:
                number, tries = number + 1, 0
        if taken:
            numbers, of_draws = map(list, zip(*taken, strict=True))
            states[numbers] = draws[of_draws]
    states[:, pinned] = pins
    return states


def _hold(values: Floats, least: Floats, strict: Booleans) -> Booleans:
    """(...,) whether values (..., r) of half-spaces reach their thresholds (r,)."""
    return np.asarray(((values > least) | ((values == least) & ~strict)).all(axis=-1))


def _sigmas_outside(automaton: HybridAutomaton, start: Start, mode: Mode) -> float:
    """Distance of the start's mean outside a mode's range and pins in standard deviations; 0 inside."""
    mean, std = np.array(start.mean), np.array(start.std)
    outside = [min((_sigmas_beyond(mean, std, region) for region in start_regions(automaton, mode)), default=np.inf)]
    for pin in mode.pins:
        distance = abs(float(mean[pin.coordinate]) - pin.value)
        spread = float(np.hypot(std[pin.coordinate], pin.std))
        outside.append(distance / max(spread, SMALLEST_STD))
    return max(outside)


def _sigmas_beyond(mean: Floats, std: Floats, region: Region) -> float:
    """As `_sigmas_outside` for a region; a small fraction of the range's width counts as inside."""
    outside = 0.0
    for half_space in region.half_spaces:
        weights = np.array(half_space.a)
        size = float(np.linalg.norm(weights)) or 1.0
        shortage = -float(half_space.margin(mean, np.zeros(len(half_space.b)))) / size
        if half_space.bound is not None:
            low, high = region.interval(half_space.bound.coordinate)
            shortage -= EQUAL * (high - low) if np.isfinite(high - low) else 0.0
        if shortage > 0:
            outside = max(outside, shortage / max(float(np.linalg.norm(std * weights)) / size, SMALLEST_STD))
    return outside
