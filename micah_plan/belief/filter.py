"""The hybrid Gaussian filter: one EKF per mode, guards that move probability from mode to mode, moment matching.

It runs over many beliefs at once: a step's time is spent in NumPy calls rather than in arithmetic, and each call serves
all of them. A single belief is a batch of one. All functions are pure and deterministic; none changes the belief it is
given.

Sources: Jain and Niekum, "Efficient hierarchical robot motion planning under uncertainty and hybrid dynamics", CoRL
2018; Blom and Bar-Shalom, "The interacting multiple model algorithm", 1988, for the mixing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import logsumexp, ndtr

from micah_plan.arrays import ROUND_OFF, SMALLEST_STD, Booleans, Floats, Ints
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.input_memory import passed_arrays
from micah_plan.automaton.region import HalfSpace
from micah_plan.belief.crossing import through_guards, whole_step
from micah_plan.belief.gaussian import (
    condition_on_pins,
    lower_factors,
    measured,
    replace_last,
    replaced_at_pins,
    take_last,
)
from micah_plan.belief.hybrid_belief import BeliefBatch, HybridBelief, batch_of
from micah_plan.belief.layout import HalfSpaceRows, Layout, layout_of
from micah_plan.belief.lost_belief import most_evidence, reinitialise
from micah_plan.belief.moment_matching import merged_by_mode, merged_moments
from micah_plan.belief.pieces import Ends, Pieces, joined_pieces
from micah_plan.belief.truncation import (
    NEGLIGIBLE,
    is_cut,
    log_probability,
    onto_boundary,
    truncated,
    uncut,
)
from micah_plan.errors import InputError

Belief = TypeVar("Belief", HybridBelief, BeliefBatch)

# A start whose mean lies in no mode is accepted down to this probability of one (3 sigma), as noise of a measurement.
_LEAST_CHANCE = 1e-3
# Transitions that a share of the belief may take within one step.
MOST_EVENTS = 16
_LOG_NEGLIGIBLE = np.log(NEGLIGIBLE)


def initial_belief(
    automaton: HybridAutomaton, mean: ArrayLike, spread: ArrayLike, mode: str | None = None
) -> HybridBelief:
    """The initial belief in one mode, conditioned on its pins.

    Args:
        mean: (n,) [rad or m].
        spread: (n,) standard deviations or (n, n) covariance.
        mode: where it is; None: the first mode whose invariant holds the mean, or, for a measured start that noise
            put just outside all of them, the one whose invariant most probably holds the state.

    Raises:
        InputError: if shapes do not fit, the covariance is not positive semi-definite, or no invariant holds the mean.
    """
    center, width = np.array(mean, dtype=float), np.array(spread, dtype=float)
    n = automaton.n
    if center.shape != (n,) or width.shape not in ((n,), (n, n)):
        raise InputError(
            f"a start belief needs a mean of shape ({n},) and stds ({n},) or a covariance ({n}, {n}). "
            f"Got {center.shape} and {width.shape}"
        )
    if not np.isfinite(center).all():
        raise InputError(f"the mean of a start belief must be finite. Got {center.tolist()}")
    factor = np.diag(_valid_stds(width)) if width.ndim == 1 else _covariance_root(width)
    name = _mode_at(automaton, center, factor) if mode is None else automaton.mode(mode).name
    layout = layout_of(automaton)
    index = next(mode.index for mode in layout.modes if mode.mode.name == name)
    q, b = len(layout.modes), layout.stds.size
    factor = np.block([[factor, np.zeros((n, b))], [np.zeros((b, n)), np.diag(layout.stds)]])
    center = np.concatenate([center, np.zeros(b)])
    at_pins = condition_on_pins(center[:, None], factor[:, :, None], layout.modes[index].mode.pins)
    weights, means, factors = np.zeros((q, 1)), np.zeros((n + b, q, 1)), np.zeros((n + b, n + b, q, 1))
    weights[index], means[:, index], factors[:, :, index] = 1.0, at_pins[0], lower_factors(at_pins[1])
    return _completed(layout, BeliefBatch.of(weights, means, factors, n)).alone(0)


def repeated_belief(automaton: HybridAutomaton, belief: HybridBelief, count: int) -> BeliefBatch:
    """A belief repeated `count` times as a batch."""
    batch = batch_of([belief], layout_of(automaton).stds)
    weights, means, factors = (np.repeat(values, count, axis=-1) for values in batch.side_by_side())
    return BeliefBatch.of(weights, means, factors, batch.n)


def predict_belief(automaton: HybridAutomaton, belief: Belief, u: ArrayLike) -> Belief:
    """The belief, or beliefs, after one step: flow, process noise, guards, resets, clamps and pins.

    Args:
        u: (m,) input; of many beliefs (t, m).
    """
    layout, inputs = layout_of(automaton), np.asarray(u, dtype=float)
    if isinstance(belief, BeliefBatch):
        return _predicted(layout, belief, inputs.T)
    if inputs.shape != (automaton.m,):
        raise InputError(f"an input must have shape ({automaton.m},). Got {inputs.shape}")
    return predict_each(automaton, [belief], inputs[None])[0]


def update(automaton: HybridAutomaton, belief: Belief, z: ArrayLike) -> Belief:
    """The belief, or beliefs, after measuring z, NaN where there is no measurement.

    Each mode measures as `HybridAutomaton.sensing` defines, at its mean. Mode weights are multiplied by the likelihood.
    A mode's state lies outside the guards that leave it, otherwise it would have left: the measured density is a
    Gaussian truncated there, see `truncation`. A belief whose every mode excludes the measurement is lost, and restarts
    from it, see `reinitialise`.

    Args:
        z: (n,) [rad or m]; of many beliefs (t, n).
    """
    layout, measurement = layout_of(automaton), np.asarray(z, dtype=float)
    if isinstance(belief, BeliefBatch):
        return (
            _updated(layout, belief, measurement.T, belief.weights.T > 0)[0]
            if np.isfinite(measurement).any()
            else belief
        )
    if measurement.shape != (automaton.n,):
        raise InputError(f"a measurement must have shape ({automaton.n},). Got {measurement.shape}")
    return update_each(automaton, [belief], measurement[None])[0]


def predict_each(automaton: HybridAutomaton, beliefs: Sequence[HybridBelief], u: Floats) -> list[HybridBelief]:
    """`predict_belief` of several single beliefs in one go, with inputs (t, m)."""
    layout = layout_of(automaton)
    after = _completed(layout, _predicted(layout, batch_of(beliefs, layout.stds), u.T))
    return [after.alone(number) for number in range(len(beliefs))]


def update_each(automaton: HybridAutomaton, beliefs: Sequence[HybridBelief], z: Floats) -> list[HybridBelief]:
    """`update` of several single beliefs at once, with measurements (t, n); rows without a measurement are unchanged.

    Unlike in a batch, modes without weight are measured too.
    """
    layout, seeing = layout_of(automaton), np.flatnonzero(np.isfinite(z).any(axis=1))
    after = list(beliefs)
    if seeing.size:
        every = np.ones((len(layout.modes), seeing.size), dtype=bool)
        batch, was_lost = _updated(layout, batch_of([beliefs[int(i)] for i in seeing], layout.stds), z[seeing].T, every)
        for number, i in enumerate(seeing):
            after[i] = replace(batch.alone(number), was_reinitialised=bool(was_lost[number]))
    return after


def explains(automaton: HybridAutomaton, belief: HybridBelief, z: Floats) -> bool:
    """Whether a measurement z (n,) agrees with the likeliest mode within noise.

    The remainder has a smaller spread than the measurement's noise. Where it is so far away that noise would have less
    than the probability that filters drop, the model does not describe the measurement, however certain the belief.
    """
    apart, sensed = _innovation_and_std(automaton, belief, z)
    away = np.abs(apart) / np.maximum(sensed, SMALLEST_STD)
    return bool(np.all(2 * ndtr(-away[np.isfinite(away)]) >= NEGLIGIBLE))


def innovations(automaton: HybridAutomaton, belief: HybridBelief, z: Floats) -> Floats:
    """(k,) innovations of a measurement z (k,) under the likeliest mode of the prior belief, in stds.

    Of a correct model they are independent, with mean 0 and std 1. NaN where nothing was measured.
    """
    apart, sensed = _innovation_and_std(automaton, belief, z)
    std = np.linalg.norm(belief.factors[belief.most_likely, : len(z)], axis=1)
    return np.asarray(apart / np.maximum(np.hypot(std, sensed), SMALLEST_STD))


def _innovation_and_std(automaton: HybridAutomaton, belief: HybridBelief, z: Floats) -> tuple[Floats, Floats]:
    """(measurement z minus the likeliest mode's mean, its noise std)."""
    layout, mode = layout_of(automaton), np.array([belief.most_likely])
    mean = np.zeros((layout.n, 1))
    mean[: len(z), 0] = belief.means[mode[0], : len(z)]
    return z - mean[: len(z), 0], _sensing_std(layout, mode, mean)[: len(z), 0]


def _predicted(layout: Layout, beliefs: BeliefBatch, u: Floats) -> BeliefBatch:
    """The beliefs after one step with inputs u (m, t)."""
    registers, count = layout.automaton.input_memories, len(beliefs.weights)
    weights, means, factors = beliefs.side_by_side()
    remembered = np.zeros((layout.n, count)) if registers else None
    arrived: list[tuple[int, Ends]] = []
    travelling: dict[int, list[Pieces]] = {}
    for index in range(len(layout.modes)):
        owner = (weights[index] >= NEGLIGIBLE).nonzero()[0]
        if owner.size:
            mean, factor, inputs = means[:, index], factors[:, :, index], u
            if owner.size < count:
                mean, factor, inputs = (take_last(values, owner) for values in (mean, factor, inputs))
            if remembered is not None:
                passed, kept = passed_arrays(registers, layout.modes[index].mode.name, mean.T, inputs.T)
                inputs, remembered[:, owner] = passed.T, kept.T
            step = whole_step(layout, layout.modes[index], owner, weights[index, owner], mean, factor, inputs)
            travelling[index] = [step]
    events = 0
    while travelling:
        pending: dict[int, list[Pieces]] = {}
        for index, groups in travelling.items():
            pieces = joined_pieces(groups)
            event_limit_reached = events >= MOST_EVENTS
            ends = (
                [pieces.ends()]
                if event_limit_reached
                else through_guards(layout, layout.modes[index], pieces, events, pending)
            )
            arrived += [(index, end) for end in ends]
        travelling, events = pending, events + 1
    return merged_by_mode(layout, arrived, count, remembered)


def _completed(layout: Layout, beliefs: BeliefBatch) -> BeliefBatch:
    """The beliefs with Gaussians for modes without weight: the mixture's, at the mode's pins."""
    weights, means, factors = beliefs.side_by_side()
    lacking = weights == 0
    if not np.count_nonzero(lacking):
        return beliefs
    if np.count_nonzero(lacking) == weights.size - weights.shape[1]:  # each is in one mode
        at = np.argmax(weights, axis=0), np.arange(weights.shape[1])
        mean, factor = means[:, *at], factors[:, :, *at]
    else:
        modes = range(len(weights))
        mean, factor = merged_moments(weights, [means[:, q] for q in modes], [factors[:, :, q] for q in modes])
    means, factors = means.copy(), factors.copy()
    for mode in layout.modes:
        owners = lacking[mode.index].nonzero()[0]
        if owners.size:
            at_pins = replaced_at_pins(take_last(mean, owners), take_last(factor, owners), mode.mode.pins)
            means[:, mode.index, owners] = at_pins[0]
            factors[:, :, mode.index, owners] = lower_factors(at_pins[1]) if mode.pinned else at_pins[1]
    return BeliefBatch.of(weights, means, factors, beliefs.n)


def _updated(layout: Layout, beliefs: BeliefBatch, z: Floats, chosen: Booleans) -> tuple[BeliefBatch, Booleans]:
    """(beliefs after measuring z (n, t), whether each (t,) was reinitialised).

    Args:
        chosen: (q, t) the modes whose Gaussians are measured.
    """
    weights, means, factors = beliefs.side_by_side()
    means, factors = means.reshape(layout.n, -1), factors.reshape(layout.n, layout.n, -1)
    mode, owner = chosen.nonzero()
    at = mode * chosen.shape[1] + owner
    mean, factor = (means, factors) if at.size == chosen.size else (take_last(means, at), take_last(factors, at))
    seen, weight = np.full((layout.n, owner.size), np.nan), weights[mode, owner]
    seen[: layout.own] = take_last(z, owner)
    after, narrowed, score = _measured_in_modes(layout, mode, mean, factor, seen, weight >= NEGLIGIBLE)
    scores = np.full(chosen.shape, -np.inf)
    with np.errstate(divide="ignore"):
        scores[mode, owner] = score + np.log(weight)
    best = scores.max(axis=0)
    weights = np.exp(scores - best)
    if at.size < chosen.size:
        after, narrowed = replace_last(means, at, after), replace_last(factors, at, narrowed)
    evidence = best + np.log(weights.sum(axis=0))
    posterior = BeliefBatch.of(weights / weights.sum(axis=0), after, narrowed, layout.own)
    return _reinitialise_if_lost(layout, beliefs, posterior, z, evidence)


def _measured_in_modes(
    layout: Layout, mode: Ints, mean: Floats, factor: Floats, seen: Floats, likely: Booleans
) -> tuple[Floats, Floats, Floats]:
    """`measured` for states outside the guards that end their modes (p,)."""
    std = _sensing_std(layout, mode, mean)
    mean, factor, before, piled = _uncut_at_guards(layout, mode, mean, factor, likely)
    truncates = (before > _LOG_NEGLIGIBLE) & likely
    mean, factor, score = measured(mean, factor, seen, std)
    mean, factor, chance = _cut_at_guards(layout, mode, mean, factor, truncates)
    score += chance - np.where(truncates, before, 0.0).sum(axis=0)
    for part in piled:
        at = part.number
        on_it, sharp, likelihood = measured(part.mean, part.factor, take_last(seen, at), take_last(std, at))
        both = np.stack([score[at] + np.log1p(-part.share), likelihood + np.log(part.share)])
        score[at] = logsumexp(both, axis=0)
        merged = merged_moments(np.exp(both - score[at]), [take_last(mean, at), on_it], [take_last(factor, at), sharp])
        mean, factor = replace_last(mean, at, merged[0]), replace_last(factor, at, merged[1])
    return mean, factor, score


def _reinitialise_if_lost(
    layout: Layout, before: BeliefBatch, after: BeliefBatch, z: Floats, evidence: Floats
) -> tuple[BeliefBatch, Booleans]:
    """(beliefs after a measurement, whether each was reinitialised) where a lost belief is less probable than a new
    one.
    """
    was_lost = np.zeros(evidence.size, dtype=bool)
    weights, means, factors = after.side_by_side()
    for owner in map(int, (evidence < most_evidence(layout, z)).nonzero()[0]):
        recovered, chance = reinitialise(layout, before.where([owner]), z[:, owner])
        if chance > evidence[owner]:
            if not was_lost.any():
                weights, means, factors = weights.copy(), means.copy(), factors.copy()
            was_lost[owner] = True
            weights[..., owner], means[..., owner], factors[..., owner] = (
                values[..., 0] for values in recovered.side_by_side()
            )
    return BeliefBatch.of(weights, means, factors, after.n), was_lost


@dataclass(frozen=True, eq=False)
class _BoundaryMass:
    """States concentrated on the boundary of one guard, for some of p Gaussians.

    Attributes:
        number: (c,) of the Gaussians.
        share: (c,) of their probability.
        mean, factor: (n, c), (n, n, c) of these states.
    """

    number: Ints
    share: Floats
    mean: Floats
    factor: Floats


def _uncut_at_guards(
    layout: Layout, mode: Ints, mean: Floats, factor: Floats, likely: Booleans
) -> tuple[Floats, Floats, Floats, list[_BoundaryMass]]:
    """Gaussians whose truncations outside the mode-ending guards have the moments (n, p), (n, n, p).

    Args:
        likely: (p,) which are processed; the others are unchanged, without truncation at guards.

    Returns:
        their means and factors, (l, p) the log probability of lying outside each guard given those behind it, and
        the mass on a guard's boundary.
    """
    margins = _margins(layout, mode, mean, factor)
    chances, near, piled = log_probability(*margins), is_cut(*margins) & likely, list[_BoundaryMass]()
    for number in map(int, np.flatnonzero(near.any(axis=1))):
        cut = near[number].nonzero()[0]
        mean_there, factor_there = take_last(mean, cut), take_last(factor, cut)
        margin, row = _margins(layout, mode[cut], mean_there, factor_there, number)
        wider_mean, wider, share = uncut(mean_there, factor_there, margin, row)
        there = (share < 1.0).nonzero()[0]
        if there.size:
            at_it = onto_boundary(*(take_last(values, there) for values in (mean_there, factor_there, margin, row)))
            piled.append(_BoundaryMass(cut[there], 1.0 - share[there], at_it[0], lower_factors(at_it[1])))
        wider = lower_factors(wider)
        mean, factor = replace_last(mean, cut, wider_mean), replace_last(factor, cut, wider)
        chances[number, cut] = log_probability(*_margins(layout, mode[cut], wider_mean, wider, number))
    return mean, factor, chances, piled


def _cut_at_guards(
    layout: Layout, mode: Ints, mean: Floats, factor: Floats, truncates: Booleans
) -> tuple[Floats, Floats, Floats]:
    """Means and factors of Gaussians truncated outside the guards of their modes, and the log probability (p,).

    Args:
        says: (l, p) whether a guard truncates. One behind which all of the prior belief lies does not: the automaton
            itself put the state there, where it takes no transition twice at one instant, and an event without
            probability cannot be conditioned on.
    """
    margins, rows = _margins(layout, mode, mean, factor)
    near = truncates & ((margins < 0.0) | is_cut(margins, rows))
    chances = np.where(near | ~truncates, 0.0, log_probability(margins, rows))
    for number in map(int, np.flatnonzero(near.any(axis=1))[::-1]):
        cut = near[number].nonzero()[0]
        there = take_last(mean, cut), take_last(factor, cut)
        margin = _margins(layout, mode[cut], *there, number)
        chances[number, cut] = log_probability(*margin)
        inward, narrower = truncated(*there, *margin)
        mean, factor = replace_last(mean, cut, inward), replace_last(factor, cut, lower_factors(narrower))
    return mean, factor, chances.sum(axis=0)


def _margins(
    layout: Layout, mode: Ints, mean: Floats, factor: Floats, number: int | slice = slice(None)
) -> tuple[Floats, Floats]:
    """(distance of states (n, p) outside guards (l, p), a'F (l, k, p)) in modes (p,).

    Of the guard with that number alone (p,) and (k, p).
    """
    weights, offsets = (take_last(values[number], mode) for values in layout.outside)
    margin = np.einsum("...ip,ip->...p", weights, mean) - offsets
    return margin, np.einsum("...ip,ikp->...kp", weights, factor)


def _sensing_std(layout: Layout, mode: Ints, mean: Floats) -> Floats:
    """(n, p) std of a measurement of states (n, p) in these modes (p,)."""
    if layout.std is not None:
        return take_last(layout.std, mode)
    std = np.empty(mean.shape)
    for index, sensing in enumerate(layout.sensing):
        chosen = (mode == index).nonzero()[0]
        std[:, chosen] = sensing.std_at(take_last(mean, chosen).T).T
    return std


def _mode_at(automaton: HybridAutomaton, mean: Floats, factor: Floats) -> str:
    holding = automaton.modes_at(mean, ROUND_OFF)
    if holding:
        return holding[0]
    chances = [_probability_inside(mode.invariant.half_spaces, mean, factor) for mode in automaton.modes]
    if max(chances) < _LEAST_CHANCE:
        raise InputError(f"the start {mean.tolist()} lies in no mode's invariant", remedy="move it or name a mode")
    return automaton.modes[int(np.argmax(chances))].name


def _probability_inside(half_spaces: Sequence[HalfSpace], mean: Floats, factor: Floats) -> float:
    """Approximate probability that a state (n,) with factor (n, n) lies in all half-spaces, taken as independent."""
    rows = HalfSpaceRows.of(half_spaces, mean.size, len(half_spaces[0].b) if half_spaces else 0)
    stds = np.sqrt(np.square(rows.a @ factor).sum(axis=1) + SMALLEST_STD**2)
    return float(np.prod(ndtr((rows.a @ mean - rows.c[:, 0]) / stds)))


def _valid_stds(stds: Floats) -> Floats:
    """The stds, checked to be finite and not negative."""
    if not (np.isfinite(stds).all() and (stds >= 0).all()):
        raise InputError(f"standard deviations must be finite and not negative. Got {stds.tolist()}")
    return stds


def _covariance_root(covariance: Floats) -> Floats:
    """Lower factor of a covariance, singular ones included."""
    values, vectors = np.linalg.eigh(covariance)
    if not np.allclose(covariance, covariance.T) or values.min() < -1e-9 * max(1.0, values.max()):
        raise InputError("a covariance must be symmetric and positive semi-definite", remedy="give (n,) stds instead")
    return lower_factors((vectors * np.sqrt(np.maximum(values, 0.0)))[:, :, None])[:, :, 0]
