"""Leaves of a mode: the affine subspaces that its inputs cannot leave.

A mode moves x along the range of its input matrix B. The complement, functionals F x with F B = 0, keeps its value from
when the mode was entered: the place of an object that is not held, or the distance between a hand and the rod that it
carries. The states with one value of F x are a leaf of the mode: only they can be connected in it (a foliation; Siméon,
Laumond, Cortés and Sahbani, IJRR 2004). A mode that moves all its free coordinates is one leaf.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import null_space

from micah_plan.arrays import ROUND_OFF, Booleans, Floats, Ints
from micah_plan.automaton.hybrid import Mode
from micah_plan.planning.limits import Limits
from micah_plan.planning.search.polytope import Polytope, mode_states

# Values of what is kept that differ by less are the same leaf [steps]; a motion may miss its end by ten times that.
_SAME_LEAF = 1e-8
# Draws of as many states as are wanted from the box around a part of a leaf, before it counts as too thin for that.
_MOST_DRAWS = 10


@dataclass(frozen=True, eq=False)
class Leaves:
    """The leaves of a mode over n coordinates, all in steps (x over the limits' speed).

    Attributes:
        mode: which.
        speed: (n,) of the limits.
        along: (n, r) orthonormal: the directions in which inputs move x.
        kept: (k, n) orthonormal functionals F that are constant, without those fixed by pins and ties of the mode.
    """

    mode: Mode
    speed: Floats
    along: Floats
    kept: Floats

    @property
    def are_many(self) -> bool:
        """Whether the mode has more than one leaf."""
        return len(self.kept) > 0

    @property
    def independent(self) -> Booleans:
        """(n,) coordinates that some input moves independently of all others."""
        return np.asarray(np.linalg.norm(self.along, axis=1) > 1.0 - ROUND_OFF)

    def own(self, points: Floats) -> Floats:
        """(k, r) own coordinates on their leaf of states (k, n) [steps]."""
        return np.asarray((points / self.speed) @ self.along)

    def kept_words(self, names: Sequence[str]) -> list[str]:
        """Invariants of the inputs as sums of named coordinates, e.g. ``"hand - rod"``."""
        words = []
        for row in _reduced(self.kept / self.speed):
            weights = row / row[np.flatnonzero(np.abs(row) > ROUND_OFF * np.abs(row).max())[0]]
            parts = [
                f"{'-' if w < 0 else '+'} {name if abs(abs(w) - 1.0) < ROUND_OFF else f'{abs(w):.3g}*{name}'}"
                for w, name in zip(weights, names, strict=True)
                if abs(w) > ROUND_OFF
            ]
            words.append(" ".join(parts).removeprefix("+ "))
        return words

    def numbers(self, points: Floats) -> Ints:
        """(k,) leaf of each state (k, n), counted as they first appear."""
        values = (points / self.speed) @ self.kept.T
        numbers, count, firsts = np.zeros(len(points), dtype=np.int64), 0, np.empty_like(values)
        for row, value in enumerate(values if self.are_many else ()):
            same = np.flatnonzero(np.abs(firsts[:count] - value).max(axis=1, initial=0.0) <= _SAME_LEAF)
            numbers[row] = same[0] if same.size else count
            if not same.size:
                firsts[count], count = value, count + 1
        return numbers

    def projected_on_leaf(self, x: Floats, points: Floats) -> Floats:
        """(k, n) states next to `points` (k, n) on the leaf of x (n,)."""
        return np.asarray(x + self.own(points - x) @ self.along.T * self.speed)

    def sample(self, states: Polytope, x: Floats, rng: np.random.Generator, count: int) -> Floats:
        """(count, n) random states of a (non-empty) part of the leaf of x (n,), even where it fills its box."""
        if not len(states.b):
            return self.projected_on_leaf(x, states.sample(rng, count))
        found, (low, high) = list[Floats](), self._box(states, x)
        for _ in range(_MOST_DRAWS):
            draws = low + rng.random((count, len(low))) * (high - low)
            points = x + draws @ self.along.T * self.speed
            found.extend(points[states.contains(points)])
            if len(found) >= count:
                return np.array(found[:count])
        rest = states.sample(rng, count - len(found))
        return np.vstack([*found, self.projected_on_leaf(x, rest)])

    def _box(self, states: Polytope, x: Floats) -> tuple[Floats, Floats]:
        """(r,) bounds of a leaf's coordinates, relative to x, within a set."""
        axes = self.along.T / self.speed
        ends = self.own(states.extremes(np.vstack([-axes, axes])) - x)
        low, high = np.split(ends, 2)
        return np.diag(low), np.diag(high)

    def states(self, limits: Limits, x: Floats) -> Polytope:
        """The mode's states on the leaf of x (n,)."""
        states = mode_states(self.mode, limits)
        for row in self.kept / self.speed:
            support = np.flatnonzero(np.abs(row) > ROUND_OFF * np.abs(row).max())
            if len(support) == 1:
                states = states.fix(int(support[0]), float(x[support[0]]))
            else:
                value = float(row @ x)
                A, b = np.vstack([states.A, row, -row]), np.append(states.b, [value, -value])
                states = replace(states, A=A, b=b)
        return states


def _reduced(rows: Floats) -> Floats:
    """(k, n) reduced row echelon form of full-rank rows, for short descriptions."""
    rows = rows.copy()
    done: list[int] = []
    for column in range(rows.shape[1]):
        remaining = [i for i in range(len(rows)) if i not in done]
        pivot = max(remaining, key=lambda i: abs(rows[i, column]), default=None)
        if pivot is not None and abs(rows[pivot, column]) > ROUND_OFF * np.abs(rows).max():
            rows[pivot] /= rows[pivot, column]
            others = np.arange(len(rows)) != pivot
            rows[others] -= np.outer(rows[others, column], rows[pivot])
            done.append(pivot)
    return rows


def leaves_of(mode: Mode, limits: Limits) -> Leaves:
    """The leaves of a mode."""
    n, speed = len(limits.speed), limits.speed
    B = mode.B * mode.free[:, None] / speed[:, None]
    driven = np.flatnonzero(np.any(B, axis=1))
    vectors, sizes, _ = np.linalg.svd(B[driven], full_matrices=False)
    rank = int(np.sum(sizes > ROUND_OFF * sizes.max(initial=0.0)))
    along = np.zeros((n, rank))
    # Coordinates that move independently are their own coordinates.
    along[driven] = np.eye(rank) if rank == len(driven) else vectors[:, :rank]
    fixed = [np.eye(n)[pin.coordinate] for pin in mode.pins]
    fixed += [(np.eye(n)[tie.coordinate] - np.array(tie.weights)) * speed for tie in mode.ties]
    idle = np.flatnonzero(
        mode.free & ~np.any(B, axis=1) & ~np.isin(np.arange(n), [tie.coordinate for tie in mode.ties])
    )
    units = np.eye(n)[idle]
    rest = null_space(np.vstack([along.T, np.array(fixed).reshape(-1, n), units]))
    return Leaves(mode, speed, along, np.vstack([units, rest.T]))
