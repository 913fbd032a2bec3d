"""Connectivity of leaves: mode sequences as linear programmes.

Random states of a mode with many leaves (`leaves`) lie on as many leaves, and almost none of them on one that leads on.
But modes, guards and resets are affine: for a given sequence of transitions the states in which they are taken, one
input per mode leading from each to the next, form a polytope. A point of it is a *passage* from start to goal, except
for obstacles inside the modes, which the roadmaps avoid. So a value that stays constant, such as the place where an
object is released, is determined by all later transitions, and infeasible sequences are detected at once.

Sequences are expanded in the order of the shortest inputs through them plus the remaining distance to the goal, which
has more weight, so that a hand that moves many things does not try them in all orders first (weighted A*: Pohl, 1970).
"""

from __future__ import annotations

import heapq
from collections.abc import Generator, Iterator
from dataclasses import dataclass, replace
from itertools import count, islice

import numpy as np
from scipy.optimize import linprog

from micah_plan.arrays import ROUND_OFF, Floats
from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Mode
from micah_plan.automaton.region import HalfSpace
from micah_plan.planning.avoided_inputs import admissible_inputs
from micah_plan.planning.limits import Limits
from micah_plan.planning.plan_cost import in_steps
from micah_plan.planning.search.polytope import Polytope, nominal_start, open_states
from micah_plan.planning.search.roadmap import TRANSITION_COST
from micah_plan.planning.zero_time_transitions import front_of
from micah_plan.task.deadline import NEVER, Deadline
from micah_plan.task.problem import Problem

# Sequences found after which there are enough, and linear programmes once there is one: 1 to 4 ms each.
_MOST_SEQUENCES = 24
_ENOUGH = 400
# How much a step that is left to the goal counts against one that was made: above 1 sequences that lead on go first.
_EAGERNESS = 2.0
# Weight of a remaining step within a sequence: with the weight of a completed one, detours would not be needed.
_LEFT = 1.05
# Steps by which a sequence goes last that came back to a mode without getting nearer to the goal.
_NO_NEARER = 100.0
# Passages of a sequence that are extreme in random directions, and random mixtures of all of them.
_EXTREMES = 4
_MIXTURES = 8
# Of the mixtures (Dirichlet): below 1 most lie near a corner or an edge, as what leads on often does.
_EVENNESS = 0.5
# What a programme may miss its constraints by [their unit]: less than what counts as the same boundary.
_MISS = 0.1 * ROUND_OFF


@dataclass(frozen=True, eq=False)
class Passage:
    """States of a path from start to goal.

    Attributes:
        modes: (P,) names; edges: (P-1,) indices into the automaton's edges.
        entries: (P, n) where each mode is entered, first the start; exits: (P, n) where it is left, last in the goal.
    """

    modes: tuple[str, ...]
    edges: tuple[int, ...]
    entries: Floats
    exits: Floats


def passage_exists(problem: Problem, limits: Limits, start_mode: str, revisits: int) -> bool | None:
    """Whether a passage to the goal exists with `revisits` returns; None if there are too many sequences to decide."""
    search = _Search(problem, limits)
    if next(search.complete(start_mode, NEVER, revisits), None) is not None:
        return True
    return None if search.is_over else False


@dataclass(frozen=True, eq=False)
class _Prefix:
    """A sequence of transitions from the start, as a polytope of its inputs w (v,), one u (m,) per mode.

    Attributes:
        modes, edges: as in `Passage`; the last mode has just been entered.
        entries, exits: per mode the matrix (n, v) and the vector (n,) that give the state for w.
        rows, least: of the constraints rows @ w >= least.
    """

    modes: tuple[str, ...]
    edges: tuple[int, ...]
    entries: tuple[tuple[Floats, Floats], ...]
    exits: tuple[tuple[Floats, Floats], ...]
    rows: Floats
    least: Floats

    @property
    def size(self) -> int:
        return int(self.rows.shape[1])


