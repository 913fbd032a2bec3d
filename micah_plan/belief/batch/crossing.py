"""Many Gaussians on their way through one step. Twin of `belief.crossing`, where the mathematics is explained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.effects.motion import displaced
from micah_plan.automaton.hybrid import Edge, HybridAutomaton
from micah_plan.automaton.region import HalfSpace
from micah_plan.automaton.step_noise import process_factor, step_noise_std
from micah_plan.belief.batch.gaussian import condition_on_pins, hold_at_pins, lower_factors
from micah_plan.belief.batch.truncation import Affine, Parts, split
from micah_plan.belief.filter import NEGLIGIBLE
from micah_plan.belief.gaussian import FAR_STDS, SMALLEST_STD

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Pieces:
    """Shares of p beliefs on their way, all in one mode.

    Attributes:
        mode: index of the mode that they move in.
        owner: (p,) number of the belief that each is a share of.
        probability: (p,) of the share.
        mean, factor: (p, 2n), (p, 2n, K) of start and end of what is left of the step.
        fraction: (p,) expected share of the step that is left.
        displacement: (p, n) nominal motion, without noise.
        held: (p, n) where the modes left at the present instant held the coordinates; NaN: they did not.
        events: (p,) transitions taken in this step.
        entered: (p, q) modes that it was in at the present instant.
    """

    mode: int
    owner: Ints
    probability: Floats
    mean: Floats
    factor: Floats
    fraction: Floats
    displacement: Floats
    held: Floats
    events: Ints
    entered: Booleans

    @property
    def n(self) -> int:
        return int(self.displacement.shape[1])

    def __len__(self) -> int:
        return len(self.owner)

    def where(self, chosen: Booleans) -> Pieces:
        """Those that a mask (p,) chooses."""
        if chosen.all():
            return self
        return Pieces(
            self.mode,
            self.owner[chosen],
            self.probability[chosen],
            self.mean[chosen],
            self.factor[chosen],
            self.fraction[chosen],
            self.displacement[chosen],
            self.held[chosen],
            self.events[chosen],
            self.entered[chosen],
        )

    def joined(self, other: Pieces) -> Pieces:
        """These and others of the same mode."""
        if not len(self) or not len(other):
            return other if not len(self) else self
        widest = max(self.factor.shape[2], other.factor.shape[2])
        return Pieces(
            self.mode,
            np.concatenate([self.owner, other.owner]),
            np.concatenate([self.probability, other.probability]),
            np.concatenate([self.mean, other.mean]),
            np.concatenate([widened(self.factor, widest), widened(other.factor, widest)]),
            np.concatenate([self.fraction, other.fraction]),
            np.concatenate([self.displacement, other.displacement]),
            np.concatenate([self.held, other.held]),
            np.concatenate([self.events, other.events]),
            np.concatenate([self.entered, other.entered]),
        )


def widened(factors: Floats, columns: int) -> Floats:
    """(p, N, columns) the factors (p, N, K) with columns of zeros."""
    missing = columns - factors.shape[2]
    return np.concatenate([factors, np.zeros((*factors.shape[:2], missing))], axis=2) if missing else factors


def whole_step(
    automaton: HybridAutomaton, mode: int, owner: Ints, probability: Floats, mean: Floats, factor: Floats, u: Floats
) -> Pieces:
    """The full step of one mode's Gaussians (p, n), (p, n, n) with inputs (p, m); guards not yet applied."""
    q = automaton.modes[mode]
    count, n = mean.shape
    displacement, slope = displaced(automaton, q, mean, u)
    joint = np.zeros((count, 2 * n, 2 * n))
    joint[:, :n, :n] = factor
    joint[:, n:, :n] = slope[:, :, None] * factor
    joint[:, n:, n:] = process_factor(automaton, q, u)
    for tie in q.ties:
        weights = np.array(tie.weights)
        displacement[:, tie.coordinate] = displacement @ weights
        joint[:, n + tie.coordinate] = weights @ joint[:, n:]
    entered = np.zeros((count, len(automaton.modes)), dtype=bool)
    entered[:, mode] = True
    ends = np.concatenate([mean, mean + displacement], axis=1)
    none = np.zeros(count, dtype=np.int64)
    nowhere = np.full((count, n), np.nan)
    return Pieces(mode, owner, probability, ends, joint, np.ones(count), displacement, nowhere, none, entered)


