"""What a transition makes of Gaussians that cross a guard: the reset where their paths meet it, the rest of the step in
the new mode, and the information of that mode's pins.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from micah_plan.arrays import Booleans, Floats, Ints
from micah_plan.automaton.effects.motion import displaced
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.step_noise import step_noise_std
from micah_plan.belief.gaussian import SMALLEST_STD, condition_on_pins, lower_factors, put_at_pins, weighted
from micah_plan.belief.layout import Exit, Layout, ModeLayout
from micah_plan.belief.pieces import Binding, Pieces

# Factors with more than this many columns per row are made triangular on the way.
_WIDEST = 3


def transition(layout: Layout, mode: ModeLayout, pieces: Pieces, way: Exit, binding: Binding | None) -> Pieces:
    """The pieces after the transition: reset where the path meets the guard, then the new mode's motion.

    With r the share of the path behind the guard, r = m1 / (m1 - m0) is linearised about the means, as are its products
    with the motion; for a sharp belief or a motion large against its noise this is exact.
    """
    (start, end), (before, after) = pieces.mean, pieces.factor
    n, width, count = before.shape
    noise = None if way.is_self else _freed(layout, mode, pieces, way)
    room = 0 if noise is None else len(way.located) + len(noise[0])
    mean, factor = np.empty((2, n, count)), np.zeros((2, n, width + room, count))
    met, ahead = factor[:, :, :width]
    share, per_way = _share_behind(pieces, binding)
    motion = end - start
    behind_mean = share * motion
    np.subtract(end, behind_mean, out=mean[0])
    # On the guard nothing is uncertain across it: the uncertainty before moves the event along the path.
    np.multiply(before - after, share, out=met)
    met += after
    ahead[:] = after
    if binding is not None:
        met -= motion[:, None] * (binding.along(met) * per_way)
    if way.reset is not None:
        behind = after - met
        a, b, c = way.reset
        mean[0] = a @ mean[0] + b @ pieces.u + c[:, None]
        met[:] = weighted(a, met)
        if way.is_self:
            behind_mean, behind = a @ behind_mean, weighted(a, behind)
        np.add(met, behind, out=ahead)
    np.add(mean[0], behind_mean, out=mean[1])
    if way.is_self:
        displacement = share * (pieces.displacement if way.reset is None else way.reset[0] @ pieces.displacement)
    else:
        nominal = pieces.fraction * _motion(layout.automaton, layout.modes[way.target], mean[0], pieces.u)
        change, displacement = nominal - pieces.displacement, share * nominal
        mean[1] += share * change
        if binding is not None:
            ahead += change[:, None] * (binding.along(after) * per_way)
    at_once = share > 1.0 - 1e-9
    entered = pieces.entered & at_once
    entered[mode.index] = entered[way.target] = True
    arrived = Pieces(
        owner=pieces.owner,
        probability=pieces.probability,
        mean=mean,
        factor=factor,
        u=pieces.u,
        fraction=share * pieces.fraction,
        displacement=displacement,
        pinned_at=_pinned_at(mode, pieces, way, at_once),
        entered=entered,
        taken=_taken(layout, mode, pieces, way, at_once),
    )
    return arrived if noise is None else _settled(layout, arrived, way, width, noise)


def _share_behind(pieces: Pieces, binding: Binding | None) -> tuple[Floats, Floats]:
    """(p,) expected shares of the paths behind the guard, and 1 / (m1 - m0) (p,); 1 and 0 where one starts behind."""
    if binding is None:
        return np.ones(pieces.owner.size), np.zeros(pieces.owner.size)
    before, after = binding.along(pieces.mean.swapaxes(0, 1)) - binding.offset
    way = after - before
    within = (before < 0) & (way > SMALLEST_STD)
    per_way = within / np.where(within, way, 1.0)
    return np.where(within, after * per_way, 1.0), per_way


def _motion(automaton: HybridAutomaton, mode: ModeLayout, mean: Floats, u: Floats) -> Floats:
    """(n, p) displacement of a mode's whole step from states (n, p) with inputs (m, p)."""
    if not automaton.effects:
        return np.asarray(mode.mode.B @ u)
    return np.asarray(displaced(automaton, mode.mode, mean.T, u.T)[0].T)


def _pinned_at(mode: ModeLayout, pieces: Pieces, way: Exit, at_once: Booleans) -> Floats:
    """(n, p) where pieces that take an exit of a mode at once were pinned before; a reset moves them elsewhere."""
    if way.reset is not None or not np.count_nonzero(at_once):
        return np.full(pieces.pinned_at.shape, np.nan)
    pinned_at = np.where(at_once, pieces.pinned_at, np.nan)
    for pin in mode.mode.pins:
        place = pin.value if pin.follows is None else pin.value + pieces.mean[0, pin.follows]
        pinned_at[pin.coordinate] = np.where(at_once, place, np.nan)
    return pinned_at


def _taken(layout: Layout, mode: ModeLayout, pieces: Pieces, way: Exit, at_once: Booleans) -> Booleans:
    """`Pieces.taken` after an exit; none of a mode that was just entered."""
    if not way.is_self:
        return np.zeros((len(layout.modes[way.target].exits), pieces.owner.size), dtype=bool)
    taken = pieces.taken & at_once
    taken[mode.exits.index(way)] = True
    return np.asarray(taken)


def _freed(layout: Layout, source: ModeLayout, pieces: Pieces, way: Exit) -> tuple[Ints, Floats]:
    """Coordinates (c,) that had no noise in the mode before, and its std (c, p) or (c, 1) in a whole step."""
    if way.freed is not None:
        return way.freed
    modes = source.mode, layout.modes[way.target].mode
    old, new = (step_noise_std(layout.automaton, mode, pieces.u.T).T for mode in modes)
    fresh = np.where(old == 0.0, new, 0.0)
    coordinates = np.flatnonzero(fresh.any(axis=1))
    return coordinates, np.asarray(fresh[coordinates])


def _settled(layout: Layout, pieces: Pieces, way: Exit, column: int, noise: tuple[Ints, Floats]) -> Pieces:
    """The pieces in their new mode: pinned coordinates stand still and are known, freed ones get their process noise.

    A pin that the guard locates replaces what was known of its coordinate, any other pin adds to it.

    Args:
        pieces: with arrays of their own, which are written to; their factors have columns to fill from that number on.
        noise: of the freed coordinates.
    """
    target, mean, factor, displacement = layout.modes[way.target], pieces.mean, pieces.factor, pieces.displacement
    put_at_pins(mean[0], factor[0], way.located, column)
    for i in target.pinned:
        mean[1, i], factor[1, i], displacement[i] = mean[0, i], factor[0, i], 0.0
    for tie in target.mode.ties:
        weights, i = np.array(tie.weights), tie.coordinate
        mean[1, i], factor[1, i] = tie.offset + weights @ mean[1], weighted(weights, factor[1])
        displacement[i] = weights @ displacement
    coordinates, std = noise
    for number, i in enumerate(coordinates):
        factor[1, i, column + len(way.located) + number] += std[number] * pieces.fraction
    joint = 2 * len(displacement)
    if factor.shape[2] > _WIDEST * joint:
        factor = lower_factors(factor.reshape(joint, *factor.shape[2:])).reshape(*factor.shape[:2], joint, -1)
    if not way.met:
        return replace(pieces, factor=factor)
    means, factors = condition_on_pins(mean.reshape(joint, -1), factor.reshape(joint, *factor.shape[2:]), way.met)
    return replace(pieces, mean=means.reshape(mean.shape), factor=factors.reshape(factor.shape))
