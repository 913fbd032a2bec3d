"""Closed convex sets of continuous states, as the high-level search sees invariants, guards and goals.

A set is a box (most sets of an articulated object are) and further half-spaces. Boxes are treated in closed form, other
sets with linear programmes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import eye_array, kron

from micah_plan.arrays import ROUND_OFF, Booleans, Floats
from micah_plan.automaton.hybrid import Mode
from micah_plan.automaton.region import Region
from micah_plan.planning.limits import Limits
from micah_plan.planning.no_way import NoWayError
from micah_plan.task.problem import Problem
from micah_plan.task.reason import Reason


@dataclass(frozen=True, eq=False)
class Polytope:
    """The set ``{x: lower <= x <= upper, A x >= b}``.

    Attributes:
        lower, upper: (n,) corners, finite [rad or m].
        A, b: (k, n), (k,) half-spaces that are not parallel to an axis; k may be 0.
    """

    lower: Floats
    upper: Floats
    A: Floats
    b: Floats

    @property
    def n(self) -> int:
        return len(self.lower)

    @property
    def is_empty(self) -> bool:
        """Whether no state lies inside."""
        if np.any(self.lower > self.upper + ROUND_OFF):
            return True
        return bool(len(self.b)) and not len(self.extremes(np.zeros((1, self.n))))

    def intersect(self, region: Region, lowest: Floats, highest: Floats) -> Polytope:
        """The states of this set from which some input in bounds lies in each half-space of a region of (x, u).

        Args:
            lowest, highest: (m,) inputs [rad or m].
        """
        lower, upper = self.lower.copy(), self.upper.copy()
        rows, offsets = list(self.A), list(self.b)
        for half_space in region.half_spaces:
            a = np.array(half_space.a)
            b = np.array(half_space.b)
            c = half_space.c - float(np.maximum(b * lowest, b * highest).sum())
            support = np.flatnonzero(a)
            if len(support) == 0:
                if c > ROUND_OFF:
                    upper = np.full_like(upper, -np.inf)
            elif len(support) == 1:
                i = int(support[0])
                if a[i] > 0:
                    lower[i] = max(lower[i], c / a[i])
                else:
                    upper[i] = min(upper[i], c / a[i])
            else:
                rows.append(a)
                offsets.append(c)
        touching = (lower > upper) & (lower <= upper + ROUND_OFF)
        lower[touching] = upper[touching]
        return Polytope(lower, upper, np.array(rows).reshape(-1, self.n), np.array(offsets, dtype=float))

    def fix(self, coordinate: int, value: float) -> Polytope:
        """This set with one coordinate fixed at a value, regardless of its range."""
        is_it = np.arange(self.n) == coordinate
        return replace(self, lower=np.where(is_it, value, self.lower), upper=np.where(is_it, value, self.upper))

    def clip(self, coordinate: int, low: float, high: float) -> Polytope:
        """This set with one coordinate limited to [low, high]."""
        low, high = max(self.lower[coordinate], low), min(self.upper[coordinate], high)
        is_it = np.arange(self.n) == coordinate
        return replace(self, lower=np.where(is_it, low, self.lower), upper=np.where(is_it, high, self.upper))

    def contains(self, points: Floats) -> Booleans:
        """(...,) whether each point (..., n) lies inside, boundary included."""
        inside = np.all((points >= self.lower - ROUND_OFF) & (points <= self.upper + ROUND_OFF), axis=-1)
        return np.asarray(inside & np.all(points @ self.A.T >= self.b - ROUND_OFF, axis=-1))

    def nearest(self, point: Floats) -> Floats:
        """(n,) the state of the set with the smallest sum of absolute differences to a point (n,).

        Raises:
            NoWayError: if the set is empty, as where a filter believes in a mode far from the mode's states.
        """
        clipped = np.clip(point, self.lower, self.upper)
        if not len(self.b) or bool(self.contains(clipped)):
            return np.asarray(clipped)
        n, eye = self.n, np.eye(self.n)
        # Variables (x, t): minimise the sum of t with -t <= x - point <= t.
        rows = np.block([[eye, -eye], [-eye, -eye], [-self.A, np.zeros_like(self.A)]])
        limits = np.concatenate([point, -point, -self.b])
        bounds = [*zip(self.lower, self.upper, strict=True), *[(0.0, None)] * n]
        solution = linprog(np.repeat([0.0, 1.0], n), A_ub=rows, b_ub=limits, bounds=bounds, method="highs")
        if solution.status != 0:
            ways = ("start in a mode that the state is in",)
            raise NoWayError(Reason("mode_empty", "no state of the mode lies within the limits", ways))
        return np.asarray(solution.x[:n])

    def sample(self, rng: np.random.Generator, count: int) -> Floats:
        """(count, n) random states of the non-empty set: uniform in a box, else mixtures of extreme points."""
        if not len(self.b):
            return np.asarray(self.lower + rng.random((count, self.n)) * (self.upper - self.lower))
        directions = rng.normal(size=(4 + 4 * self.n, self.n))
        corners = self.extremes(directions)
        return np.asarray(rng.dirichlet(np.full(len(corners), 0.5), count) @ corners)

    def extremes(self, directions: Floats) -> Floats:
        """(k, n) the states farthest along each direction (k, n); (0, n) if the set is empty.

        One linear programme over all of them side by side: its set-up costs more than its solution.
        """
        count = len(directions)
        rows, limits = kron(eye_array(count), -self.A, format="csr"), np.tile(-self.b, count)
        bounds = np.tile(np.stack([self.lower, self.upper], axis=1), (count, 1))
        solution = linprog(-directions.ravel(), A_ub=rows, b_ub=limits, bounds=bounds, method="highs")
        return np.asarray(solution.x).reshape(count, self.n) if solution.status == 0 else np.zeros((0, self.n))


def open_states(mode: Mode, limits: Limits) -> Polytope:
    """The states of a mode without fixing its pins and ties: its invariant within the limits."""
    states = Polytope(limits.lower, limits.upper, np.zeros((0, len(limits.lower))), np.zeros(0))
    return states.intersect(mode.invariant, -limits.max_step, limits.max_step)


def mode_states(mode: Mode, limits: Limits) -> Polytope:
    """The states of a mode: its invariant, its pins and ties, within the limits of every coordinate."""
    states = open_states(mode, limits)
    for pin in mode.pins:
        states = states.fix(pin.coordinate, pin.value)
    for tie in mode.ties:
        row = np.eye(states.n)[tie.coordinate] - np.array(tie.weights)
        A, b = np.vstack([states.A, row, -row]), np.append(states.b, [tie.offset, -tie.offset])
        states = replace(states, A=A, b=b)
    return states


def nominal_start(problem: Problem, limits: Limits, mode: str) -> Floats:
    """(n,) state of the start's mode closest to the start's mean, which noise may have moved out of range."""
    return mode_states(problem.automaton.mode(mode), limits).nearest(np.array(problem.start.mean, dtype=float))
