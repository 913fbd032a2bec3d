"""Moment matching: the shares of a belief in one mode merged into a Gaussian.

Source: Blom and Bar-Shalom, "The interacting multiple model algorithm", IEEE Transactions on Automatic Control 1988.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from micah_plan.arrays import Floats, Ints
from micah_plan.belief.gaussian import (
    assign_last,
    lower_factors,
    take_last,
)
from micah_plan.belief.hybrid_belief import BeliefBatch
from micah_plan.belief.layout import Layout
from micah_plan.belief.pieces import Ends, side_by_side


def merged_moments(weights: Floats, means: Sequence[Floats], factors: Sequence[Floats]) -> tuple[Floats, Floats]:
    """Means (n, o) and lower factors (n, n, o) of o mixtures of r Gaussians each (moment matching).

    Args:
        weights: (r, o), of sum 1 over r.
        means, factors: r of (n, o) and (n, k, o).
    """
    center = sum((weight * mean for weight, mean in zip(weights, means, strict=True)), start=np.zeros_like(means[0]))
    roots, (n, k, count) = np.sqrt(weights), factors[0].shape
    columns = np.empty((n, len(weights) * (k + 1), count))
    for number, (root, mean, factor) in enumerate(zip(roots, means, factors, strict=True)):
        np.multiply(factor, root, out=columns[:, number * (k + 1) : (number + 1) * (k + 1) - 1])
        np.multiply(mean - center, root, out=columns[:, (number + 1) * (k + 1) - 1])
    return center, lower_factors(columns, overwrite=True)


def merged_by_mode(
    layout: Layout, arrived: Sequence[tuple[int, Ends]], count: int, remembered: Floats | None
) -> BeliefBatch:
    """One Gaussian per mode and belief from its pieces, by moment matching.

    Args:
        arrived: with the numbers of their modes.
        remembered: (n, t) known values of the memories of inputs; None: there are none.
    """
    q, n = len(layout.modes), layout.n
    weights, means, factors = np.zeros(q * count), np.zeros((n, q * count)), np.zeros((n, n, q * count))
    numbers = [index * count + ends.owner for index, ends in arrived]
    pieces = np.bincount(np.concatenate(numbers), minlength=q * count)
    alone = [(pieces[number] == 1).nonzero()[0] for number in numbers]
    single, at = _selected_columns(arrived, numbers, alone)
    if at.size:
        assign_last(weights, at, single.probability)
        assign_last(means, at, single.mean)
        assign_last(factors, at, lower_factors(single.factor))
    merged = (pieces > 1).nonzero()[0]
    if merged.size:
        others = [(pieces[number] > 1).nonzero()[0] for number in numbers]
        several, at = _selected_columns(arrived, numbers, others)
        weights[merged], means[:, merged], factors[..., merged] = _merged_by_number(several, at, pieces[merged])
    if remembered is not None:
        for of_input in layout.automaton.input_memories:
            memory = slice(of_input.first, of_input.first + of_input.size)
            means.reshape(n, q, count)[memory] = remembered[memory, None]
    shares = weights.reshape(q, count)
    return BeliefBatch.of(shares / shares.sum(axis=0), means, factors, layout.own)


def _selected_columns(
    arrived: Sequence[tuple[int, Ends]], numbers: Sequence[Ints], chosen: Sequence[Ints]
) -> tuple[Ends, Ints]:
    """(selected entries of all groups, their numbers (p,))."""
    groups = [
        ends.where(chosen_ends) for (_, ends), chosen_ends in zip(arrived, chosen, strict=True) if chosen_ends.size
    ]
    at = [number[chosen_ends] for number, chosen_ends in zip(numbers, chosen, strict=True) if chosen_ends.size]
    if len(groups) <= 1:
        return (groups[0], at[0]) if groups else (arrived[0][1], np.zeros(0, dtype=np.int64))
    owner, probability, mean = (
        np.concatenate([getattr(group, name) for group in groups], axis=-1) for name in ("owner", "probability", "mean")
    )
    return Ends(owner, probability, mean, side_by_side([group.factor for group in groups])), np.concatenate(at)


def _merged_by_number(ends: Ends, number: Ints, counts: Ints) -> tuple[Floats, Floats, Floats]:
    """Weights (o,), means (n, o) and factors (n, n, o) of pieces merged by number (p,), in ascending order.

    Args:
        counts: (o,) of the pieces with each number.
    """
    order, first = np.argsort(number, kind="stable"), np.cumsum(counts) - counts
    n, size = len(ends.mean), counts.size
    weights, means, factors = np.empty(size), np.empty((n, size)), np.empty((n, n, size))
    fewer = 1
    for most in (2, 4, int(counts.max())):
        at = ((counts > fewer) & (counts <= most)).nonzero()[0]
        if at.size:
            # Piece r of each number side by side; those that have fewer repeat their last, without weight.
            ranks = np.arange(most)[:, None]
            places = order[first[at] + np.minimum(ranks, counts[at] - 1)]
            shares = np.where(ranks < counts[at], ends.probability[places], 0.0)
            weights[at] = weight = shares.sum(axis=0)
            pieces = ([take_last(values, place) for place in places] for values in (ends.mean, ends.factor))
            means[:, at], factors[..., at] = merged_moments(shares / weight, *pieces)
        fewer = most
    return weights, means, factors
