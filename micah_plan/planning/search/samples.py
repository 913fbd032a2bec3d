"""Samples for the roadmaps: start, goal, guards with their resets, and random states.

States on the faces of guards line narrow corridors, where random ones rarely fall (Amato and Wu, "A randomized roadmap
method for path and manipulation planning", ICRA 1996, for samples on the faces of obstacles).

In modes with many leaves (`leaves`) states come from passages to the goal, and random ones lie on their leaves.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import Booleans, Floats, Ints
from micah_plan.automaton.hybrid import Edge, Mode
from micah_plan.automaton.region import Region
from micah_plan.planning.avoided_inputs import admissible_inputs
from micah_plan.planning.limits import Limits, named_values
from micah_plan.planning.search.leaves import Leaves, leaves_of
from micah_plan.planning.search.passages import Passage, passages
from micah_plan.planning.search.polytope import Polytope, mode_states, nominal_start
from micah_plan.planning.search.roadmap import obstacles_on_state
from micah_plan.planning.zero_time_transitions import front_of
from micah_plan.task.deadline import NEVER, Deadline
from micah_plan.task.problem import Problem

# Share of sampled coordinates that take a value named in the problem or model.
_LANDMARK_SHARE = 0.3
_FEWEST_GUARD_STATES = 4
# Least share of samples_per_mode that are random states, however many states guards have.
_FREE_SHARE = 0.5
# Fewest random states on a leaf.
_FEWEST_LEAF_STATES = 4


@dataclass(frozen=True, eq=False)
class Samples:
    """All sampled states.

    Attributes:
        points: (v, n) states by mode name.
        exits: (k, 2) numbers (state in the source mode, state after the reset in the target mode) by edge index; only
            edges between modes that a sampled state can take.
        start: its mode and the number of its state there.
        goals: numbers of the states within the goal by mode; only modes that hold such states.
        is_cut_short: whether `search_limit` ended the search for passages before any was found.
    """

    points: dict[str, Floats]
    exits: dict[int, Ints]
    start: tuple[str, int]
    goals: dict[str, Ints]
    is_cut_short: bool = False


def sample_modes(
    problem: Problem, limits: Limits, start_mode: str, rng: np.random.Generator, deadline: Deadline = NEVER
) -> Samples:
    """Draw the states of every mode. The same generator state gives the same samples.

    Raises:
        TimeLimitError: if the deadline passes.
    """
    sampler = _Sampler(problem, limits, rng, deadline)
    start = sampler.add(start_mode, nominal_start(problem, limits, start_mode))
    sampler.add_goals()
    sampler.add_guards()
    sampler.add_passages(start_mode)
    sampler.add_random()
    points = {name: np.array(sampler.points_of(name)).reshape(-1, problem.automaton.n) for name in sampler.states}
    goals = {name: np.flatnonzero(states.contains(points[name])) for name, states in sampler.goals.items()}
    return Samples(points, sampler.exits, (start_mode, start), goals, sampler.is_cut_short)


class _Sampler:
    """Samples states of a problem's modes in stages.

    Attributes:
        start, target: (n,) the start's mean, and the same with the goal's values.
        states: set of states by mode; goals: its intersection with the goal, for modes that have one.
        exits: see `Samples`.
    """

    def __init__(self, problem: Problem, limits: Limits, rng: np.random.Generator, deadline: Deadline) -> None:
        """Args: see `sample_modes`."""
        self._problem, self._automaton, self._limits = problem, problem.automaton, limits
        self._rng, self._deadline = rng, deadline
        self._landmarks = [np.array(list(dict.fromkeys(values))) for values in named_values(problem)]
        self.start = np.array(problem.start.mean)
        self.target = problem.goal.reached_from(self.start)
        self.states = {mode.name: mode_states(mode, limits) for mode in self._automaton.modes}
        self._leaves = {mode.name: leaves_of(mode, limits) for mode in self._automaton.modes}
        self._on_leaves: dict[str, list[Floats]] = {
            mode: [] for mode, leaves_of_mode in self._leaves.items() if leaves_of_mode.are_many
        }
        self._added: dict[str, dict[bytes, tuple[int, Floats]]] = {name: {} for name in self.states}
        sets = {name: goal_states(problem, limits, name) for name in self.states}
        self.goals = {name: states for name, states in sets.items() if not states.is_empty}
        self.exits: dict[int, Ints] = {}
        self.is_cut_short = False

    def add(self, mode: str, point: Floats) -> int:
        """Index of a state (n,) in its mode; states are stored once."""
        added = self._added[mode]
        return added.setdefault((point + 0.0).tobytes(), (len(added), point))[0]  # + 0.0 makes a negative zero positive

    def points_of(self, mode: str) -> list[Floats]:
        """The states of a mode, in the order of their numbers."""
        return [point for _, point in self._added[mode].values()]

    def add_goals(self) -> None:
        """Add states in the goal: the nearest to its values, and random ones."""
        for name, states in self.goals.items():
            if name in self._on_leaves:
                continue
            nearest = states.nearest(self.target)
            for point in [nearest, *self._draw(states, self._leaves[name], _FEWEST_GUARD_STATES)]:
                self.add(name, point)

    def add_guards(self) -> None:
        """Sample states on the guards, together with their images under the resets."""
        for index, edge in enumerate(self._automaton.edges):
            state = f"{index} of {len(self._automaton.edges)} guards had states"
            self._deadline.check("search", state, "samples_per_mode")
            if edge.is_self_transition or (states := guard_states(self._problem, self._limits, edge)).is_empty:
                continue
            count = max(_FEWEST_GUARD_STATES, self._problem.settings.samples_per_mode // 8)
            before = [states.nearest(self.start), states.nearest(self.target)]
            if edge.source not in self._on_leaves:
                before += list(self._draw(states, self._leaves[edge.source], count))
            # Also where the edge leads nowhere: it is an obstacle, and a corridor next to it needs states.
            pairs = [self._add_exit(edge, _on_boundary(states, edge, x)) for x in before]
            if taken := dict.fromkeys(pair for pair in pairs if pair is not None):
                self.exits[index] = np.array(list(taken), dtype=np.int64)

    def add_passages(self, start_mode: str) -> None:
        """Add states where passages enter and leave modes, if a mode has many leaves."""
        if not self._on_leaves:
            return
        rng = self._rng.spawn(1)[0]
        for passage in self._passages(start_mode, rng):
            entry = passage.entries[0]
            for i, name in enumerate(passage.modes):
                if name in self._on_leaves:
                    self._on_leaves[name].append(entry)
                # The rounding of the linear programme must not leave the leaf.
                leave = self._leaves[name].projected_on_leaf(entry, passage.exits[i])
                if i == len(passage.edges):
                    self.add(name, leave)
                    break
                index = passage.edges[i]
                edge = self._automaton.edges[index]
                if (pair := self._add_exit(edge, leave, True)) is None:
                    break
                before = self.exits.get(index, np.zeros((0, 2), dtype=np.int64))
                self.exits[index] = np.unique(np.vstack([before, pair]), axis=0)
                entry = self.points_of(edge.target)[pair[1]]

    def _passages(self, start_mode: str, rng: np.random.Generator) -> Iterator[Passage]:
        """The passages; notes whether the search hit its limit."""
        self.is_cut_short = yield from passages(self._problem, self._limits, start_mode, rng, self._deadline)

    def add_random(self) -> None:
        """Random states outside of the guards on states."""
        wanted = self._problem.settings.samples_per_mode
        for number, mode in enumerate(self._automaton.modes):
            state = f"{number} of {len(self._automaton.modes)} modes had states"
            self._deadline.check("search", state, "samples_per_mode")
            if mode.name in self._on_leaves:
                self._add_random_on_leaves(mode, wanted)
                continue
            # Many guards must not leave the space between them without states.
            missing = max(wanted - len(self._added[mode.name]), int(_FREE_SHARE * wanted))
            if not self.states[mode.name].is_empty:
                self._add_outside(mode, self._draw(self.states[mode.name], self._leaves[mode.name], missing))

    def _add_random_on_leaves(self, mode: Mode, wanted: int) -> None:
        """Add random states on the leaves of passages, most on the first, and on faces of guards there."""
        leaves, bases = self._leaves[mode.name], np.array(self._on_leaves[mode.name])
        if not len(bases) or not leaves.along.shape[1]:
            return
        first = np.unique(leaves.numbers(bases), return_index=True)[1]
        shares = 1.0 / (1.0 + np.arange(len(first)))
        for base, share in zip(bases[np.sort(first)], shares / shares.sum(), strict=True):
            states, count = leaves.states(self._limits, base), max(_FEWEST_LEAF_STATES, int(share * wanted))
            if states.is_empty:
                continue
            self._add_outside(mode, self._draw(states, leaves, count, base))
            for region in obstacles_on_state(self._automaton, mode.name):
                if (inside := states.intersect(region, -self._limits.max_step, self._limits.max_step)).is_empty:
                    continue
                for point in inside.sample(self._rng, max(_FEWEST_GUARD_STATES, count // 8)):
                    self.add(mode.name, _on_face(inside, region, leaves.projected_on_leaf(base, point), leaves))

    def _add_outside(self, mode: Mode, points: Floats) -> None:
        """Add the states (k, n) that lie outside of the guards on the state."""
        for point in points[~inside_any(obstacles_on_state(self._automaton, mode.name), points)]:
            self.add(mode.name, point)

    def _add_exit(self, edge: Edge, x: Floats, only_if_allowed: bool = False) -> tuple[int, int] | None:
        """Indices of the states before and after an edge taken at x; None if outside the target's invariant."""
        after, target = edge.reset.apply(x, np.zeros(self._automaton.m)), self._automaton.mode(edge.target)
        for pin in target.pins:
            after[pin.coordinate] = pin.value
        for tie in target.ties:
            after[tie.coordinate] = tie.value(after)
        leads_on = bool(self.states[edge.target].contains(after))
        if only_if_allowed and not leads_on:
            return None
        number = self.add(edge.source, x)
        return (number, self.add(edge.target, after)) if leads_on else None

    def _draw(self, states: Polytope, leaves: Leaves, count: int, base: Floats | None = None) -> Floats:
        """(count, n) random states, on the leaf of a state if it is given.

        Coordinates that inputs move independently take values named by the problem or the model now and then.
        """
        random = states.sample(self._rng, count) if base is None else leaves.sample(states, base, self._rng, count)
        named = np.stack([self._rng.choice(values, count) for values in self._landmarks], axis=1)
        mixed = (self._rng.random(random.shape) < _LANDMARK_SHARE) & leaves.independent
        points = np.where(mixed, named, random)
        return np.asarray(np.where(states.contains(points)[:, None], points, random))


