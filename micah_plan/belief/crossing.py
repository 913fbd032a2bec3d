"""Gaussians during one step: the cuts at guards, and the crossing part behind a transition.

As in the automaton's own transition logic, a step is a straight path from a start to an end, an event lies where the
path meets the guard, and the rest of the step follows the new mode. So the joint Gaussian of start and end (2n,) is
propagated, and an event maps it to the joint Gaussian of the event's state and the new end.

The effect of a transition on Gaussians that cross a guard: the reset where their paths meet it, the rest of the step in
the new mode, and the information of that mode's pins.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import ndtr

from micah_plan.arrays import SMALLEST_STD, Booleans, Floats, Ints
from micah_plan.automaton.effects.motion import displaced
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.step_noise import step_noise_std
from micah_plan.belief.gaussian import condition_on_pins, lower_factors, put_at_pins, take_last, weighted
from micah_plan.belief.layout import Exit, ExitBounds, Layout, ModeLayout
from micah_plan.belief.pieces import Binding, Ends, Pieces
from micah_plan.belief.truncation import NEGLIGIBLE, NOTHING, REACH, Shares, split, truncated

# Factors with more than this many columns per row are made triangular in between.
_WIDEST = 3


def whole_step(
    layout: Layout, mode: ModeLayout, owner: Ints, probability: Floats, mean: Floats, factor: Floats, u: Floats
) -> Pieces:
    """The full step of a mode's Gaussians (n, p), (n, n, p) with inputs (m, p): flow and process noise, no guards."""
    n, count = mean.shape
    joint = np.zeros((2, n, n + len(mode.noisy), count))
    joint[:, :, :n] = factor
    end = joint[1]
    if layout.automaton.effects:
        moved, slope = (values.T for values in displaced(layout.automaton, mode.mode, mean.T, u.T))
        displacement = moved.copy()
        end[:, :n] *= slope[:, None]
    else:
        displacement = mode.mode.B @ u
    std = step_noise_std(layout.automaton, mode.mode, u.T).T if mode.gain else mode.process
    for column, i in enumerate(mode.noisy, start=n):
        end[i, column] = std[i]
    for tie in mode.mode.ties:
        weights = np.array(tie.weights)
        displacement[tie.coordinate] = weights @ displacement
        end[tie.coordinate] = weighted(weights, end)
    ends = np.empty((2, n, count))
    ends[0] = mean
    np.add(mean, displacement, out=ends[1])
    entered = np.zeros((len(layout.modes), count), dtype=bool)
    entered[mode.index] = True
    nowhere, taken = np.full((n, count), np.nan), np.zeros((len(mode.exits), count), dtype=bool)
    return Pieces(owner, probability, ends, joint, u, np.ones(count), displacement, nowhere, entered, taken)


def through_guards(
    layout: Layout, mode: ModeLayout, pieces: Pieces, events: int, pending: dict[int, list[Pieces]]
) -> list[Ends]:
    """The shares that end the step in their mode; crossing ones are appended to `pending` by their new mode.

    Args:
        events: transitions that the pieces have taken in this step.
    """
    if events:
        pieces = _projected_on_blocked(mode, pieces)
    ended: list[Ends] = []
    free, first = _allowed_exits(mode, pieces, events), 0
    sure = _first_input_exits(mode, free)
    leaving = (sure < len(mode.exits)).nonzero()[0]
    if leaving.size:
        _leave_at_once(layout, mode, pieces.where(leaving), take_last(free, leaving), sure[leaving], pending)
        staying = (sure == len(mode.exits)).nonzero()[0]
        if not staying.size:
            return ended
        pieces, free = pieces.where(staying), take_last(free, staying)
    while first < len(mode.exits) and pieces.owner.size:
        may = free[first:] & _reachable_exits(mode.exit_bounds[first], pieces, events)
        meets = np.asarray(may.any(axis=0))
        busy = meets.nonzero()[0]
        if busy.size < meets.size:
            ended.append(pieces.ends().where((~meets).nonzero()[0]))
            if not busy.size:
                return ended
            pieces, free, may = pieces.where(busy), take_last(free, busy), take_last(may, busy)
        ahead = int(may.any(axis=1).argmax())
        candidate_exit = mode.exits[first + ahead]
        taken, pieces = _cross(layout, mode, pieces, may[ahead].nonzero()[0], candidate_exit)
        if taken is not None:
            pending.setdefault(candidate_exit.target, []).append(taken)
        alive = (pieces.probability >= NEGLIGIBLE).nonzero()[0]
        pieces, free, first = pieces.where(alive), take_last(free, alive), first + ahead + 1
    return [*ended, pieces.ends()] if pieces.owner.size else ended