def cross(automaton: HybridAutomaton, pieces: Pieces, edge: Edge, inputs: Floats) -> tuple[Pieces, Pieces]:
    """What takes the edge (already in its target) and what does not; either may be empty. Inputs (p, m)."""
    on_state = [h for h in edge.guard.half_spaces if h.on_state]
    target = automaton.mode_index(edge.target)
    may = np.ones(len(pieces), dtype=bool) if edge.is_self_transition else ~pieces.entered[:, target]
    for half_space in edge.guard.half_spaces:
        if not half_space.on_state:
            margin = inputs @ np.array(half_space.b) - half_space.c
            may &= (margin > 0) | ((margin == 0) & (not half_space.strict))
    if on_state:
        may &= _is_near(pieces, on_state, inputs)
        if may.any():
            may &= (pieces.events == 0) | _is_met_by_mean(pieces, on_state, inputs)
    passed, tried = pieces.where(~may), pieces.where(may)
    if not len(tried):
        return tried, pieces
    if not on_state:
        return _event(automaton, _counted(tried), edge, inputs[may], None), passed
    binding = _binding(tried, on_state, inputs[may])
    taken, left = _cut(tried, on_state, binding, inputs[may])
    # Shares that are passed over later need no event now.
    crosses, stays = (tried.probability * part.probability >= NEGLIGIBLE for part in (taken, left))
    staying = _with(tried, left).where(stays)
    if not crosses.any():
        return tried.where(crosses), passed.joined(staying)
    crossing = _counted(_with(tried, taken).where(crosses))
    return _event(automaton, crossing, edge, inputs[may][crosses], binding.where(crosses)), passed.joined(staying)


@dataclass(frozen=True, eq=False)
class _Bindings:
    """Per piece the half-space that holds last: weights a (p, n), b (p, m), threshold c (p,), index (p,)."""

    a: Floats
    b: Floats
    c: Floats
    index: Ints

    def where(self, chosen: Booleans) -> _Bindings:
        """Those that a mask (p,) chooses."""
        return _Bindings(self.a[chosen], self.b[chosen], self.c[chosen], self.index[chosen])

    def rows(self, u: Floats) -> tuple[Affine, Affine]:
        """The margins at start and end as affine functions of the joint states, for inputs (p, m)."""
        nothing = np.zeros_like(self.a)
        offset = self.c - np.einsum("pj,pj->p", self.b, u)
        return (np.hstack([self.a, nothing]), offset), (np.hstack([nothing, self.a]), offset)


def _same(half_space: HalfSpace, count: int) -> _Bindings:
    """One half-space for all."""
    a, b = (np.tile(np.array(w, dtype=float), (count, 1)) for w in (half_space.a, half_space.b))
    return _Bindings(a, b, np.full(count, half_space.c), np.zeros(count, dtype=np.int64))


def _counted(pieces: Pieces) -> Pieces:
    return replace(pieces, events=pieces.events + 1)


def _with(pieces: Pieces, parts: Parts) -> Pieces:
    return replace(pieces, probability=pieces.probability * parts.probability, mean=parts.mean, factor=parts.factor)


def _is_near(pieces: Pieces, half_spaces: Sequence[HalfSpace], u: Floats) -> Booleans:
    """Whether each piece can be inside every half-space at the start or the end, with more than a share of 1e-15."""
    near, n = np.ones(len(pieces), dtype=bool), pieces.n
    for half_space in half_spaces:
        parts = slice(0, n), slice(n, None)
        start, end = (half_space.margin(pieces.mean[:, part], u) for part in parts)
        reached = np.maximum(start, end) >= 0.0
        if not reached.all():
            for margin, part in zip((start, end), parts, strict=True):
                std = _stds(half_space, pieces.factor[:, part])
                reached |= margin >= -FAR_STDS * (std + SMALLEST_STD)
            near &= reached
            if not near.any():
                break
    return near


