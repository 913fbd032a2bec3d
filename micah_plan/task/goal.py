"""The goal set of a problem: which modes and states count as reached."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import Booleans, Floats
from micah_plan.automaton.contacts.values import COLLIDED


def unharmed(modes: Sequence[str]) -> tuple[str, ...]:
    """The default goal modes: all but the collided one; empty, which means any, where there is none.

    Empty, which means any, for an object that cannot.
    """
    return tuple(mode for mode in modes if mode != COLLIDED) if COLLIDED in modes else ()


@dataclass(frozen=True)
class Goal:
    """The goal set: any subset of the coordinates within a tolerance, and optionally the modes to end in.

    Attributes:
        target: (index, value, tolerance) per constrained coordinate [rad or m].
        modes: names of the modes that count as reached; empty: any.
    """

    target: tuple[tuple[int, float, float], ...]
    modes: tuple[str, ...] = ()

    @property
    def indices(self) -> tuple[int, ...]:
        """Numbers of the coordinates that the goal constrains."""
        return tuple(index for index, _, _ in self.target)

    def admits(self, mode: str) -> bool:
        """Whether a mode of that name counts as reached."""
        return not self.modes or mode in self.modes

    def admitted(self, modes: Sequence[str]) -> Booleans:
        """(q,) whether each of the named modes counts as reached."""
        return np.array([self.admits(mode) for mode in modes], dtype=bool)

    def contains(self, mode: str, x: Floats) -> bool:
        """Whether a mode and state (n,) lie in the goal set."""
        return self.admits(mode) and bool(self.holds(x))

    def holds(self, x: Floats) -> Booleans:
        """(...) whether states (..., n) are within every tolerance, in any mode."""
        return np.asarray(~self.misses(x).any(axis=-1))

    def distances(self, x: Floats) -> Floats:
        """(..., k) how far states (..., n) are from each target [rad or m]."""
        return np.abs(x[..., list(self.indices)] - [value for _, value, _ in self.target])

    def misses(self, x: Floats) -> Booleans:
        """(..., k) whether states (..., n) are further from each target than its tolerance."""
        return np.asarray(self.distances(x) > [tolerance for _, _, tolerance in self.target])

    def reached_from(self, x: Floats) -> Floats:
        """(n,) the state x (n,) with the goal's values substituted."""
        changed = np.array(x)
        for index, value, _ in self.target:
            changed[index] = value
        return changed

    def error(self, x: Floats) -> float:
        """Largest distance of a constrained coordinate of x (n,) from its target [rad or m]; 0 if there is none."""
        return float(self.distances(x).max(initial=0.0))

    def std(self, factor: Floats) -> float:
        """Largest std of a constrained coordinate for a square root (n, K) of the covariance; 0 if there is none."""
        return max((float(np.linalg.norm(factor[index])) for index in self.indices), default=0.0)
