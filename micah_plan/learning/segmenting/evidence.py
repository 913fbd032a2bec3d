"""Evidence ln L(s, t, M) of all segments, from densities of rows that are shared by all starts.

One generative model serves all kinds: measured pose = joint at its configuration + an error with wander and tails (see
noise.py). Rigid is the joint without motion. A row's density given the rows before it in the same segment depends on
the segment's start only through how many rows there are to predict from, and beyond noise.MEMORY not at all; so the
evidence of a segment is a sum of tabled terms. A revolute joint that rests is no likelier than a rigid one.

A step in which a part is caught by a stop, or released by it, does not follow its action: its poses are a mean of rest
and motion. So the first or last step of a segment may follow its action, or not.

A segment may continue from the row before it, as far as that row lies on its joint as well: a part changes from one
joint to another at a pose that both have.

Source: MICAH, ln L ≈ ln p(y | M, θ̂, a) - k/2 ln(t - s).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.special import digamma

from micah_plan.arrays import Floats, Ints
from micah_plan.learning.segmenting.log_sums import log_add
from micah_plan.learning.segmenting.motion import StepModels, fit_motion
from micah_plan.learning.segmenting.noise import NoiseModel, log_peak, stacked
from micah_plan.learning.segmenting.parameter_costs import held_costs, parameter_costs, parameter_counts
from micah_plan.learning.segmenting.pool import Hypotheses, Pool, all_of, pool_of
from micah_plan.learning.track import PartTrack

_HELD_FIRST = 4.6  # nats: a part that has not moved yet waits for the hand in 99 of 100 demonstrations
_SLIP = 0.01  # probability that a row is uninformative about the next


@dataclass(frozen=True, eq=False)
class EvidenceTable:
    """Log densities of rows under a pool.

    Attributes:
        likelihood_power: power of the likelihood.
        pool, motion: the h hypotheses and how the part moves along them.
        log_density: (p + 1, n, h): of a row, given 0, 1, ... p rows before it.
        ending: (p + 1, n, h): by how much more probable it is as the last one of its segment.
        parameters: (h,) numbers that fix a hypothesis.
        occam: (h,) ln of how much narrower than before the parameters are after the rows they were fitted to.
        held: (h,) the same, given that a moving joint of the pool explains other rows.
        rows: (h,) how many rows they were fitted to.
    """

    likelihood_power: float
    pool: Pool
    motion: StepModels
    log_density: Floats
    ending: Floats
    parameters: Floats
    occam: Floats
    held: Floats
    rows: Floats

    @cached_property
    def sums(self) -> Floats:
        """(h, n, n) log evidence of every segment (first, last row), excluding the cost of its joint's parameters.

        Values of last rows before the first are meaningless.
        """
        return segment_sums(self.log_density, self.ending)

    def charged_sums(self, index: int) -> Floats:
        """(n, n) log evidence of one hypothesis, minus the cost of a joint per segment."""
        n = len(self.sums[index])
        lengths = np.maximum(np.arange(2 * n - 1) - n + 2, 1).astype(float)
        # The cost of a segment depends on its length alone.
        costs = sliding_window_view(self.cost(np.array([index]), lengths), n)[::-1]
        return np.asarray(self.sums[index] - costs)

    @cached_property
    def best(self) -> Floats:
        """(n, n) evidence of the best hypothesis for each segment."""
        return best_of(self.charged_sums(i) for i in range(len(self.rows)))

    def cost(self, index: Ints, rows: Floats, held: bool = True) -> Floats:
        """Cost of a hypothesis' parameters for a segment of a given number of rows [nats]."""
        n = np.maximum(rows, np.maximum(self.parameters[index], 1.0))
        return np.asarray(
            (self.held if held else self.occam)[index] + 0.5 * self.parameters[index] * np.log(n / self.rows[index])
        )


def tabulated(
    hypotheses: Hypotheses,
    track: PartTrack,
    noise: NoiseModel,
    rest: float,
    likelihood_power: float,
    begun: bool = False,
) -> EvidenceTable:
    """The densities of all rows under all hypotheses.

    Args:
        rest: prior probability that a part on a moving joint rests in a step, where actions are uninformative.
        likelihood_power: power of the likelihood (`likelihood_power.likelihood_power_of`).
        begun: whether the part has moved before the first row.
    """
    return all_tabulated([hypotheses], track, [noise], rest, likelihood_power, begun)[0]


