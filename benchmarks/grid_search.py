"""POMCP on a grid, as a user would write it: an exact Bayes filter over cells, and a tree of actions and observations.

A cell is a mode and a box of states. Where an action leads from there is sampled from the real transitions, from places
and with noise drawn anew, a fixed number of times; the filter and the search know nothing else. The tree's actions move
each input by all or a quarter of its largest step, or stop: stopping pays 1 in the goal and 0 elsewhere. Leaves are
valued by walking on by dead reckoning and stopping there.

Source: Silver and Veness, "Monte-Carlo planning in large POMDPs", NIPS 2010.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from user_code import SPARE_STEPS, Reader, begun

from micah_plan.arrays import Floats, Ints
from micah_plan.automaton.augmented import drawn_shifts
from micah_plan.automaton.transition import TransitionBatch
from micah_plan.planning.limits import limits_of
from micah_plan.planning.roll_outs import Chances, measurement_std

# Cells along a coordinate at least, and samples of where an action leads from a cell.
_CELLS, _SAMPLES = 80, 8
# What a later reward counts per step, and how much is explored.
_DISCOUNT, _EXPLORE = 0.99, 0.3
# A grid of more cells than this is not searched.
_MOST = 200_000


@dataclass(eq=False)
class _Node:
    """A history: visits and mean return per action, and what follows each observation."""

    visits: list[int]
    value: list[float]
    after: dict[tuple[int, int], _Node] = field(default_factory=dict)


class Grid:
    """Cells of a problem, and what the actions do between them."""

    def __init__(self, reader: Reader, seed: int) -> None:
        """Samples all transitions."""
        problem, self.reader = reader.problem, reader
        automaton, limits, rng = problem.automaton, limits_of(problem), np.random.default_rng(seed)
        spread = 3.0 * np.array(problem.start.std, dtype=float)
        self.lower = np.minimum(limits.lower, reader.start - spread)
        self.upper = np.maximum(limits.upper, reader.start + spread)
        finest = np.full(automaton.n, np.inf)
        for index, _, tolerance in problem.goal.target:
            finest[index] = tolerance
        self.size = np.minimum((self.upper - self.lower) / _CELLS, finest)
        self.shape = np.maximum(1, np.ceil((self.upper - self.lower) / self.size)).astype(int)
        self.per_mode = int(self.shape.prod())
        self.count = self.per_mode * len(automaton.modes)
        if self.count > _MOST:
            raise ValueError(f"{self.count} cells")
        index = np.arange(self.per_mode)
        self.center = self.lower + (np.stack(np.unravel_index(index, self.shape), axis=1) + 0.5) * self.size
        shares = [np.array(own) for own in product((-1.0, -0.25, 0.0, 0.25, 1.0), repeat=automaton.m)]
        own = [s for s in shares if np.count_nonzero(s) < 2 or np.all(np.abs(s) != 0.25)]
        self.actions = np.array(own) * reader.max_step
        self.next = self._sampled(rng)
        every = np.tile(self.center, (len(automaton.modes), 1))
        modes = np.repeat(np.arange(len(automaton.modes)), self.per_mode)
        admitted = problem.goal.admitted(automaton.mode_names)
        self.in_goal = (admitted[modes] & problem.goal.holds(every)).astype(float)
        self.std = np.where(seen := measurement_std(problem, modes, every), seen, 1.0)
        self.is_seen = np.isfinite(automaton.noise.observation_std)
        coarse = np.maximum(self.size, self.std)
        self.drawn = rng.standard_normal((4096, automaton.n))
        # A few observations of each cell, as numbers of coarse boxes.
        noisy = every[:, None] + self.std[:, None] * rng.standard_normal((self.count, _SAMPLES, automaton.n))
        boxes = np.floor((noisy - self.lower) / coarse[:, None]).astype(np.int64) * self.is_seen
        self.observed = (boxes @ (1009 ** np.arange(automaton.n))).tolist()

    def cell(self, modes: Ints, x: Floats) -> Ints:
        """(...,) numbers of the cells of modes and states (..., n)."""
        at = np.clip(np.floor((x - self.lower) / self.size).astype(int), 0, self.shape - 1)
        return np.asarray(modes * self.per_mode + np.ravel_multi_index(tuple(np.moveaxis(at, -1, 0)), self.shape))

    def _sampled(self, rng: np.random.Generator) -> Ints:
        """(cells, actions, samples) cells after each action, from objects and places drawn anew."""
        automaton = self.reader.problem.automaton
        found = np.empty((self.count, len(self.actions), _SAMPLES), dtype=np.int64)
        std = np.array(automaton.noise.process_std)
        modes = np.repeat(np.arange(len(automaton.modes)), self.per_mode)
        center = np.tile(self.center, (len(automaton.modes), 1))
        for sample in range(_SAMPLES):
            objects = TransitionBatch(automaton, drawn_shifts(automaton, rng, self.count))
            x = center + self.size * rng.uniform(-0.5, 0.5, center.shape)
            for number, u in enumerate(self.actions):
                noise = std * rng.standard_normal(x.shape)
                after, moved = objects.step(modes, x, np.tile(u, (self.count, 1)), noise)
                found[:, number, sample] = self.cell(after, moved)
        return found

    def start(self) -> Floats:
        """(cells,) the start's belief."""
        problem = self.reader.problem
        std = np.maximum(np.array(problem.start.std, dtype=float), 0.3 * self.size)
        weight = np.exp(-0.5 * np.square((self.center - self.reader.start) / std).sum(axis=1))
        belief = np.zeros(self.count)
        mode = problem.automaton.mode_index(problem.start.mode or problem.automaton.modes[0].name)
        belief[mode * self.per_mode : (mode + 1) * self.per_mode] = weight
        return belief / belief.sum()

    def after(self, belief: Floats, action: int, z: Floats) -> Floats:
        """The belief after an action and a measurement (n,)."""
        likely = np.flatnonzero(belief > 1e-9)
        moved = np.zeros(self.count)
        np.add.at(moved, self.next[likely, action], belief[likely, None] / _SAMPLES)
        here = np.flatnonzero(moved)
        std = np.hypot(self.std[here], 0.3 * self.size)
        off = (z - self.center[here % self.per_mode])[:, self.is_seen] / std[:, self.is_seen]
        log = -0.5 * np.square(off).sum(axis=1) - np.log(std[:, self.is_seen]).sum(axis=1)
        moved[here] *= np.exp(log - log.max())
        return np.asarray(moved / moved.sum())


