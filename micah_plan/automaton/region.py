"""Half-spaces on (x, u) and their intersections: the one set type for guards, invariants and admissible inputs."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from micah_plan.arrays import Booleans, Floats
from micah_plan.errors import InputError

# What is left out, in the names of half-spaces; those with "=" first, as the others are parts of them.
_OPPOSITES = ((">=", "<"), ("<=", ">"), (">", "<="), ("<", ">="))

Interval = tuple[float, float]
"""Lower and upper end."""
UNLIMITED: Interval = (-math.inf, math.inf)


class Bound(NamedTuple):
    """A limit on a single coordinate.

    Attributes:
        coordinate: its number.
        value: of the limit, in the coordinate's unit.
        is_lower: whether it is a lower bound.
    """

    coordinate: int
    value: float
    is_lower: bool


@dataclass(frozen=True)
class HalfSpace:
    """The half-space ``{(x, u): a'x + b'u >= c}``, or ``> c`` if strict.

    Attributes:
        a: (n,) weights of the continuous state.
        b: (m,) weights of the input.
        c: threshold, in the unit of the left-hand side.
        strict: whether the boundary itself is excluded.
        name: how messages and constraint rows call it, e.g. ``"door >= 1.2"``; a label that sets compare without.
    """

    a: tuple[float, ...]
    b: tuple[float, ...]
    c: float
    strict: bool = False
    name: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (*self.a, *self.b, self.c))):
            raise InputError(f"half-space '{self.name}': all coefficients must be finite. Got {self}")

    @cached_property
    def on_state(self) -> bool:
        """Whether it depends on the continuous state."""
        return any(self.a)

    @cached_property
    def on_input(self) -> bool:
        """Whether it depends on the input."""
        return any(self.b)

    @cached_property
    def bound(self) -> Bound | None:
        """The limit on the only coordinate involved; None for several coordinates or inputs."""
        along = [i for i, weight in enumerate(self.a) if weight]
        if len(along) != 1 or self.on_input:
            return None
        weight = self.a[along[0]]
        return Bound(along[0], self.c / weight, weight > 0)

    @cached_property
    def opposite(self) -> HalfSpace:
        """The complementary half-space."""
        a, b = (tuple(-weight for weight in weights) for weights in (self.a, self.b))
        name = next((self.name.replace(old, new) for old, new in _OPPOSITES if old in self.name), f"not {self.name}")
        return HalfSpace(a, b, -self.c, not self.strict, name)

    def moved(self, by: float) -> HalfSpace:
        """The half-space with its threshold increased by `by`."""
        return replace(self, c=self.c + by)

    def faces(self, half_space: HalfSpace) -> bool:
        """Whether both are on the state alone with exactly opposite normals."""
        if self.on_input or half_space.on_input or not self.on_state or not half_space.on_state:
            return False
        return all(abs(x + y) <= 1e-9 for x, y in zip(self._normal, half_space._normal, strict=True))

    def excludes(self, half_space: HalfSpace) -> bool:
        """Whether the two face each other and share at most their boundary."""
        if not self.faces(half_space):
            return False
        return -half_space.offset <= self.offset + 1e-9

    def margin(self, x: Floats, u: Floats) -> Floats:
        """a'x + b'u - c for x (..., n) and u (..., m); positive inside."""
        a, b = self._weights
        return np.asarray(x @ a + u @ b - self.c)

    @cached_property
    def _size(self) -> float:
        """Length of the weights of the state."""
        return float(np.linalg.norm(self.a))

    @cached_property
    def _normal(self) -> tuple[float, ...]:
        """(n,) weights of the state, of length 1."""
        return tuple((np.array(self.a) / self._size).tolist())

    @cached_property
    def direction(self) -> tuple[float, ...]:
        """(n,) weights of the state, of length 1 and to nine digits: equal for boundaries that are parallel."""
        return tuple((np.round(self._normal, 9) + 0.0).tolist())

    @cached_property
    def offset(self) -> float:
        """How far the boundary is from the origin, along `direction`."""
        return self.c / self._size

    @cached_property
    def _weights(self) -> tuple[Floats, Floats]:
        """Weights (n,) of x and (m,) of u."""
        return np.array(self.a), np.array(self.b)


@dataclass(frozen=True)
class Region:
    """An intersection of half-spaces. Without any it is the whole space."""

    half_spaces: tuple[HalfSpace, ...] = ()

    @cached_property
    def _arrays(self) -> tuple[Floats, Floats, Floats, Booleans]:
        """Weights (r, n), (r, m), thresholds (r,) and strictness (r,) of its half-spaces."""
        rows = self.half_spaces
        return (
            np.array([h.a for h in rows]),
            np.array([h.b for h in rows]),
            np.array([h.c for h in rows]),
            np.array([h.strict for h in rows], dtype=bool),
        )

    @property
    def name(self) -> str:
        """The label before the colon in the name of the first half-space, e.g. ``lid at shelf: from above``."""
        return self.half_spaces[0].name.partition(":")[0] if self.half_spaces else ""

    @property
    def is_everything(self) -> bool:
        return not self.half_spaces

    @cached_property
    def on_state(self) -> bool:
        """Whether any of its half-spaces depends on the continuous state."""
        return any(h.on_state for h in self.half_spaces)

    @cached_property
    def on_input(self) -> bool:
        """Whether any of its half-spaces depends on the input."""
        return any(h.on_input for h in self.half_spaces)

    def interval(self, coordinate: int) -> Interval:
        """(low, high) of a coordinate under the half-spaces on it alone; infinite where there are none."""
        return self._intervals.get(coordinate, UNLIMITED)

    @cached_property
    def _intervals(self) -> dict[int, Interval]:
        """Intervals of coordinates that have half-spaces on them alone."""
        found = dict[int, Interval]()
        for bound in (half_space.bound for half_space in self.half_spaces):
            if bound is not None:
                low, high = found.get(bound.coordinate, UNLIMITED)
                at = bound.value
                found[bound.coordinate] = (max(low, at), high) if bound.is_lower else (low, min(high, at))
        return found

    @cached_property
    def tightest(self) -> dict[tuple[int, bool], tuple[float, bool]] | None:
        """Tightest (limit, is strict) by (variable, is lower), upper limits negated; None if variables are coupled."""
        found = dict[tuple[int, bool], tuple[float, bool]]()
        for half_space in self.half_spaces:
            weights = [(i, weight) for i, weight in enumerate((*half_space.a, *half_space.b)) if weight]
            if len(weights) > 1:
                return None
            # Without a weight it states that 0 is at least its constant, or more.
            index, weight = weights[0] if weights else (-1, 1.0)
            if not weights:
                found[index, False] = (0.0, False)
            limit = half_space.c / abs(weight), half_space.strict
            found[index, weight > 0] = max(found.get((index, weight > 0), limit), limit)
        return found

    def margins(self, x: Floats, u: Floats) -> Floats:
        """(..., k) margins of the k half-spaces at x (..., n), u (..., m); positive inside."""
        if self.is_everything:
            return np.zeros((*np.shape(x)[:-1], 0))
        a, b, c, _ = self._arrays
        return np.asarray(x @ a.T + u @ b.T - c)

    def contains(self, x: Floats, u: Floats, tolerance: float = 0.0) -> Booleans:
        """(...) whether (x, u) lies inside; a positive tolerance enlarges the region."""
        if self.is_everything:
            return np.ones(np.shape(x)[:-1], dtype=bool)
        margins = self.margins(x, u)
        strict = self._arrays[3]
        inside = np.where(strict, margins > -tolerance, margins >= -tolerance)
        return np.asarray(inside.all(axis=-1))

    def mapped(self, change: Callable[[HalfSpace], HalfSpace]) -> Region:
        """The region with a function applied to each half-space; the same object if nothing changes."""
        rows = tuple(map(change, self.half_spaces))
        return self if all(map(operator.is_, rows, self.half_spaces)) else Region(rows)

    def intersection(self, region: Region) -> Region:
        return Region(self.half_spaces + tuple(h for h in region.half_spaces if h not in self.half_spaces))


def above(index: int, threshold: float, n: int, m: int, *, strict: bool = False, name: str = "x") -> HalfSpace:
    """``x[index] >= threshold`` (or >) in a space of n states and m inputs."""
    return HalfSpace(_unit(index, n), (0.0,) * m, threshold, strict, f"{name} {'>' if strict else '>='} {threshold:g}")


def below(index: int, threshold: float, n: int, m: int, *, strict: bool = False, name: str = "x") -> HalfSpace:
    """``x[index] <= threshold`` (or <)."""
    a = tuple(-w for w in _unit(index, n))
    return HalfSpace(a, (0.0,) * m, -threshold, strict, f"{name} {'<' if strict else '<='} {threshold:g}")


def input_above(index: int, threshold: float, n: int, m: int, *, strict: bool = False, name: str = "u") -> HalfSpace:
    """``u[index] >= threshold`` (or >)."""
    text = f"{name} {'>' if strict else '>='} {threshold:g}"
    return HalfSpace((0.0,) * n, _unit(index, m), threshold, strict, text)


def input_below(index: int, threshold: float, n: int, m: int, *, strict: bool = False, name: str = "u") -> HalfSpace:
    """``u[index] <= threshold`` (or <)."""
    b = tuple(-w for w in _unit(index, m))
    text = f"{name} {'<' if strict else '<='} {threshold:g}"
    return HalfSpace((0.0,) * n, b, -threshold, strict, text)


def box(lower: Sequence[float], upper: Sequence[float], m: int, names: Sequence[str]) -> Region:
    """The states between two corners; infinite bounds are left out."""
    n = len(lower)
    rows = [above(i, lo, n, m, name=names[i]) for i, lo in enumerate(lower) if np.isfinite(lo)]
    rows += [below(i, hi, n, m, name=names[i]) for i, hi in enumerate(upper) if np.isfinite(hi)]
    return Region(tuple(rows))


def input_box(lower: Sequence[float], upper: Sequence[float], n: int, names: Sequence[str]) -> Region:
    """The inputs between two corners; infinite bounds are left out."""
    m = len(lower)
    rows = [input_above(i, lo, n, m, name=f"input {names[i]}") for i, lo in enumerate(lower) if np.isfinite(lo)]
    rows += [input_below(i, hi, n, m, name=f"input {names[i]}") for i, hi in enumerate(upper) if np.isfinite(hi)]
    return Region(tuple(rows))


def _unit(index: int, size: int) -> tuple[float, ...]:
    return tuple(1.0 if i == index else 0.0 for i in range(size))