def _allowed_exits(mode: ModeLayout, pieces: Pieces, events: int) -> Booleans:
    """(e, p) whether the input allows each exit, and it is not blocked at this instant."""
    free = np.ones((len(mode.exits), pieces.owner.size), dtype=bool)
    for number, candidate_exit in enumerate(mode.exits):
        if events:
            free[number] = ~_blocked(pieces, number, candidate_exit)
        if len(candidate_exit.on_input):
            free[number] &= candidate_exit.allowed(pieces.u)
    return free


def _first_input_exits(mode: ModeLayout, free: Booleans) -> Ints:
    """(p,) first exit that the input alone opens for each piece; the number of exits where none does."""
    sure = np.full(free.shape[1], len(mode.exits))
    for number in reversed(range(len(mode.exits))):
        if not len(mode.exits[number].on_state):
            sure[free[number]] = number
    return sure


def _leave_at_once(
    layout: Layout, mode: ModeLayout, pieces: Pieces, free: Booleans, sure: Ints, pending: dict[int, list[Pieces]]
) -> None:
    """Move pieces through exits that open before the state moves: entirely, by the first exit that holds.

    Args:
        sure: (p,) the exit that the input alone opens; earlier exits take the mass inside them at that instant.
    """
    parts = [(pieces, free, sure)]
    for number, candidate_exit in enumerate(mode.exits):
        after: list[tuple[Pieces, Booleans, Ints]] = []
        for part, opened, until in parts:
            may = opened[number] & (number <= until) & (part.probability >= NEGLIGIBLE)
            if len(candidate_exit.on_state) and not len(candidate_exit.on_input):
                # What lies behind the boundary of a mode is the tail of a fit, unless the mean itself does.
                inside = (
                    candidate_exit.on_state.a @ part.mean[0] - candidate_exit.on_state.offsets(part.u) > SMALLEST_STD
                )
                may &= inside.all(axis=0)
            chosen, others = may.nonzero()[0], (~may).nonzero()[0]
            if others.size:
                after.append((part.where(others), take_last(opened, others), until[others]))
            if not chosen.size:
                continue
            here = part.where(chosen)
            gone, remaining = (
                (here, []) if not len(candidate_exit.on_state) else _divided_at_start(here, candidate_exit)
            )
            crosses = (gone.probability >= NEGLIGIBLE).nonzero()[0]
            if crosses.size:
                taken = gone.where(crosses)
                binding = (
                    _binding(taken.mean[0], taken.factor[0], taken.u, candidate_exit)
                    if len(candidate_exit.on_state)
                    else None
                )
                pending.setdefault(candidate_exit.target, []).append(
                    transition(layout, mode, taken, candidate_exit, binding)
                )
            after += [(piece, take_last(opened, chosen), until[chosen]) for piece in remaining]
        parts = after


def _divided_at_start(pieces: Pieces, candidate_exit: Exit) -> tuple[Pieces, list[Pieces]]:
    """(shares inside a guard at the start of the step, shares outside each of its half-spaces).

    Each of several half-spaces takes the mass that is inside the earlier ones and outside it.
    """
    inside, outside = pieces, list[Pieces]()
    for a, offset in zip(candidate_exit.on_state.a, candidate_exit.on_state.offsets(pieces.u), strict=True):
        margin, row = a @ inside.mean[0] - offset, weighted(a, inside.factor[0])
        chance = ndtr(margin / (np.sqrt(np.einsum("kp,kp->p", row, row)) + SMALLEST_STD))
        outside.append(_conditioned(inside, -margin, -row, 1.0 - chance))
        inside = _conditioned(inside, margin, row, chance)
    return inside, outside