class Search:
    """A tree search from one belief after another."""

    def __init__(self, grid: Grid, simulations: int, seed: int) -> None:
        self.grid, self.simulations, self.rng = grid, simulations, np.random.default_rng(seed)
        self.stop = len(grid.actions)
        self.next, self.in_goal = grid.next.tolist(), grid.in_goal.tolist()
        moves = grid.actions @ grid.reader.B.T
        self.moves = moves

    def best(self, belief: Floats, steps: int) -> int:
        """The action to take; `stop` ends the task."""
        root = _Node([0] * (self.stop + 1), [0.0] * (self.stop + 1))
        mean = belief.reshape(-1, self.grid.per_mode).sum(axis=0) @ self.grid.center
        self.dead = self._reckoned(mean, steps)
        states = self.rng.choice(self.grid.count, size=self.simulations, p=belief).tolist()
        self.random = self.rng.integers(_SAMPLES, size=(self.simulations, 2 * steps + 2)).tolist()
        for number, state in enumerate(states):
            self.drawn = self.random[number]
            self._simulate(state, root, 0, steps)
        return int(np.argmax(root.value))

    def _reckoned(self, mean: Floats, steps: int) -> list[int]:
        """Actions that lead from the mean to the aim, without looking."""
        actions, at = [], mean.copy()
        aim = self.grid.reader.aim
        own = self.grid.reader.B.any(axis=1)
        for _ in range(steps):
            left = np.abs((aim - at - self.moves)[:, own] / self.grid.size[own]).sum(axis=1)
            if (action := int(left.argmin())) == self._still:
                break
            actions.append(action)
            at = at + self.moves[action]
        return actions

    @property
    def _still(self) -> int:
        return int(np.flatnonzero(~self.grid.actions.any(axis=1))[0])

    def _simulate(self, state: int, root: _Node, depth: int, steps: int) -> None:
        """One walk down the tree, a new leaf, and the returns on the way back."""
        node, way = root, list[tuple[_Node, int]]()
        while True:
            action = self._chosen(node)
            way.append((node, action))
            if action == self.stop or depth >= steps:
                gain = self.in_goal[state] if action == self.stop else 0.0
                break
            state = self.next[state][action][self.drawn[depth]]
            seen = self.grid.observed[state][self.drawn[steps + depth]]
            depth += 1
            key = (action, seen)
            if key not in node.after:
                node.after[key] = _Node([0] * (self.stop + 1), [0.0] * (self.stop + 1))
                gain = self._walked(state, depth, steps)
                break
            node = node.after[key]
        for visited, action in reversed(way):
            visited.visits[action] += 1
            visited.value[action] += (gain - visited.value[action]) / visited.visits[action]
            gain *= _DISCOUNT

    def _chosen(self, node: _Node) -> int:
        total = sum(node.visits)
        if total <= self.stop:  # one after the other, all are tried once
            return next(k for k, count in enumerate(node.visits) if not count)
        scale = _EXPLORE * math.sqrt(math.log(total))
        bounds = [value + scale / math.sqrt(count) for value, count in zip(node.value, node.visits, strict=True)]
        return bounds.index(max(bounds))

    def _walked(self, state: int, depth: int, steps: int) -> float:
        """What walking on without looking, and stopping there, pays."""
        left = self.dead[depth:]
        for offset, action in enumerate(left[: steps - depth]):
            state = self.next[state][action][self.drawn[(depth + offset) % len(self.drawn)]]
        return self.in_goal[state] * _DISCOUNT ** len(left)


def searched(reader: Reader, chances: Chances, simulations: int, seed: int) -> tuple[Ints, Floats]:
    """Modes (t,) and states (t, n) in which executions of the search end.

    Raises:
        ValueError: if the problem has too many cells.
    """
    grid = Grid(reader, seed)
    search = Search(grid, simulations, seed)
    modes, x = begun(reader, chances)
    beliefs, ended = [grid.start() for _ in x], np.zeros(len(x), dtype=bool)
    most = reader.steps + SPARE_STEPS
    for step in range(most):
        chosen = np.full(len(x), search.stop)
        for trial in np.flatnonzero(~ended).tolist():
            chosen[trial] = search.best(beliefs[trial], most - step)
        ended |= chosen == search.stop
        if ended.all():
            break
        u = np.where(ended[:, None], 0.0, grid.actions[np.minimum(chosen, search.stop - 1)])
        noise = np.where(ended[:, None], 0.0, chances.process[step])
        modes, x = chances.objects.step(modes, x, u, noise)
        z = x + measurement_std(reader.problem, modes, x) * chances.observation[step]
        for trial in np.flatnonzero(~ended).tolist():
            beliefs[trial] = grid.after(beliefs[trial], int(chosen[trial]), z[trial])
    return modes, x