def _stds(half_space: HalfSpace, factors: Floats) -> Floats:
    """(p,) stds of a half-space's margin over states with factors (p, n, K)."""
    row = np.zeros((len(factors), factors.shape[2]))
    for i, weight in enumerate(half_space.a):
        if weight:
            row += weight * factors[:, i]
    return np.asarray(np.sqrt(np.einsum("pk,pk->p", row, row)))


def _is_met_by_mean(pieces: Pieces, half_spaces: Sequence[HalfSpace], u: Floats) -> Booleans:
    """Whether each mean is inside the guard or moves towards it."""
    inside, towards = np.ones(len(pieces), dtype=bool), np.zeros(len(pieces), dtype=bool)
    held = np.where(np.isnan(pieces.held), pieces.mean[:, : pieces.n], pieces.held)
    for half_space in half_spaces:
        start = half_space.margin(pieces.mean[:, : pieces.n], u)
        end = half_space.margin(pieces.mean[:, pieces.n :], u)
        inside &= half_space.margin(held, u) > SMALLEST_STD
        towards |= end - start > SMALLEST_STD
    return inside | towards


def _binding(pieces: Pieces, half_spaces: Sequence[HalfSpace], u: Floats) -> _Bindings:
    """The half-space that holds last: the one whose margin at the start is worst."""
    if len(half_spaces) == 1:
        return _same(half_spaces[0], len(pieces))
    worst = []
    for half_space in half_spaces:
        along = _stds(half_space, pieces.factor[:, : pieces.n])
        worst.append(half_space.margin(pieces.mean[:, : pieces.n], u) / (along + SMALLEST_STD))
    index = np.argmin(np.stack(worst), axis=0)
    a, b, c = (np.array([getattr(h, name) for h in half_spaces], dtype=float) for name in ("a", "b", "c"))
    return _Bindings(a[index], b[index], c[index], index)


def _cut(pieces: Pieces, half_spaces: Sequence[HalfSpace], binding: _Bindings, u: Floats) -> tuple[Parts, Parts]:
    """The share within all half-spaces at the end, entering through the binding one."""
    taken, left = split(pieces.mean, pieces.factor, *binding.rows(u))
    if len(half_spaces) == 1:
        return taken, left
    probability, mean = taken.probability.copy(), taken.mean.copy()
    factor = taken.factor
    for number, half_space in enumerate(half_spaces):
        chosen = np.flatnonzero((binding.index != number) & (probability > 0.0))
        if not chosen.size:
            continue
        _, after = _same(half_space, chosen.size).rows(u[chosen])
        never = (np.zeros_like(after[0]), np.ones(chosen.size))
        inner, _ = split(mean[chosen], factor[chosen], never, after)
        probability[chosen] *= inner.probability
        mean[chosen] = inner.mean
        factor = widened(factor, inner.factor.shape[2])
        factor = factor.copy()
        factor[chosen] = inner.factor
    return Parts(probability, mean, factor), Parts(1.0 - probability, pieces.mean, pieces.factor)