def _conditioned(pieces: Pieces, margin: Floats, row: Floats, chance: Floats) -> Pieces:
    """The shares of pieces with a positive margin (p,) at the start, which has probability `chance` (p,)."""
    mean, factor = pieces.mean, pieces.factor
    cut = ((chance < 1.0) & (chance >= NEGLIGIBLE)).nonzero()[0]
    if cut.size:
        mean, factor = mean.copy(), factor.copy()
        cut_mean = take_last(mean, cut), take_last(factor, cut), margin[cut], take_last(row, cut)
        mean[..., cut], factor[..., cut] = truncated(*cut_mean)
    return replace(pieces, probability=pieces.probability * chance, mean=mean, factor=factor)


def _reachable_exits(exit_bounds: ExitBounds, pieces: Pieces, events: int) -> Booleans:
    """(e, p) whether a piece lies inside all half-spaces of each exit with probability above 1e-15.

    The std of a margin is bounded by those of the coordinates; a mass that turns out to be far is not divided.

    Within a step only the first event may be due to noise: after it, the tails of the crossing mass are those of a fit,
    and the mean must be inside the guard or move towards it. And a coordinate that was just pinned is at its pin: the
    pin's std does not put it behind a guard that begins there.
    """
    offset = exit_bounds.rows.offsets(pieces.u)
    margin = exit_bounds.rows.a @ pieces.mean - offset
    std = np.sqrt(np.einsum("eikp,eikp->eip", pieces.factor, pieces.factor)) + SMALLEST_STD
    start, end = margin + exit_bounds.far @ std >= 0.0
    reached = exit_bounds.all_hold(start | end)
    if events and np.count_nonzero(reached):
        is_free = ~np.isnan(pieces.pinned_at)
        start_margin = margin[0]
        if np.count_nonzero(is_free):
            start_margin = exit_bounds.rows.a @ np.where(is_free, pieces.pinned_at, pieces.mean[0]) - offset
        reached &= exit_bounds.any_holds(margin[1] - margin[0] > SMALLEST_STD) | exit_bounds.all_hold(
            start_margin > SMALLEST_STD
        )
    return reached


def _cross(
    layout: Layout, mode: ModeLayout, pieces: Pieces, chosen: Ints, candidate_exit: Exit
) -> tuple[Pieces | None, Pieces]:
    """(crossing shares in the target with the remaining step, staying shares) of the chosen pieces at an exit."""
    if not len(candidate_exit.on_state):
        remaining = pieces.probability.copy()
        remaining[chosen] = 0.0
        return transition(layout, mode, pieces.where(chosen), candidate_exit, None), replace(
            pieces, probability=remaining
        )
    probability, mean, factor, u = pieces.probability, pieces.mean, pieces.factor, pieces.u
    if chosen.size < probability.size:
        probability, mean, factor, u = (take_last(values, chosen) for values in (probability, mean, factor, u))
    binding = _binding(mean[0], factor[0], u, candidate_exit)
    margins = binding.margins(mean, factor)
    reach = margins.can_cross(probability).nonzero()[0]
    if not reach.size:
        return None, pieces
    if reach.size < chosen.size:
        chosen, binding, margins = chosen[reach], binding.where(reach), margins.where(reach)
        probability, mean, factor, u = (take_last(values, reach) for values in (probability, mean, factor, u))
    shares = split(mean, factor, margins)
    taken, remaining = probability * shares.probability
    rest = shares.mean[1], shares.factor[1]
    if len(candidate_exit.on_state) > 1:
        taken = taken * _within_others(shares, candidate_exit, binding, u)
        # The complement of a corner is no half-space: what stays keeps the moments of the whole.
        rest, remaining = (mean, factor), probability - taken
    staying = pieces.replaced(chosen, remaining, *rest)
    crosses = (taken >= NEGLIGIBLE).nonzero()[0]
    if not crosses.size:
        return None, staying
    mean, factor = shares.mean[0], shares.factor[0]
    if crosses.size < chosen.size:
        chosen, binding, taken = chosen[crosses], binding.where(crosses), taken[crosses]
        mean, factor = take_last(mean, crosses), take_last(factor, crosses)
    return transition(layout, mode, pieces.subset(chosen, taken, mean, factor), candidate_exit, binding), staying


