"""Shares of beliefs during one step: joint Gaussians of the start and end of the remaining step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from micah_plan.arrays import Booleans, Floats, Ints
from micah_plan.belief.gaussian import take_last
from micah_plan.belief.truncation import Margins


@dataclass(frozen=True, eq=False)
class Ends:
    """Gaussians at the end of the step.

    Attributes:
        owner: (p,) number of the belief that each is a share of.
        probability: (p,) of the share.
        mean, factor: (n, p), (n, k, p) at the end, any square roots.
    """

    owner: Ints
    probability: Floats
    mean: Floats
    factor: Floats

    def where(self, chosen: Ints) -> Ends:
        """The ends with these numbers."""
        if chosen.size == self.owner.size:
            return self
        moments = take_last(self.mean, chosen), take_last(self.factor, chosen)
        return Ends(self.owner[chosen], self.probability[chosen], *moments)


@dataclass(frozen=True, eq=False)
class Pieces:
    """p shares of beliefs during a step, all in one mode.

    Attributes:
        owner: (p,) number of the belief that each is a share of.
        probability: (p,) of the share.
        mean, factor: (2, n, p), (2, n, k, p) of start and end of the remaining step.
        u: (m, p) inputs that reach the mode.
        fraction: (p,) expected share of the step that is left.
        displacement: (n, p) nominal motion from start to end, without noise.
        pinned_at: (n, p) where the modes left at the present instant pinned the coordinates; NaN: they did not.
        entered: (q, p) modes that it was in at the present instant; none is entered twice at one instant (no
            chattering).
        taken: (e, p) exits of its mode that lead back to it and were taken at the present instant; none is taken twice.
    """

    owner: Ints
    probability: Floats
    mean: Floats
    factor: Floats
    u: Floats
    fraction: Floats
    displacement: Floats
    pinned_at: Floats
    entered: Booleans
    taken: Booleans

    def where(self, chosen: Ints) -> Pieces:
        """The pieces with these numbers, in ascending order."""
        if chosen.size == self.owner.size:
            return self
        return self.subset(
            chosen, self.probability[chosen], take_last(self.mean, chosen), take_last(self.factor, chosen)
        )

    def subset(self, chosen: Ints, probability: Floats, mean: Floats, factor: Floats) -> Pieces:
        """Shares of the pieces with these numbers, as Gaussians of their own."""
        if chosen.size == self.owner.size:
            return replace(self, probability=probability, mean=mean, factor=factor)
        return Pieces(
            owner=self.owner[chosen],
            probability=probability,
            mean=mean,
            factor=factor,
            u=take_last(self.u, chosen),
            fraction=self.fraction[chosen],
            displacement=take_last(self.displacement, chosen),
            pinned_at=take_last(self.pinned_at, chosen),
            entered=take_last(self.entered, chosen),
            taken=take_last(self.taken, chosen),
        )

    def replaced(self, chosen: Ints, probability: Floats, mean: Floats, factor: Floats) -> Pieces:
        """All pieces, with the Gaussians of some replaced."""
        if chosen.size < self.owner.size:
            whole = self.probability.copy(), self.mean.copy(), self.factor.copy()
            for values, values_of_part in zip(whole, (probability, mean, factor), strict=True):
                values[..., chosen] = values_of_part
            probability, mean, factor = whole
        return replace(self, probability=probability, mean=mean, factor=factor)

    def ends(self) -> Ends:
        """The ends of the pieces if no further guard is met."""
        return Ends(self.owner, self.probability, self.mean[1], self.factor[1])


def joined_pieces(groups: Sequence[Pieces]) -> Pieces:
    """The concatenated pieces of several groups in one mode."""
    if len(groups) == 1:
        return groups[0]
    parts = {name: [getattr(group, name) for group in groups] for name in vars(groups[0])}
    factor = side_by_side(parts.pop("factor"))
    return Pieces(factor=factor, **{name: np.concatenate(arrays, axis=-1) for name, arrays in parts.items()})


def side_by_side(factors: Sequence[Floats]) -> Floats:
    """(..., k, p) several factors (..., k', p') concatenated, padded with zero columns."""
    if len(factors) == 1:
        return factors[0]
    widest, count = max(factor.shape[-2] for factor in factors), sum(factor.shape[-1] for factor in factors)
    whole, first = np.zeros((*factors[0].shape[:-2], widest, count)), 0
    for factor in factors:
        whole[..., : factor.shape[-2], first : first + factor.shape[-1]] = factor
        first += factor.shape[-1]
    return whole


@dataclass(frozen=True, eq=False)
class Binding:
    """Binding half-space of a guard per piece.

    Attributes:
        terms: (coordinate, weight or weights (p,)) of its margin.
        offset: (p,) threshold of their sum, or (1,).
        number: (p,) which one of the guard's it is; None: the only one.
    """

    terms: tuple[tuple[int, Floats | float], ...]
    offset: Floats
    number: Ints | None = None

    def where(self, chosen: Ints) -> Binding:
        """The half-spaces of the pieces with these numbers."""
        offset = self.offset if self.offset.size == 1 else self.offset[chosen]
        if self.number is None:
            return Binding(self.terms, offset)
        terms = tuple((i, np.asarray(weights)[chosen]) for i, weights in self.terms)
        return Binding(terms, offset, self.number[chosen])

    def along(self, rows: Floats) -> Floats:
        """(..., p) the weighted sum of rows (n, ..., p)."""
        (i, weight), *others = self.terms
        product = weight * rows[i]
        for i, weight in others:
            product += weight * rows[i]
        return np.asarray(product)

    def margins(self, mean: Floats, factor: Floats) -> Margins:
        """Margins of joint states (2, n, p), (2, n, k, p)."""
        return Margins(self.along(mean.swapaxes(0, 1)) - self.offset, self.along(factor.swapaxes(0, 1)))
