"""Named constraints of a transcription: their bounds and places, and the most violated ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.region import HalfSpace
from micah_plan.quantities import percent

Kind = Literal["dynamics", "input", "boundary", "guard", "goal", "path"]

# Violations below this are the solver's own tolerance, not a message [in the unit of the row].
NEGLIGIBLE = 1e-5
# Rows violated by less than this share of the worst only distract.
_VISIBLE_SHARE = 0.01


class Row(NamedTuple):
    """One constraint ``lower <= g <= upper``.

    Attributes:
        mode: the mode of the phase that it belongs to.
        knot: knot of the whole plan, from 0.
        name: of the constraint, e.g. ``"'door <= 1.2'"``.
        unit: of g; empty if none applies.
        lower, upper: bounds; infinite if open.
        kind: of the bounded quantity.
        half_space, sign: the boundary, to stay inside of (+1) or outside of (-1), for boundaries and guards.
        confidence: with which it is to hold; None: for the mean only.
        coordinate: of the goal's target.
    """

    mode: str
    knot: int
    name: str
    unit: str
    lower: float
    upper: float
    kind: Kind = "dynamics"
    half_space: HalfSpace | None = None
    sign: float = 1.0
    confidence: float | None = None
    coordinate: int | None = None

    @property
    def label(self) -> str:
        """The name with the confidence, e.g. ``"'door <= 1.2' at 95 %"``."""
        return self.name if self.confidence is None else f"{self.name} at {percent(self.confidence)}"

    def violation(self, value: float) -> float:
        """How far a value lies outside the bounds [unit of the row]; NaN counts as infinitely far."""
        if np.isnan(value):
            return float("inf")
        return max(0.0, self.lower - value, value - self.upper)


def boundary_name(half_space: HalfSpace, sign: float) -> str:
    """The name of the constraint to stay inside a boundary (+1) or outside (-1)."""
    return f"'{half_space.name}'" if sign > 0 else f"staying out of '{half_space.name}'"


def unit_of(automaton: HybridAutomaton, half_space: HalfSpace) -> str:
    """The common unit of a half-space's coordinates and inputs; empty if they differ."""
    weights = zip((*automaton.coordinates, *automaton.inputs), (*half_space.a, *half_space.b), strict=True)
    units = {item.unit for item, weight in weights if weight}
    return units.pop() if len(units) == 1 else ""


class ConstraintRows(list[Row]):
    """The rows of a transcription, in the order of its constraint vector g."""

    @property
    def lower(self) -> Floats:
        """(r,) lower bounds."""
        return np.array([row.lower for row in self])

    @property
    def upper(self) -> Floats:
        """(r,) upper bounds."""
        return np.array([row.upper for row in self])

    def worst(self, g: Floats, count: int = 3) -> list[int]:
        """Indices of the most violated rows at g (r,), one per constraint and mode, worst first."""
        violations = [row.violation(float(value)) for row, value in zip(self, g, strict=True)]
        largest = max((v for v in violations if np.isfinite(v)), default=0.0)
        visible = max(NEGLIGIBLE, _VISIBLE_SHARE * largest)
        counts: dict[tuple[str, str], int] = {}
        for i in sorted(range(len(violations)), key=lambda i: -violations[i]):
            if violations[i] <= visible or len(counts) >= count:
                break
            counts.setdefault((self[i].mode, self[i].label), i)
        return list(counts.values())


@dataclass(frozen=True)
class Shortfall:
    """A violated row with its circumstances.

    Attributes:
        row: which.
        amount: of the violation [unit of the row]; infinite if it is not a number.
        std: of the true margin, where the row must hold with a confidence; None elsewhere [unit of the row].
        width: between this boundary and one that faces it at the same knot, if there is one [unit of the row].
    """

    row: Row
    amount: float
    std: float | None = None
    width: float | None = None
