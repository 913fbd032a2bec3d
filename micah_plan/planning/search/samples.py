"""The states from which the roadmaps are built: start, goal, guards with their resets, and random states.

States on the faces of guards line narrow corridors, where random ones rarely fall (Amato and Wu, "A randomized roadmap
method for path and manipulation planning", ICRA 1996, for samples on the faces of obstacles).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.hybrid import Edge, Mode
from micah_plan.automaton.region import Region
from micah_plan.planning.limits import Limits
from micah_plan.planning.search.motion import obstacles_on_state
from micah_plan.planning.search.polytope import TOLERANCE, Polytope, mode_states
from micah_plan.task.deadline import NEVER, Deadline
from micah_plan.task.problem import Problem

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Booleans = NDArray[np.bool_]

# Share of sampled coordinates that take a value named in the problem or model: it connects modes that hold coordinates.
_LANDMARK_SHARE = 0.3
_FEWEST_GUARD_STATES = 4
# Least share of samples_per_mode that are random states, however many states guards have.
_FREE_SHARE = 0.5
# Arrivals in modes that hold coordinates are carried on at most so often.
_MOST_CARRIED = 200


@dataclass(eq=False)
class ModeStates:
    """Distinct states of one mode, numbered in the order in which they were added."""

    states: Polytope
    points: list[Floats] = field(default_factory=list)
    numbers: dict[bytes, int] = field(default_factory=dict)

    def add(self, point: Floats) -> int:
        """The number of a state (n,), new or known."""
        key = (point + 0.0).tobytes()  # + 0.0 makes a negative zero positive
        if key not in self.numbers:
            self.numbers[key] = len(self.points)
            self.points.append(point)
        return self.numbers[key]


@dataclass(frozen=True, eq=False)
class Samples:
    """All sampled states.

    Attributes:
        modes: states by mode name.
        exits: (k, 2) numbers (state in the source mode, state after the reset in the target mode) by edge index; only
            edges between modes that a sampled state can take.
        start: number of the start state in the start mode.
        goals: numbers of the states within the goal by mode; only modes that hold such states.
    """

    modes: dict[str, ModeStates]
    exits: dict[int, Ints]
    start: int
    goals: dict[str, Ints]


def sample_modes(
    problem: Problem, limits: Limits, start_mode: str, rng: np.random.Generator, deadline: Deadline = NEVER
) -> Samples:
    """Draw the states of every mode. The same generator state gives the same samples.

    Raises:
        TimeLimitError: if the deadline passes.
    """
    automaton = problem.automaton
    modes = {
        mode.name: ModeStates(mode_states(mode, limits.lower, limits.upper, limits.max_step))
        for mode in automaton.modes
    }
    landmarks = _landmarks(problem)
    start = modes[start_mode].add(modes[start_mode].states.nearest(np.array(problem.start.mean)))
    target = np.array(problem.start.mean)
    for index, value, _ in problem.goal.target:
        target[index] = value
    goal_sets = {name: states for name in modes if not (states := goal_states(problem, limits, name)).is_empty}
    for name, states in goal_sets.items():
        mode = automaton.mode(name)
        fit = np.where(_held(mode), np.array(problem.start.mean), target)
        points = [
            states.nearest(target),
            states.nearest(fit),
            *_draw(states, mode, landmarks, rng, _FEWEST_GUARD_STATES),
        ]
        for point in points:
            modes[name].add(point)
    exits: dict[int, Ints] = {}
    for index, edge in enumerate(automaton.edges):
        deadline.check("search", f"{index} of {len(automaton.edges)} guards had states", "samples_per_mode")
        if len(taken := _sample_guard(problem, limits, modes, edge, landmarks, target, rng)):
            exits[index] = taken
    _carry_held(problem, limits, modes, goal_sets, exits, start_mode, target, deadline)
    for number, mode in enumerate(automaton.modes):
        deadline.check("search", f"{number} of {len(automaton.modes)} modes had states", "samples_per_mode")
        chosen = modes[mode.name]
        # Many guards must not leave the space between them without states.
        wanted = problem.settings.samples_per_mode
        missing = max(wanted - len(chosen.points), int(_FREE_SHARE * wanted))
        if not chosen.states.is_empty:
            obstacles = obstacles_on_state(automaton, mode.name)
            random = _draw(chosen.states, mode, landmarks, rng, missing)
            for point in random[~inside_any(obstacles, random)]:
                chosen.add(point)
    goals = {name: np.flatnonzero(states.contains(np.array(modes[name].points))) for name, states in goal_sets.items()}
    return Samples(modes, exits, start, goals)


def goal_states(problem: Problem, limits: Limits, mode: str) -> Polytope:
    """The states of a mode that lie within the goal; empty if the goal excludes the mode."""
    states = mode_states(problem.automaton.mode(mode), limits.lower, limits.upper, limits.max_step)
    for index, value, tolerance in problem.goal.target:
        states = states.clip(index, value - tolerance, value + tolerance)
    if not problem.goal.admits(mode):
        states = states.clip(0, np.inf, -np.inf)
    return states


def guard_states(problem: Problem, limits: Limits, edge: Edge) -> Polytope:
    """The states of an edge's source mode at which some input within the limits takes the edge."""
    source = mode_states(problem.automaton.mode(edge.source), limits.lower, limits.upper, limits.max_step)
    return source.intersect(edge.guard, limits.max_step)


