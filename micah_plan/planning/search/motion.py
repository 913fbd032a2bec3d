"""Straight motions inside one mode: which the dynamics and the guards allow, and how many steps they take."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from micah_plan.arrays import Booleans, Floats
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.region import Region
from micah_plan.planning.limits import Limits
from micah_plan.planning.path_constraints import admitted
from micah_plan.planning.search.polytope import TOLERANCE
from micah_plan.task.problem import Problem

# Share of the largest step that a path is divided by: what is left is for the feedback and the optimisation.
PACE = 0.6
# Share of a step by which the reachable end of a motion may miss its target: rounding of the pseudo-inverse.
_MISS = 1e-7


@dataclass(frozen=True, eq=False)
class ModeMotion:
    """Motions x -> y of one mode.

    Attributes:
        B: (n, m) input matrix.
        max_step: (m,) largest input per step.
        speed: (n,) scale of each coordinate [rad or m per step].
        obstacles: guards on x alone that leave the mode: a motion may end on the boundary of one, where the transition
            happens, but not enter it.
        admits: (k,) whether constraints on the path let states (k, n) be passed; None: there are none.
    """

    B: Floats
    max_step: Floats
    speed: Floats
    obstacles: tuple[Region, ...]
    admits: Callable[[Floats], Booleans] | None = None

    def steps(self, x: Floats, y: Floats) -> Floats:
        """(k,) number of steps (not rounded) of the straight motions x (k, n) -> y (k, n); infinite if not allowed."""
        delta = y - x
        u = delta @ np.linalg.pinv(self.B).T
        missed = np.max(np.abs(delta - u @ self.B.T) / self.speed, axis=-1, initial=0.0)
        steps = np.linalg.norm(u / self.max_step, axis=-1)
        steps[missed > _MISS * (1.0 + steps)] = np.inf
        for obstacle in self.obstacles:
            steps[_blocked(obstacle, x, y)] = np.inf
        possible = np.flatnonzero(np.isfinite(steps))
        if self.admits is not None and possible.size:
            # Asked where steps of a motion end, as in a plan: not where it begins.
            for share in np.linspace(0.0, 1.0, 1 + int(np.ceil(max(1.0, steps[possible].max()))))[1:]:
                passed = self.admits(x[possible] + share * delta[possible])
                steps[possible[~passed]] = np.inf
        return np.asarray(steps)

    def shortcut(self, path: Floats) -> Floats:
        """(w, n) the path (k, n) without the states that a straight motion can leave out."""
        corners, i = [0], 0
        while i < len(path) - 1:
            ends = np.arange(len(path) - 1, i, -1)
            allowed = np.isfinite(self.steps(np.repeat(path[i : i + 1], len(ends), axis=0), path[ends]))
            i = int(ends[np.argmax(allowed)]) if allowed.any() else i + 1
            corners.append(i)
        return path[corners]


def motions_of(problem: Problem, limits: Limits) -> dict[str, ModeMotion]:
    """The motions of each mode, within what is asked of the path."""
    automaton, motions = problem.automaton, {}
    for mode in automaton.modes:
        admits = partial(admitted, problem, limits, mode.name) if problem.constraints else None
        obstacles = obstacles_on_state(automaton, mode.name)
        motions[mode.name] = ModeMotion(mode.B, limits.max_step, limits.speed, obstacles, admits)
    return motions


def obstacles_on_state(automaton: HybridAutomaton, mode: str) -> tuple[Region, ...]:
    """The guards that leave a mode and depend on x alone; others are avoided by the choice of the input."""
    guards = [edge.guard for edge in automaton.edges_from(mode) if not edge.is_self_transition]
    return tuple(g for g in guards if g.half_spaces and not g.on_input)


def _blocked(guard: Region, x: Floats, y: Floats) -> Booleans:
    """(k,) whether each motion has a part inside the guard, more than a point of its boundary."""
    u = np.zeros((*x.shape[:-1], len(guard.half_spaces[0].b)))
    before, after = guard.margins(x, u), guard.margins(y, u)
    slope = after - before
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = (TOLERANCE - before) / slope
    enter = np.where(slope > 0, crossing, np.where(before > TOLERANCE, -np.inf, np.inf))
    enter = np.where(slope < 0, -np.inf, enter)
    leave = np.where(slope < 0, crossing, np.inf)
    return np.asarray(np.minimum(leave.min(axis=-1), 1.0) - np.maximum(enter.max(axis=-1), 0.0) > TOLERANCE)