def all_tabulated(
    pools: Sequence[Hypotheses],
    track: PartTrack,
    noises: Sequence[NoiseModel],
    rest: float,
    likelihood_power: float,
    begun: bool = False,
) -> list[EvidenceTable]:
    """Evidence tables of several pools, each under its own noise, in one batch."""
    together, counts = all_of(pools), [len(pool) for pool in pools]
    noise = stacked(noises, counts) if len(pools) > 1 else noises[0]
    pool = pool_of(together, track, noise)
    table, scale, off_joint = _transverse_densities(pool, noise)
    motion = fit_motion(pool, track.action, rest, scale, likelihood_power, begun)
    unled = table + motion.unled
    # Where on its joint a segment starts is uniform over what the recording reaches.
    table[1:] += motion.log_density
    table[0] -= (np.log(np.maximum(np.ptp(pool.seen.configuration, axis=1), 1e-9)) * pool.moving)[:, None]
    led_or_not = log_add(table, unled) + np.log(0.5)
    # A tracker may slip: then the row is as unforeseen as the first of a segment.
    slipped = np.log(_SLIP) + table[0]
    for densities in (table, led_or_not):
        densities[1:] = log_add(np.log1p(-_SLIP) + densities[1:], slipped)
    ending = likelihood_power * (led_or_not - table)
    # A segment of one row begins and ends within it, which is asked once; the last row of all leaves its segment open.
    ending[0] = ending[..., -1] = 0.0
    # A segment may go on where the row before it was, or not.
    going_on = table[1:, :, 1:].copy()
    going_on[:1] = led_or_not[1:2, :, 1:]
    for k, density in enumerate(going_on):  # of a row with k rows of its segment before it
        density[:, k:] += off_joint[:, : density.shape[1] - k]
    table[:-1, :, 1:] = log_add(table[:-1, :, 1:], going_on) + np.log(0.5)
    table *= likelihood_power
    if not begun:
        table[0, ~pool.moving, 0] -= _HELD_FIRST
    rows = np.maximum(together.used.sum(axis=1), 1).astype(float)
    of_motion = 0.5 * motion.parameters * np.log(rows)
    parameters = parameter_counts(together.joints, track.quaternion is not None) + motion.parameters
    cost, denied = parameter_costs(pool, track, noise, likelihood_power)
    ends = np.cumsum(counts)
    tables = []
    for pool_of_part, noise_of_part, part in zip(pools, noises, map(slice, ends - counts, ends), strict=True):
        pool_of_one = pool.part(part, pool_of_part)
        held = held_costs(cost[part], denied[part], pool_of_one, noise_of_part, likelihood_power) + of_motion[part]
        density = table[:, part].swapaxes(1, 2), ending[:, part].swapaxes(1, 2)
        numbers = parameters[part], cost[part] + of_motion[part], held, rows[part]
        tables.append(EvidenceTable(likelihood_power, pool_of_one, motion.part(part), *density, *numbers))
    return tables


def _transverse_densities(pool: Pool, noise: NoiseModel) -> tuple[Floats, Floats, Floats]:
    """(p + 1, h, n) log densities across the joints, and (h, n) relative std of each row's noise.

    And (h, n) by how much less likely each row is than a usual row on the joint, alone [nats, at most 0].
    """
    direction = pool.seen.direction
    h, d, n = direction.shape
    heavy = noise.dof[:, None] + d - pool.moving[:, None]
    peak = np.where(pool.moving, log_peak(d - 1, noise.dof), log_peak(d, noise.dof))[:, None]
    scaling = (noise.decorrelation[:, None] / np.sqrt(noise.left)[:, :, None]).swapaxes(0, 1)
    squares = np.empty((len(scaling), h, n))
    for scale_of_order, residual, square in zip(scaling, noise.predicted_back(pool.seen.error), squares, strict=True):
        innovation = scale_of_order @ residual
        np.einsum("hdn,hdn->hn", innovation, innovation, out=square)
    # The direction of motion is not counted here.
    precision = (scaling.swapaxes(2, 3) @ scaling).swapaxes(0, 1).reshape(len(noise), -1, d * d)
    information = precision @ (direction[:, :, None] * direction[:, None]).reshape(h, d * d, n)
    information = np.where(pool.moving[:, None, None], information, 1.0).swapaxes(0, 1)
    volume = np.log(np.diagonal(scaling, axis1=2, axis2=3)).sum(axis=2)[..., None]
    tails = heavy * np.log1p(squares / heavy) + np.log(np.maximum(information, 1e-12))
    # Given how far off a row is across the joint, Student's distribution is as much wider along it.
    wider = 1 + (squares[-1] - (heavy - noise.dof[:, None])) / heavy
    # Of a pose that may be further off than a tracker wanders, as where a stop yields: Cauchy's density.
    cauchy = heavy - noise.dof[:, None] + 1.0
    usual = digamma(0.5 * cauchy) - digamma(0.5)
    off_joint = 0.5 * cauchy * np.minimum(usual - np.log1p(squares[0] / cauchy), 0.0)
    return peak - 0.5 * tails + volume, wider, off_joint


def best_of(layers: Iterable[Floats]) -> Floats:
    """(n, n) the largest of evidences (n, n), one at a time: all at once would take much memory."""
    rest = iter(layers)
    best = next(rest).copy()
    for layer in rest:
        np.maximum(best, layer, out=best)
    return best


def segment_sums(log_density: Floats, ending: Floats) -> Floats:
    """(h, n, n) evidence of rows s to t (s <= t) under every hypothesis, from densities (p + 1, n, h).

    The first p rows of a segment have their own densities; those after them are differences of one running sum. The
    gain in log probability of a row as the last one (p + 1, n, h) is added.
    """
    p, n, h = len(log_density) - 1, log_density.shape[1], log_density.shape[2]
    running = np.zeros((h, n + 1))
    np.cumsum(log_density[p].T, axis=1, out=running[:, 1:])
    # Of the row s + k with k rows known before it; 0 beyond the end.
    begin = np.zeros((p, h, n))
    for k in range(min(p, n)):
        begin[k, :, : n - k] = log_density[k, k:].T
    begin = np.cumsum(begin, axis=0)
    later = running[:, np.minimum(np.arange(n) + p, n)]
    beginning = begin[-1] - later if p else -later
    sums = (running[:, 1:] + ending[p].T)[:, None] + beginning[:, :, None]
    of_lengths = sums.reshape(h, -1)
    for k in range(min(p, n)):
        of_lengths[:, k :: n + 1][:, : n - k] = begin[k, :, : n - k] + ending[k, k:].T
    return np.asarray(sums)
