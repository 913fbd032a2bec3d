"""Names of the constraint rows of a transcription, and what a violated row means in words."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

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
    """

    mode: str
    knot: int
    name: str
    unit: str
    lower: float
    upper: float

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
        return f"{self.name} is missed by {self.violation(value):.3g} {self.unit}".rstrip() + f" {place}"


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
        violations = [row.violation(float(value)) for row, value in zip(self.rows, g, strict=True)]
        largest = max((v for v in violations if np.isfinite(v)), default=0.0)
        visible = max(NEGLIGIBLE, _VISIBLE_SHARE * largest)
        sentences: dict[tuple[str, str], str] = {}
        for i in sorted(range(len(violations)), key=lambda i: -violations[i]):
            if violations[i] <= visible or len(sentences) >= count:
                break
            sentences.setdefault((self.rows[i].mode, self.rows[i].name), self.rows[i].sentence(float(g[i])))
        return list(sentences.values())