def _binding(mean: Floats, factor: Floats, u: Floats, candidate_exit: Exit) -> Binding:
    """The binding half-space, with the worst margin at the start (n, p), (n, k, p)."""
    rows = candidate_exit.on_state
    offsets = rows.offsets(u)
    if len(rows) == 1:
        return Binding(rows.terms, offsets[0])
    worst = np.argmin((rows.a @ mean - offsets) / (_stds(rows.a, factor) + SMALLEST_STD), axis=0)
    offset = np.take_along_axis(np.broadcast_to(offsets, (len(rows), worst.size)), worst[None], axis=0)[0]
    return Binding(tuple((i, rows.a[worst, i]) for i, _ in rows.terms), offset, worst)


def _stds(weights: Floats, factor: Floats) -> Floats:
    """(r, p) stds of r weighted sums, weights (r, n), of states with factors (n, k, p)."""
    rows = weighted(weights, factor)
    return np.asarray(np.sqrt(np.einsum("rkp,rkp->rp", rows, rows)))


def _within_others(shares: Shares, candidate_exit: Exit, binding: Binding, u: Floats) -> Floats:
    """(p,) probability that crossing shares lie within all half-spaces but the binding one; the shares are cut in
    place.

    A half-space that the path leads out of must hold where it crosses the binding one, any other at the end: a hand
    that may grasp now has done so, for any further motion in that step. The probability is the product of the
    conditional ones, each given the ones before.
    """
    mean, factor = shares.mean[0], shares.factor[0]
    within = np.ones(mean.shape[-1])
    before, after = binding.along(mean.swapaxes(0, 1)) - binding.offset
    way_there = np.where(before < 0.0, np.clip(before / np.minimum(before - after, -NOTHING), 0.0, 1.0), 0.0)
    for number, offset in enumerate(candidate_exit.on_state.offsets(u) + SMALLEST_STD):
        weights = candidate_exit.on_state.a[number]
        start, end = (weights @ place - offset for place in mean)
        at = np.where(end < start, way_there, 1.0)
        ahead = start + at * (end - start)
        rows = weighted(weights, factor[0]) * (1.0 - at) + weighted(weights, factor[1]) * at
        std = np.maximum(np.sqrt(np.einsum("kp,kp->p", rows, rows)), NOTHING)
        cut = ((binding.number != number) & (ahead < REACH * std) & (within > 0.0)).nonzero()[0]
        if not cut.size:
            continue
        inside = ndtr(ahead[cut] / std[cut])
        within[cut] *= np.where(inside >= NEGLIGIBLE, inside, 0.0)
        cut = cut[inside >= NEGLIGIBLE]
        cut_factor, row = take_last(factor, cut), take_last(rows, cut)
        mean[..., cut], factor[..., cut] = truncated(take_last(mean, cut), cut_factor, ahead[cut], row)
    return within


def _blocked(pieces: Pieces, number: int, candidate_exit: Exit) -> Booleans:
    """(p,) whether an exit leads back to a mode entered at this instant, or repeats a self-transition."""
    return np.asarray(pieces.taken[number] if candidate_exit.is_self else pieces.entered[candidate_exit.target])


def _projected_on_blocked(mode: ModeLayout, pieces: Pieces) -> Pieces:
    """The pieces with ends projected on the boundaries of blocked exits.

    Where an input moves a coordinate forth in a mode and back in the next, the step that enters the next mode would
    lead straight back; where a transition back to its own mode resets another coordinate than led to it, the step goes
    on into its guard. Nothing happens twice at one instant (`automaton.transition`), so the boundary is a wall: the end
    of the step is put on it, and the spread across becomes 0.
    """
    for number, candidate_exit in enumerate(mode.exits):
        if len(candidate_exit.on_state):
            chosen = _blocked(pieces, number, candidate_exit).nonzero()[0]
            if chosen.size:
                pieces = _projected_along(mode, pieces, candidate_exit, chosen)
    return pieces


