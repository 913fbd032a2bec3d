"""The Bayes filter of one hybrid state on a grid: p(q, c | z_1:t, u_1:t) without a Gaussian and without a sample.

Source: Thrun, Burgard and Fox, "Probabilistic Robotics", 2005, ch. 4.1 (histogram filter), with the mode q as part of
the state, as Jain and Niekum (CoRL 2018) have it:

    predict  p⁻(q', c') = Σ_q ∫∫ p(c', q' | q, c, u, w) N(w; 0, Q) p(q, c) dw dc
    update   p(q, c) ∝ N(z; c, R) p⁻(q, c)

One coordinate c [rad or m], one command u. p(c', q' | ...) is the hybrid step, which is certain once the disturbance w
is; the integral over w is a sum over quantiles. A mode that pins its coordinate has all its mass at the pin, spread by
what the pin leaves open.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from reference.hybrid_step import step
from scipy.stats import norm

from micah_plan.automaton.hybrid import HybridAutomaton

Floats = NDArray[np.float64]
# Disturbances that stand for equal shares of their distribution.
_SHARES = 15


class GridFilter:
    """A belief over the modes and one coordinate of an automaton.

    Attributes:
        cells: (k,) middles of the grid's cells [rad or m].
        mass: (modes, k) probability of each mode and cell.
    """

    def __init__(
        self, automaton: HybridAutomaton, mode: str, mean: float, std: float, reach: tuple[float, float], cells: int
    ) -> None:
        """A Gaussian in one mode, as far as the mode's invariant holds there."""
        self.automaton, self.names = automaton, [mode.name for mode in automaton.modes]
        self.cells = np.linspace(*reach, cells)
        self.mass = np.zeros((len(self.names), cells))
        holds = [automaton.mode(mode).invariant.contains(np.array([c]), np.zeros(automaton.m)) for c in self.cells]
        self.mass[self.names.index(mode)] = norm.pdf(self.cells, mean, std) * holds
        self.mass /= self.mass.sum()

    def predict(self, u: float) -> None:
        """Move every cell with every disturbance, and put its mass where that ends."""
        after = np.zeros_like(self.mass)
        quantiles = norm.ppf((np.arange(_SHARES) + 0.5) / _SHARES)
        quantiles /= np.sqrt(np.mean(quantiles**2))  # quantiles alone are a little too narrow
        for number, name in enumerate(self.names):
            pins = self.automaton.mode(name).pins
            for k in np.flatnonzero(self.mass[number] > 1e-9):
                # The step begins at the pin itself: by how much the part is beside it goes on with it.
                beside = self.cells[k] - pins[0].value if pins else 0.0
                for w in quantiles * self.automaton.noise.process_std[0]:
                    there = step(self.automaton, name, [self.cells[k]], [u], [w])
                    self._put(after, there.mode, float(there.x[0]) + beside, self.mass[number, k] / _SHARES)
        self.mass = after

    def update(self, z: float) -> None:
        """Weigh every cell by how likely it makes a measurement [rad or m]."""
        r = self.automaton.noise.observation_std[0]
        self.mass *= norm.pdf(z, self.cells, r)
        self.mass /= self.mass.sum()

    def _put(self, mass: Floats, mode: str, c: float, weight: float) -> None:
        """Add mass at c: to the two cells beside it; where the mode pins it, over the cells about the pin."""
        row = mass[self.names.index(mode)]
        pins = self.automaton.mode(mode).pins
        if pins and pins[0].std > 0:
            about = norm.pdf(self.cells, pins[0].value, pins[0].std)
            row += weight * about / about.sum()
            return
        k = min(max(int(np.searchsorted(self.cells, c)) - 1, 0), len(self.cells) - 2)
        share = min(max((c - self.cells[k]) / (self.cells[k + 1] - self.cells[k]), 0.0), 1.0)
        row[k] += weight * (1.0 - share)
        row[k + 1] += weight * share

    @property
    def weights(self) -> Floats:
        """(modes,) probability of each mode."""
        return np.asarray(self.mass.sum(axis=1))

    def moments(self, mode: str) -> tuple[float, float]:
        """Mean and std of the coordinate, given the mode [rad or m]."""
        row = self.mass[self.names.index(mode)]
        mean = float(row @ self.cells / row.sum())
        return mean, float(np.sqrt(row @ (self.cells - mean) ** 2 / row.sum()))
