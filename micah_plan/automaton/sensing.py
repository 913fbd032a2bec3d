"""Measurement noise, as far as it depends on mode and place.

A mode may measure some coordinates differently (a hand that touches a wall knows its distance), and a sensor may be
good near one place only: the std of a measurement then grows with the distance from a "light".

Source: Platt, Tedrake, Kaelbling and Lozano-Perez, "Belief space planning assuming maximum likelihood observations",
RSS 2010, for the light-dark domain, whose variance ½ (5 - x)² is a light at x = 5 with a growth of √½.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import Floats


@dataclass(frozen=True)
class Light:
    """A place near which sensing is best.

    Attributes:
        at: (coordinate, value) of the place [rad or m]; coordinates that are left out do not count (a line, a plane).
        growth: (n,) std that a measurement of each coordinate gains per unit of distance from there.
    """

    at: tuple[tuple[int, float], ...]
    growth: tuple[float, ...]


@dataclass(frozen=True)
class Sensing:
    """The measurement z = x + v of one mode, v normal with std_i(x)² = std_i² + (growth_i · distance)².

    Attributes:
        std: (n,) at the light, or anywhere without one; infinite: not measured [rad or m].
        growth: (n,) per unit of distance from the light; all 0 without one.
        at: (coordinate, value) of the light.
    """

    std: tuple[float, ...]
    growth: tuple[float, ...]
    at: tuple[tuple[int, float], ...] = ()

    @property
    def is_uniform(self) -> bool:
        """Whether it is the same everywhere in the mode."""
        return not any(self.growth)

    def std_at(self, x: Floats) -> Floats:
        """(..., n) std of a measurement at states x (..., n) [rad or m]."""
        base = np.broadcast_to(np.array(self.std), np.shape(x))
        if self.is_uniform:
            return base
        index = [i for i, _ in self.at]
        away = np.linalg.norm(x[..., index] - np.array([value for _, value in self.at]), axis=-1)
        return np.asarray(np.hypot(base, away[..., None] * np.array(self.growth)))

    def std_over(self, mean: Floats, covariance: Floats) -> Floats:
        """(n,) root mean variance of a measurement at a place with given mean and covariance."""
        index = [i for i, _ in self.at]
        spread = float(np.trace(np.asarray(covariance)[np.ix_(index, index)]))
        return np.asarray(np.hypot(self.std_at(mean), np.sqrt(spread) * np.array(self.growth)))