def _projected_along(mode: ModeLayout, pieces: Pieces, candidate_exit: Exit, chosen: Ints) -> Pieces:
    rows, u = candidate_exit.on_state, take_last(pieces.u, chosen)
    starts, ends = rows.a @ take_last(pieces.mean, chosen) - rows.offsets(u)
    pressed = np.argmin(starts, axis=0)
    at_it = (np.abs(starts.min(axis=0)) <= SMALLEST_STD) & (ends.min(axis=0) >= 0.0) & candidate_exit.allowed(u)
    for number, a in enumerate(rows.a):
        # The component of the boundary's normal along which the mode can move.
        normal = a.copy()
        normal[list(mode.still)] = 0.0
        pressing = (at_it & (pressed == number) & (ends[number] > SMALLEST_STD)).nonzero()[0]
        if not pressing.size or not normal.any():
            continue
        back, which = (normal / float(normal @ normal))[:, None], chosen[pressing]
        mean, factor, displacement = pieces.mean.copy(), pieces.factor.copy(), pieces.displacement.copy()
        mean[1][:, which] -= back * ends[number, pressing]
        factor[1][..., which] -= back[:, None] * weighted(a, take_last(factor[1], which))
        displacement[:, which] -= back * (a @ take_last(displacement, which))
        pieces = replace(pieces, mean=mean, factor=factor, displacement=displacement)
    return pieces


def transition(
    layout: Layout, mode: ModeLayout, pieces: Pieces, candidate_exit: Exit, binding: Binding | None
) -> Pieces:
    """The pieces after the transition: reset where the path meets the guard, then the new mode's motion.

    With r the share of the path behind the guard, r = m1 / (m1 - m0) is linearised about the means, as are its products
    with the motion; for a sharp belief or a motion large against its noise this is exact.
    """
    (start, end), (before, after) = pieces.mean, pieces.factor
    n, width, count = before.shape
    noise = None if candidate_exit.is_self else _freed_coordinates(layout, mode, pieces, candidate_exit)
    room = 0 if noise is None else len(candidate_exit.located) + len(noise[0])
    mean, factor = np.empty((2, n, count)), np.zeros((2, n, width + room, count))
    met, ahead = factor[:, :, :width]
    share, per_way = _share_behind(pieces, binding)
    motion = end - start
    behind_mean = share * motion
    np.subtract(end, behind_mean, out=mean[0])
    # On the guard the uncertainty across it is 0: the uncertainty before moves the event along the path.
    np.multiply(before - after, share, out=met)
    met += after
    ahead[:] = after
    if binding is not None:
        share_factor = binding.along(met) * per_way  # the uncertainty of the share itself, by the factors' columns
        met -= motion[:, None] * share_factor
    if candidate_exit.reset is not None:
        behind = after - met
        a, b, c = candidate_exit.reset
        mean[0] = a @ mean[0] + b @ pieces.u + c[:, None]
        met[:] = weighted(a, met)
        if candidate_exit.is_self:
            behind_mean, behind = a @ behind_mean, weighted(a, behind)
        np.add(met, behind, out=ahead)
    np.add(mean[0], behind_mean, out=mean[1])
    if candidate_exit.is_self:
        displacement = share * (
            pieces.displacement if candidate_exit.reset is None else candidate_exit.reset[0] @ pieces.displacement
        )
    else:
        nominal = pieces.fraction * _motion(layout.automaton, layout.modes[candidate_exit.target], mean[0], pieces.u)
        change, displacement = nominal - pieces.displacement, share * nominal
        mean[1] += share * change
        if binding is not None:
            ahead += change[:, None] * share_factor
    at_once = share > 1.0 - 1e-9
    entered = pieces.entered & at_once
    entered[mode.index] = entered[candidate_exit.target] = True
    arrived = Pieces(
        owner=pieces.owner,
        probability=pieces.probability,
        mean=mean,
        factor=factor,
        u=pieces.u,
        fraction=share * pieces.fraction,
        displacement=displacement,
        pinned_at=_pinned_at(mode, pieces, candidate_exit, at_once),
        entered=entered,
        taken=_exits_taken(layout, mode, pieces, candidate_exit, at_once),
    )
    return arrived if noise is None else _in_new_mode(layout, arrived, candidate_exit, width, noise)


def _share_behind(pieces: Pieces, binding: Binding | None) -> tuple[Floats, Floats]:
    """(p,) expected fraction of the path behind the guard, and (p,) 1 / (m1 - m0); 1 and 0 for starts behind it."""
    if binding is None:
        return np.ones(pieces.owner.size), np.zeros(pieces.owner.size)
    before, after = binding.along(pieces.mean.swapaxes(0, 1)) - binding.offset
    path = after - before
    within = (before < 0) & (path > SMALLEST_STD)
    per_way = within / np.where(within, path, 1.0)
    return np.where(within, after * per_way, 1.0), per_way


