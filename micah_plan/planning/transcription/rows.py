"""Names of the constraint rows of a transcription, and what a violated row means in words."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.region import HalfSpace
from micah_plan.quantities import quantity

Floats = NDArray[np.float64]
Kind = Literal["dynamics", "input", "boundary", "guard", "goal"]

# Violations below this are the solver's own tolerance, not a message [in the unit of the row].
NEGLIGIBLE = 1e-5
# Rows violated by less than this share of the worst only distract.
_VISIBLE_SHARE = 0.01


@dataclass(frozen=True)
class Row:
    """One constraint ``lower <= g <= upper``.

    Attributes:
        mode: the mode of the phase that it belongs to.
        knot: knot of the whole plan, from 0.
        name: what must hold, e.g. ``"guard 'door >= 1.2' at 95 %"``.
        unit: of g; empty if none applies.
        lower, upper: bounds; infinite if open.
        kind: what kind of thing it bounds.
        half_space, sign: what is kept (+1) or kept out of (-1), for boundaries and guards.
        spread: variance across it that adds to the belief's, where it is to hold at k-sigma; None elsewhere.
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
    spread: float | None = None

    def violation(self, value: float) -> float:
        """How far a value lies outside the bounds [unit of the row]; NaN counts as infinitely far."""
        if np.isnan(value):
            return float("inf")
        return max(0.0, self.lower - value, value - self.upper)

    def sentence(self, value: float) -> str:
        """What is wrong at this value of g."""
        place = f"at knot {self.knot} in mode '{self.mode}'"
        if np.isnan(value):
            return f"{self.name} is not a number {place}"
        return f"{self.name} is missed by {quantity(self.violation(value), self.unit)} {place}"


@dataclass
class RowNames:
    """The rows of a transcription in the order of its constraint vector g."""

    rows: list[Row] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def lower(self) -> Floats:
        return np.array([row.lower for row in self.rows])

    @property
    def upper(self) -> Floats:
        return np.array([row.upper for row in self.rows])

    def largest_violation(self, g: Floats) -> float:
        """The largest violation over all rows at g (rows,)."""
        return max((row.violation(float(value)) for row, value in zip(self.rows, g, strict=True)), default=0.0)

    def worst(self, g: Floats, count: int = 3) -> list[str]:
        """Sentences for the worst violated rows, one per name and mode, worst first."""
        return [self.rows[i].sentence(float(g[i])) for i in self.worst_indices(g, count)]

    def worst_indices(self, g: Floats, count: int = 3) -> list[int]:
        """The numbers of those rows."""
        violations = [row.violation(float(value)) for row, value in zip(self.rows, g, strict=True)]
        largest = max((v for v in violations if np.isfinite(v)), default=0.0)
        visible = max(NEGLIGIBLE, _VISIBLE_SHARE * largest)
        found: dict[tuple[str, str], int] = {}
        for i in sorted(range(len(violations)), key=lambda i: -violations[i]):
            if violations[i] <= visible or len(found) >= count:
                break
            found.setdefault((self.rows[i].mode, self.rows[i].name), i)
        return list(found.values())


@dataclass(frozen=True)
class Shortfall:
    """A row that does not hold, and why.

    Attributes:
        row: which.
        amount: by how much [unit of the row].
        std: of the true margin, where the row is to hold at k-sigma; None elsewhere [unit of the row].
        width: between this boundary and one that faces it at the same knot, if there is one [unit of the row].
    """

    row: Row
    amount: float
    std: float | None = None
    width: float | None = None

    @property
    def sentence(self) -> str:
        """What is wrong, as `Row.sentence` says it."""
        value = self.row.lower - self.amount if np.isfinite(self.row.lower) else self.row.upper + self.amount
        return self.row.sentence(value)