def goal_states(problem: Problem, limits: Limits, mode: str) -> Polytope:
    """The states of a mode that lie within the goal; empty if the goal excludes the mode."""
    states = mode_states(problem.automaton.mode(mode), limits)
    for index, value, tolerance in problem.goal.target:
        states = states.clip(index, value - tolerance, value + tolerance)
    if not problem.goal.admits(mode):
        states = states.clip(0, np.inf, -np.inf)
    return states


def guard_states(problem: Problem, limits: Limits, edge: Edge) -> Polytope:
    """The states of an edge's source mode at which some admissible input within the limits takes the edge."""
    mode = problem.automaton.mode(edge.source)
    return mode_states(mode, limits).intersect(edge.guard, *admissible_inputs(mode, limits.max_step))


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
    half_spaces = front_of(edge)
    if edge.guard.on_input:
        return x
    normals = [np.array(h.a) for h in half_spaces]
    shifts = [a * (float(a @ x) - h.c) / float(a @ a) for a, h in zip(normals, half_spaces, strict=True) if a.any()]
    for shift in sorted(shifts, key=lambda s: float(np.linalg.norm(s))):
        if states.contains(x - shift):
            return np.asarray(np.clip(x - shift, states.lower, states.upper))
    return x


def _on_face(states: Polytope, region: Region, x: Floats, leaves: Leaves) -> Floats:
    """The state moved within its leaf to the closest boundary of a region; x if no such point lies in the mode."""
    moved = []
    for half_space in region.half_spaces:
        a = np.array(half_space.a)
        direction = leaves.projected_on_leaf(x, x + a * np.square(leaves.speed)) - x
        if a @ direction > 0.0:
            moved.append(x - direction * (float(a @ x) - half_space.c) / float(a @ direction))
    moved.sort(key=lambda y: float(np.linalg.norm((y - x) / leaves.speed)))
    return next((y for y in moved if states.contains(y)), x)