def passages(
    problem: Problem, limits: Limits, start_mode: str, rng: np.random.Generator, deadline: Deadline = NEVER
) -> Generator[Passage, None, bool]:
    """Passages through sequences of transitions, shortest first: the shortest of each, then random ones.

    Returns:
        whether the limit of linear programmes ended the search before any was found.

    Raises:
        TimeLimitError: if the deadline passes.
    """
    search = _Search(problem, limits)
    sequences = search.complete(start_mode, deadline, problem.settings.revisits)
    is_found = False
    for prefix, w in islice(sequences, _MOST_SEQUENCES):
        is_found = True
        yield search.passage(prefix, w)
        directions = rng.normal(size=(_EXTREMES if prefix.edges else 0, prefix.size))
        extremes = [search.extreme(prefix, direction) for direction in directions]
        corners = np.array([w, *(corner for corner in extremes if corner is not None)])
        for share in rng.dirichlet(np.full(len(corners), _EVENNESS), _MIXTURES) if len(corners) > 1 else ():
            yield search.passage(prefix, share @ corners)
        for corner in corners[1:]:
            yield search.passage(prefix, corner)
    return not is_found and search.is_over


class _Search:
    """Best-first search over sequences of transitions by linear programmes."""

    def __init__(self, problem: Problem, limits: Limits) -> None:
        self.problem, self.limits, self.automaton = problem, limits, problem.automaton
        self.states = {mode.name: open_states(mode, limits) for mode in self.automaton.modes}
        self.leading = _leading_to_goal(problem)
        self.goal_error = max(1.0, float(in_steps(problem, np.array(problem.settings.weight_goal))))
        self.solved = 0

    @property
    def is_over(self) -> bool:
        """Whether the limit on linear programmes is reached."""
        return self.solved >= self.problem.settings.search_limit

    def complete(self, start_mode: str, deadline: Deadline, revisits: int) -> Iterator[tuple[_Prefix, Floats]]:
        """Sequences that reach the goal, each with the inputs (v,) of its shortest passage."""
        start = nominal_start(self.problem, self.limits, start_mode)
        entry = np.zeros((self.automaton.n, 0)), start
        first = _Prefix((start_mode,), (), (entry,), (), np.zeros((0, 0)), np.zeros(0))
        tickets, most = count(), 1 + revisits
        # With each sequence how far the goal was at least where it entered its modes.
        queue: list[tuple[float, int, _Prefix, tuple[float, ...], Floats | None]] = []
        heapq.heappush(queue, (0.0, next(tickets), first, (np.inf,), None))
        limit = self.problem.settings.search_limit
        while queue and self.solved < limit:
            deadline.check("search", f"{self.solved} mode sequences were relaxed", "search_limit")
            _, _, prefix, nearest, w = heapq.heappop(queue)
            if w is not None:
                yield prefix, w
                limit = min(limit, max(_ENOUGH, 2 * self.solved))
                continue
            mode = self.automaton.mode(prefix.modes[-1])
            ways = []
            if self.problem.goal.admits(mode.name):
                ways.append(self._with_goal(prefix, mode))
            for index, edge in enumerate(self.automaton.edges):
                leads_on = edge.source == mode.name and edge.target in self.leading and not edge.is_self_transition
                if leads_on and prefix.modes.count(edge.target) < most:
                    ways += self._with_transition(prefix, mode, index, edge)
            for way in ways:
                if (shortest := self.shortest(way)) is None:
                    continue
                made, shortfall, inputs = shortest
                done, key = len(way.exits) == len(way.modes), made + _EAGERNESS * shortfall
                before = [far for mode, far in zip(prefix.modes, nearest, strict=True) if mode == way.modes[-1]]
                if not done and before and shortfall >= min(before) - ROUND_OFF:
                    key += _NO_NEARER
                entered = nearest if done else (*nearest, shortfall)
                heapq.heappush(queue, (key, next(tickets), way, entered, inputs if done else None))

    def passage(self, prefix: _Prefix, w: Floats) -> Passage:
        """The passage of a complete sequence with inputs w (v,)."""
        entries, exits = (
            np.array([M @ w[: M.shape[1]] + c for M, c in places]) for places in (prefix.entries, prefix.exits)
        )
        return Passage(prefix.modes, prefix.edges, entries, exits)

    def shortest(self, prefix: _Prefix) -> tuple[float, float, Floats] | None:
        """The shortest inputs of a sequence; None if infeasible.

        Returns:
            the steps that they take, how far the goal is at least from where the sequence ends, or the error that is
            left in it [steps], and the inputs (v,).
        """
        v, m, done = prefix.size, self.automaton.m, len(prefix.exits) == len(prefix.modes)
        M, c = prefix.exits[-1] if done else prefix.entries[-1]
        goal, speed = self.problem.goal, self.limits.speed
        # What no input moves is no number of steps away.
        target = [row for row in goal.target if done or speed[row[0]] > 0]
        index = np.array([i for i, _, _ in target], dtype=int)
        value, tolerance = (np.array([row[k] for row in target]) for k in (1, 2))
        # In the goal the error left, which costs as much as the optimisation would pay at the tolerance.
        scale = tolerance / self.goal_error if done else speed[index]
        room = np.zeros(len(index)) if done else tolerance
        # Variables (w, |w|, e): e at least the error beyond the room, in steps.
        eye, g = np.eye(v), len(index)
        away, apart = M[index] / scale[:, None], (c[index] - value) / scale
        rows = np.block(
            [
                [prefix.rows, np.zeros((len(prefix.rows), v + g))],
                [eye, eye, np.zeros((v, g))],
                [-eye, eye, np.zeros((v, g))],
                [away, np.zeros((g, v)), np.eye(g)],
                [-away, np.zeros((g, v)), np.eye(g)],
            ]
        )
        least = np.concatenate([prefix.least, np.zeros(2 * v), -apart - room / scale, apart - room / scale])
        left = np.full(g, 1.0 if done else _LEFT)
        cost = np.concatenate([np.zeros(v), np.tile(1.0 / self.limits.max_step, v // m if m else 0), left])
        solution = self._optimum(cost, rows, least, v)
        if solution is None:
            return None
        made, shortfall = float(cost[v : 2 * v] @ solution[v : 2 * v]), float(solution[2 * v :].sum())
        return made + TRANSITION_COST * len(prefix.edges), shortfall, solution[:v]

    def extreme(self, prefix: _Prefix, direction: Floats) -> Floats | None:
        """The inputs (v,) of a sequence that go farthest in a direction (v,)."""
        scale = np.tile(1.0 / self.limits.max_step, prefix.size // self.automaton.m)
        # Unlimited inputs move nothing.
        limited = prefix.rows.any(axis=0)
        return self._optimum(np.where(limited, direction * scale, 0.0), prefix.rows, prefix.least, prefix.size)

    def _optimum(self, cost: Floats, rows: Floats, least: Floats, free: int) -> Floats | None:
        """The optimal variables, of which the first `free` may be negative; None if infeasible."""
        self.solved += 1
        bounds = [(None, None)] * free + [(0.0, None)] * (len(cost) - free)
        if not len(cost):
            return np.zeros(0) if np.all(least <= ROUND_OFF) else None
        # The solver takes finite numbers: what is not bounded is no row, and nothing meets a row that nothing can.
        if np.any(least == np.inf):
            return None
        rows, least = rows[least > -np.inf], least[least > -np.inf]
        options = {"primal_feasibility_tolerance": _MISS, "dual_feasibility_tolerance": _MISS}
        solution = linprog(cost, A_ub=-rows, b_ub=-least, bounds=bounds, method="highs", options=options)
        return np.asarray(solution.x) if solution.status == 0 else None

    def _with_input(self, prefix: _Prefix, mode: Mode) -> tuple[_Prefix, tuple[Floats, Floats]]:
        """The sequence extended by an input in its last mode, with the resulting state."""
        m = self.automaton.m
        rows = np.hstack([prefix.rows, np.zeros((len(prefix.rows), m))])
        M, c = prefix.entries[-1]
        place = np.hstack([M, mode.B * mode.free[:, None]]), c
        return replace(prefix, rows=rows, exits=(*prefix.exits, place)), place

    def _with_goal(self, prefix: _Prefix, mode: Mode) -> _Prefix:
        """The sequence extended by an input into the goal."""
        moved, place = self._with_input(prefix, mode)
        states = self.states[mode.name]
        for index, value, tolerance in self.problem.goal.target:
            # A pinned coordinate is where it is; others must come into the goal.
            states = states.clip(index, value - tolerance, value + tolerance)
        return _within(moved, states, place)

    def _with_transition(self, prefix: _Prefix, mode: Mode, index: int, edge: Edge) -> list[_Prefix]:
        """The sequence extended by a transition: one variant for each boundary of entry into its guard."""
        moved, place = self._with_input(prefix, mode)
        lowest, highest = admissible_inputs(mode, self.limits.max_step)
        moved = _within(moved, self.states[mode.name].intersect(edge.guard, lowest, highest), place)
        A, _, b = edge.reset.matrices(self.automaton.n, self.automaton.m)
        matrix, offset = A @ place[0], A @ place[1] + b
        target = self.automaton.mode(edge.target)
        for pin in target.pins:
            matrix[pin.coordinate], offset[pin.coordinate] = 0.0, pin.value
        for tie in target.ties:
            weights = np.array(tie.weights)
            matrix[tie.coordinate], offset[tie.coordinate] = weights @ matrix, tie.offset + weights @ offset
        entry = matrix, offset
        moved = _within(moved, self.states[edge.target], entry)
        modes, edges = (*prefix.modes, edge.target), (*prefix.edges, index)
        moved = replace(moved, modes=modes, edges=edges, entries=(*prefix.entries, entry))
        facets = [] if edge.guard.on_input else _facets(edge, mode)
        return [_on(moved, facet, place) for facet in facets] or [moved]


def _facets(edge: Edge, mode: Mode) -> list[HalfSpace]:
    """The half-spaces of a guard into which the inputs of the mode can lead."""
    B = mode.B * mode.free[:, None]
    return [h for h in front_of(edge) if np.any(np.array(h.a) @ B)]


def _within(prefix: _Prefix, states: Polytope, place: tuple[Floats, Floats]) -> _Prefix:
    """The sequence with the states at a place limited to a polytope."""
    M, c = place
    eye = np.eye(states.n)
    normals = np.vstack([eye, -eye, states.A])
    least = np.concatenate([states.lower, -states.upper, states.b])
    size = np.linalg.norm(normals, axis=1)
    rows, least = normals @ M, least - normals @ c
    open_ = rows.any(axis=1)
    # What no input changes holds or does not; a row without weights says which.
    broken = ~open_ & (least > ROUND_OFF * size)
    keep = open_ | broken
    return replace(prefix, rows=np.vstack([prefix.rows, rows[keep]]), least=np.append(prefix.least, least[keep]))


def _on(prefix: _Prefix, facet: HalfSpace, place: tuple[Floats, Floats]) -> _Prefix:
    """The sequence with the state at a place on a boundary."""
    M, c = place
    a = np.array(facet.a)
    rows, least = np.vstack([prefix.rows, -(a @ M)]), np.append(prefix.least, float(a @ c) - facet.c)
    return replace(prefix, rows=rows, least=least)


def _leading_to_goal(problem: Problem) -> set[str]:
    """The modes with a transition into a mode that the goal admits."""
    automaton: HybridAutomaton = problem.automaton
    leading = {name for name in automaton.mode_names if problem.goal.admits(name)}
    for _ in automaton.modes:
        leading |= {edge.source for edge in automaton.edges if edge.target in leading}
    return leading