def _event(automaton: HybridAutomaton, pieces: Pieces, edge: Edge, u: Floats, binding: _Bindings | None) -> Pieces:
    """The pieces after the transition: reset where the path meets the guard, then the new mode's motion."""
    count, n = len(pieces), pieces.n
    motion = pieces.mean[:, n:] - pieces.mean[:, :n]
    a, b, c = edge.reset.matrices(n, u.shape[1])
    share, slope = _share_behind(pieces, binding, u)
    end, difference = np.eye(n, 2 * n, n), np.eye(n, 2 * n, n) - np.eye(n, 2 * n)
    behind_mean = share[:, None] * motion
    behind = share[:, None, None] * difference + motion[:, :, None] * slope[:, None, :]
    met = end - behind
    if binding is not None:
        # Linearised products leave a little spread across the guard; the event lies on it.
        within = share < 1.0
        speed = np.where(within, np.einsum("pi,pi->p", binding.a, motion), 1.0)
        along = np.where(within[:, None], motion / speed[:, None], 0.0)
        met = met - along[:, :, None] * (binding.a[:, None, :] @ met)
        behind = end - met
    new_start_mean = (pieces.mean[:, n:] - behind_mean) @ a.T + u @ b.T + c
    new_start = a @ met
    if edge.is_self_transition:
        displacement = share[:, None] * (pieces.displacement @ a.T)
        new_end_mean, new_end = new_start_mean + behind_mean @ a.T, new_start + a @ behind
    else:
        nominal = pieces.fraction[:, None] * displaced(automaton, automaton.mode(edge.target), new_start_mean, u)[0]
        change = nominal - pieces.displacement
        displacement = share[:, None] * nominal
        new_end_mean = new_start_mean + behind_mean + share[:, None] * change
        new_end = new_start + behind + change[:, :, None] * slope[:, None, :]
    source, target = automaton.mode_index(edge.source), automaton.mode_index(edge.target)
    at_once = (share > 1.0 - 1e-9)[:, None]
    entered = np.where(at_once, pieces.entered, np.arange(len(automaton.modes)) == source)
    entered[:, target] = True
    held = pieces.held.copy()
    for pin in automaton.modes[source].pins:
        held[:, pin.coordinate] = pin.value + (0.0 if pin.follows is None else pieces.mean[:, pin.follows])
    arrived = Pieces(
        mode=target,
        owner=pieces.owner,
        probability=pieces.probability,
        mean=np.concatenate([new_start_mean, new_end_mean], axis=1),
        factor=np.concatenate([np.broadcast_to(new_start, (count, n, 2 * n)), new_end], axis=1) @ pieces.factor,
        fraction=share * pieces.fraction,
        displacement=displacement,
        held=np.where(at_once & edge.reset.is_identity, held, np.nan),
        events=pieces.events,
        entered=entered,
    )
    return arrived if edge.is_self_transition else _entered(automaton, arrived, edge, u)


def _share_behind(pieces: Pieces, binding: _Bindings | None, u: Floats) -> tuple[Floats, Floats]:
    """(p,) expected shares of the paths behind the guard and their gradients (p, 2n); 1 where one starts behind."""
    share, slope = np.ones(len(pieces)), np.zeros_like(pieces.mean)
    if binding is None:
        return share, slope
    (weights0, offset), (weights1, _) = binding.rows(u)
    before = np.einsum("pi,pi->p", weights0, pieces.mean) - offset
    after = np.einsum("pi,pi->p", weights1, pieces.mean) - offset
    within = (before < 0) & (after - before > SMALLEST_STD)
    share[within] = after[within] / (after - before)[within]
    slope[within] = weights1[within] / (after - before)[within, None]
    return share, slope


def _entered(automaton: HybridAutomaton, pieces: Pieces, edge: Edge, u: Floats) -> Pieces:
    """The pieces in their new mode: held coordinates stand still and are known, freed ones get their process noise."""
    n = pieces.n
    source, target = automaton.mode(edge.source), automaton.mode(edge.target)
    located = automaton.pins_located_by(edge)
    mean, factor = hold_at_pins(pieces.mean, pieces.factor, located)
    displacement = pieces.displacement.copy()
    for pin in target.pins:
        mean[:, n + pin.coordinate], factor[:, n + pin.coordinate] = mean[:, pin.coordinate], factor[:, pin.coordinate]
        displacement[:, pin.coordinate] = 0.0
    for tie in target.ties:
        weights, i = np.array(tie.weights), tie.coordinate
        mean[:, n + i], factor[:, n + i] = tie.offset + mean[:, n:] @ weights, weights @ factor[:, n:]
        displacement[:, i] = displacement @ weights
    old, new = (step_noise_std(automaton, mode, u) for mode in (source, target))
    noise = np.zeros((len(pieces), 2 * n, n))
    noise[:, n:] = (pieces.fraction[:, None] * np.where(old == 0, new, 0.0))[:, :, None] * np.eye(n)
    factor = lower_factors(np.concatenate([factor, noise], axis=2))
    mean, factor = condition_on_pins(mean, factor, automaton.pins_met_by(edge))
    return replace(pieces, mean=mean, factor=factor, displacement=displacement)