def _motion(automaton: HybridAutomaton, mode: ModeLayout, mean: Floats, u: Floats) -> Floats:
    """(n, p) displacement of a mode's whole step from states (n, p) with inputs (m, p)."""
    if not automaton.effects:
        return np.asarray(mode.mode.B @ u)
    return np.asarray(displaced(automaton, mode.mode, mean.T, u.T)[0].T)


def _pinned_at(mode: ModeLayout, pieces: Pieces, candidate_exit: Exit, at_once: Booleans) -> Floats:
    """(n, p) pinned values of pieces that leave a mode at once; NaN where they move freely or a reset acts."""
    if candidate_exit.reset is not None or not np.count_nonzero(at_once):
        return np.full(pieces.pinned_at.shape, np.nan)
    pinned_at = np.where(at_once, pieces.pinned_at, np.nan)
    for pin in mode.mode.pins:
        place = pin.value if pin.follows is None else pin.value + pieces.mean[0, pin.follows]
        pinned_at[pin.coordinate] = np.where(at_once, place, np.nan)
    return pinned_at


def _exits_taken(layout: Layout, mode: ModeLayout, pieces: Pieces, candidate_exit: Exit, at_once: Booleans) -> Booleans:
    """`Pieces.taken` after an exit; cleared for newly entered modes."""
    if not candidate_exit.is_self:
        return np.zeros((len(layout.modes[candidate_exit.target].exits), pieces.owner.size), dtype=bool)
    taken = pieces.taken & at_once
    taken[mode.exits.index(candidate_exit)] = True
    return np.asarray(taken)


def _freed_coordinates(layout: Layout, source: ModeLayout, pieces: Pieces, candidate_exit: Exit) -> tuple[Ints, Floats]:
    """(coordinates (c,) that were noise-free in the mode before, their std (c, p) or (c, 1) per whole step)."""
    if candidate_exit.freed is not None:
        return candidate_exit.freed
    modes = source.mode, layout.modes[candidate_exit.target].mode
    old, new = (step_noise_std(layout.automaton, mode, pieces.u.T).T for mode in modes)
    fresh = np.where(old == 0.0, new, 0.0)
    coordinates = np.flatnonzero(fresh.any(axis=1))
    return coordinates, np.asarray(fresh[coordinates])


def _in_new_mode(
    layout: Layout, pieces: Pieces, candidate_exit: Exit, column: int, noise: tuple[Ints, Floats]
) -> Pieces:
    """The pieces in their new mode, with pinned coordinates fixed and process noise on freed ones.

    A pin at the guard replaces the estimate of its coordinate, any other pin is fused with it.

    Args:
        pieces: with arrays of their own, which are written to; their factors have columns to fill from that number on.
        noise: of the freed coordinates.
    """
    target, mean, factor, displacement = (
        layout.modes[candidate_exit.target],
        pieces.mean,
        pieces.factor,
        pieces.displacement,
    )
    put_at_pins(mean[0], factor[0], candidate_exit.located, column)
    for i in target.pinned:
        mean[1, i], factor[1, i], displacement[i] = mean[0, i], factor[0, i], 0.0
    for tie in target.mode.ties:
        weights, i = np.array(tie.weights), tie.coordinate
        mean[1, i], factor[1, i] = tie.offset + weights @ mean[1], weighted(weights, factor[1])
        displacement[i] = weights @ displacement
    coordinates, std = noise
    for number, i in enumerate(coordinates):
        factor[1, i, column + len(candidate_exit.located) + number] += std[number] * pieces.fraction
    joint = 2 * len(displacement)
    if factor.shape[2] > _WIDEST * joint:
        factor = lower_factors(factor.reshape(joint, *factor.shape[2:])).reshape(*factor.shape[:2], joint, -1)
    if not candidate_exit.met:
        return replace(pieces, factor=factor)
    means, factors = condition_on_pins(
        mean.reshape(joint, -1), factor.reshape(joint, *factor.shape[2:]), candidate_exit.met
    )
    return replace(pieces, mean=means.reshape(mean.shape), factor=factors.reshape(factor.shape))