def _sample_guard(
    problem: Problem,
    limits: Limits,
    modes: dict[str, ModeStates],
    edge: Edge,
    landmarks: list[Floats],
    target: Floats,
    rng: np.random.Generator,
) -> Ints:
    """(k, 2) pairs of states before and after the edge, added to its two modes."""
    automaton = problem.automaton
    if edge.is_self_transition or (states := guard_states(problem, limits, edge)).is_empty:
        return np.zeros((0, 2), dtype=np.int64)
    count = max(_FEWEST_GUARD_STATES, problem.settings.samples_per_mode // 8)
    before = [states.nearest(np.array(problem.start.mean)), states.nearest(target)]
    before += list(_draw(states, automaton.mode(edge.source), landmarks, rng, count))
    pairs: dict[tuple[int, int], None] = {}
    for x in (_on_boundary(states, edge, x) for x in before):
        # Also where the edge leads nowhere: it is in the way, and a corridor beside it needs states.
        number, after = modes[edge.source].add(x), _after(problem, edge, x)
        if modes[edge.target].states.contains(after):
            pairs[number, modes[edge.target].add(after)] = None
    return np.array(list(pairs), dtype=np.int64).reshape(-1, 2)


def inside_any(regions: Sequence[Region], points: Floats) -> Booleans:
    """(k,) whether points (k, n) lie inside of any region."""
    inside = np.zeros(len(points), dtype=bool)
    for region in regions:
        u = np.zeros((len(points), len(region.half_spaces[0].b)))
        inside |= (region.margins(points, u) > 0.0).all(axis=1)
    return inside


def _on_boundary(states: Polytope, edge: Edge, x: Floats) -> Floats:
    """The state moved to the closest boundary of the guard within the mode: where a motion takes the transition.

    A guard that depends on the input can be taken anywhere, and a guard that fills the mode has no boundary in it.
    """
    half_spaces = edge.guard.half_spaces
    if edge.guard.on_input:
        return x
    normals = [np.array(h.a) for h in half_spaces]
    shifts = [a * (float(a @ x) - h.c) / float(a @ a) for a, h in zip(normals, half_spaces, strict=True) if a.any()]
    for shift in sorted(shifts, key=lambda s: float(np.linalg.norm(s))):
        if states.contains(x - shift):
            return np.asarray(np.clip(x - shift, states.lower, states.upper))
    return x


def _carry_held(
    problem: Problem,
    limits: Limits,
    modes: dict[str, ModeStates],
    goal_sets: dict[str, Polytope],
    exits: dict[int, Ints],
    start_mode: str,
    target: Floats,
    deadline: Deadline,
) -> None:
    """Add the states to which arrivals in modes that hold coordinates can go on: to the goal, to guards, and beyond.

    A mode that holds a coordinate wherever it was when it was entered connects only states with that same value.
    """
    automaton = problem.automaton
    targets = {index: automaton.edges[index].target for index in exits}
    arrivals = [(start_mode, modes[start_mode].points[0])]
    arrivals += [(name, modes[name].points[k]) for index, name in targets.items() for k in exits[index][:, 1]]
    for name, x in arrivals:
        deadline.check("search", f"{len(arrivals)} arrivals were carried on", "samples_per_mode")
        held = _held(automaton.mode(name))
        if not held.any() or len(arrivals) > _MOST_CARRIED:
            continue
        if name in goal_sets and (there := _at(goal_sets[name], held, x)) is not None:
            modes[name].add(there.nearest(target))
        for index, edge in enumerate(automaton.edges):
            if edge.source != name or edge.is_self_transition:
                continue
            if (there := _at(guard_states(problem, limits, edge), held, x)) is None:
                continue
            before = _on_boundary(there, edge, there.nearest(x))
            after = _after(problem, edge, before)
            if modes[edge.target].states.contains(after):
                known = len(modes[edge.target].points)
                pair = modes[name].add(before), modes[edge.target].add(after)
                exits[index] = np.unique(np.vstack([exits.get(index, np.zeros((0, 2), dtype=np.int64)), pair]), axis=0)
                if len(modes[edge.target].points) > known:
                    arrivals.append((edge.target, after))


def _at(states: Polytope, held: Booleans, x: Floats) -> Polytope | None:
    """The part of a set in which the held coordinates are those of x; None if it is empty."""
    for i in np.flatnonzero(held):
        if not states.lower[i] - TOLERANCE <= x[i] <= states.upper[i] + TOLERANCE:
            return None
        states = states.fix(int(i), float(x[i]))
    return None if states.is_empty else states


def _held(mode: Mode) -> Booleans:
    """(n,) the coordinates that a mode neither moves nor pins."""
    return ~mode.driven & mode.free


def _after(problem: Problem, edge: Edge, x: Floats) -> Floats:
    """(n,) the state behind an edge that is taken at x, in its target's pins."""
    after = edge.reset.apply(x, np.zeros(problem.automaton.m))
    for pin in problem.automaton.mode(edge.target).pins:
        after[pin.coordinate] = pin.value
    return after


def _landmarks(problem: Problem) -> list[Floats]:
    """Per coordinate the values that the problem and the model name: start, goal, pins and thresholds."""
    automaton = problem.automaton
    values = [[mean] for mean in problem.start.mean]
    for index, value, _ in problem.goal.target:
        values[index].append(value)
    for mode in automaton.modes:
        for pin in mode.pins:
            values[pin.coordinate].append(pin.value)
    regions = [mode.invariant for mode in automaton.modes] + [edge.guard for edge in automaton.edges]
    for half_space in (h for region in regions for h in region.half_spaces):
        if half_space.bound is not None:
            values[half_space.bound.coordinate].append(half_space.bound.value)
    return [np.array(list(dict.fromkeys(v))) for v in values]


def _draw(states: Polytope, mode: Mode, landmarks: list[Floats], rng: np.random.Generator, count: int) -> Floats:
    """(at most count, n) random states; coordinates that the mode cannot move take landmark values only."""
    random = states.sample(rng, count)
    named = np.stack([rng.choice(values, count) for values in landmarks], axis=1)
    held = _held(mode)
    mixed = (rng.random(random.shape) < _LANDMARK_SHARE) & mode.free
    points = np.where(mixed | held, named, random)
    fits = states.contains(points)
    if held.any():
        return np.asarray(points[fits])
    return np.asarray(np.where(fits[:, None], points, random))
