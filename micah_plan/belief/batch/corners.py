"""Moments of standard Gaussians in the plane over half-planes and corners, in closed form, many at once.

Sources: Rosenbaum, "Moments of a truncated bivariate normal distribution", JRSS B 1961, written here with Stokes'
theorem; Owen, "Tables for computing bivariate normal probabilities", Annals of Mathematical Statistics 1956.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, owens_t

Floats = NDArray[np.float64]

_TINY = 1e-200


@dataclass(frozen=True, eq=False)
class Moments:
    """Masses (p,), first (p, 2) and second moments (p, 2, 2) of whitened coordinates over regions; not normalised."""

    mass: Floats
    first: Floats
    second: Floats

    @staticmethod
    def empty(count: int) -> Moments:
        """To be filled by `put`."""
        return Moments(np.empty(count), np.empty((count, 2)), np.empty((count, 2, 2)))

    def put(self, chosen: NDArray[np.bool_], values: Moments) -> None:
        """Write the moments of those that a mask (p,) chooses."""
        self.mass[chosen], self.first[chosen], self.second[chosen] = values.mass, values.first, values.second

    def where(self, chosen: NDArray[np.bool_]) -> Moments:
        """Those that a mask (p,) chooses."""
        return Moments(self.mass[chosen], self.first[chosen], self.second[chosen])

    def without(self, *parts: Moments) -> Moments:
        """What is left if parts, which do not overlap, are taken out."""
        return Moments(
            self.mass - sum(part.mass for part in parts),
            self.first - sum(part.first for part in parts),
            self.second - sum(part.second for part in parts),
        )


def whole_plane(count: int) -> Moments:
    """Of everything."""
    return Moments(np.ones(count), np.zeros((count, 2)), np.tile(np.eye(2), (count, 1, 1)))


def half_plane(sign: Floats, offset: Floats) -> Moments:
    """Over sign * ζ0 > offset, with signs +-1 (p,) and offsets (p,); exact also far out."""
    density = np.exp(-0.5 * offset**2) / np.sqrt(2 * np.pi)
    mass = ndtr(-offset)
    second = np.zeros((len(sign), 2, 2))
    second[:, 0, 0], second[:, 1, 1] = mass + offset * density, mass
    return Moments(mass, np.stack([sign * density, np.zeros_like(sign)], axis=1), second)


def corner(sign: Floats, first_offset: Floats, normal: Floats, offset: Floats) -> Moments:
    """Over sign * ζ0 > first_offset and normal @ ζ > offset; masses are exact to 1e-15, absolutely.

    Args:
        sign, first_offset: (p,), signs +-1.
        normal, offset: (p, 2) unit vectors, with a component along ζ1 that is not 0, and (p,).
    """
    # Owen's T wants to know on which side of the origin an edge runs.
    first_offset, offset = (np.where(value == 0.0, -_TINY, value) for value in (first_offset, offset))
    correlation, sine = sign * normal[:, 0], np.abs(normal[:, 1])
    # Along each edge: how far from its foot point the corner is, as seen into the region.
    ahead = (offset - correlation * first_offset) / sine, (first_offset - correlation * offset) / sine
    mass = _corner_mass(first_offset, offset, ahead)
    densities = [np.exp(-0.5 * a**2) / np.sqrt(2 * np.pi) for a in (first_offset, offset)]
    edges = [density * ndtr(-start) for density, start in zip(densities, ahead, strict=True)]
    at_corner = densities[0] * np.exp(-0.5 * ahead[0] ** 2) / np.sqrt(2 * np.pi)
    across, along = normal[:, 0], normal[:, 1]
    first = np.stack([sign * edges[0] + across * edges[1], along * edges[1]], axis=1)
    # The edges' second moments, and what their ends at the corner add.
    straight = [edge * a for edge, a in zip(edges, (first_offset, offset), strict=True)]
    straight = [value - at_corner * correlation / sine for value in straight]
    mixed = at_corner * sign / sine
    second = np.empty((len(sign), 2, 2))
    second[:, 0, 0] = mass + straight[0] + straight[1] * across**2 + 2 * mixed * across
    second[:, 0, 1] = second[:, 1, 0] = straight[1] * across * along + mixed * along
    second[:, 1, 1] = mass + straight[1] * along**2
    return Moments(mass, first, second)


def _corner_mass(first_offset: Floats, offset: Floats, ahead: tuple[Floats, Floats]) -> Floats:
    """Φ2 by Owen's T."""
    h, k = -first_offset, -offset
    with np.errstate(over="ignore"):
        sectors = owens_t(h, -ahead[0] / h) + owens_t(k, -ahead[1] / k)
    opposite = np.where((h < 0) != (k < 0), 0.5, 0.0)
    return np.asarray(np.maximum(0.5 * (ndtr(h) + ndtr(k)) - sectors - opposite, 0.0))
