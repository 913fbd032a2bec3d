"""A Gaussian on its way through one step: where guards cut it, and what a transition makes of the part that crosses.

As in the automaton's own transition logic, a step is a straight path from a start to an end, an event lies where the
path meets the guard, and the rest of the step follows the new mode. So what travels is the joint Gaussian of start and
end, (2n,), and an event maps it to the joint Gaussian of the event's state and the new end.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scalar_belief.scalar_gaussian import FAR_STDS, SMALLEST_STD, condition_on_pins, lower_factor, replaced_at_pins
from scalar_belief.scalar_truncation import Part, split

from micah_plan.automaton.effects.motion import displaced
from micah_plan.automaton.hybrid import Edge, HybridAutomaton
from micah_plan.automaton.region import HalfSpace
from micah_plan.automaton.step_noise import step_noise_std

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Piece:
    """A share of the belief on its way.

    Attributes:
        mode: name of the mode that it moves in.
        probability: of the share.
        mean: (2n,) of start and end of what is left of the step.
        factor: (2n, K) square root of their joint covariance.
        fraction: expected share of the step that is left.
        displacement: (n,) nominal motion from start to end, without noise.
        events: how many transitions it took in this step.
        held: (n,) where the modes that it left at the present instant held its coordinates; NaN: they did not.
        entered: modes that it was in at the present instant; none is entered twice at one instant (no chattering).
    """

    mode: str
    probability: float
    mean: Floats
    factor: Floats
    fraction: float
    displacement: Floats
    held: Floats
    events: int = 0
    entered: frozenset[str] = frozenset()

    @property
    def n(self) -> int:
        return len(self.displacement)

    def end(self) -> tuple[Floats, Floats]:
        """Mean (n,) and square root (n, K) of the covariance at the end of the step."""
        return self.mean[self.n :], self.factor[self.n :]


def whole_step(
    automaton: HybridAutomaton, mode_name: str, probability: float, mean: Floats, factor: Floats, u: Floats
) -> Piece:
    """The full step of a mode's Gaussian: flow and process noise, guards not yet applied."""
    mode = automaton.mode(mode_name)
    n = mean.size
    displacement, slope = displaced(automaton, mode, mean, u)
    noise = step_noise_std(automaton, mode, u) * np.eye(n)
    for tie in mode.ties:
        noise[tie.coordinate] = np.array(tie.weights) @ noise
    joint = np.block([[factor, np.zeros((n, n))], [slope[:, None] * factor, noise]])
    for tie in mode.ties:
        weights = np.array(tie.weights)
        displacement[tie.coordinate] = weights @ displacement
        joint[n + tie.coordinate] = weights @ joint[n:]
    ends = np.concatenate([mean, mean + displacement])
    nowhere = np.full(n, np.nan)
    return Piece(mode_name, probability, ends, joint, 1.0, displacement, nowhere, entered=frozenset([mode_name]))


def cross(automaton: HybridAutomaton, piece: Piece, edge: Edge, u: Floats) -> tuple[Piece | None, Piece | None]:
    """What takes the edge (already in its target, with the rest of the step to go) and what does not."""
    on_state = [h for h in edge.guard.half_spaces if h.on_state]
    on_input = [h for h in edge.guard.half_spaces if not h.on_state]
    blocked = edge.target in piece.entered and not edge.is_self_transition
    if blocked or not all(_holds(h, u) for h in on_input):
        return None, piece
    if not on_state:
        return _event(automaton, replace(piece, events=piece.events + 1), edge, u, None), None
    if piece.events and not _is_met_by_mean(piece, on_state, u):
        return None, piece
    if not _is_near(piece, on_state, u):
        return None, piece
    taken, left = _cut(piece, on_state, u)
    crossing = replace(
        piece,
        probability=piece.probability * taken.probability,
        mean=taken.mean,
        factor=taken.factor,
        events=piece.events + 1,
    )
    staying = replace(piece, probability=piece.probability * left.probability, mean=left.mean, factor=left.factor)
    if taken.probability <= 0.0:
        return None, staying
    binding = _binding(piece, on_state, u)
    return _event(automaton, crossing, edge, u, binding), staying if left.probability > 0.0 else None


def _holds(half_space: HalfSpace, u: Floats) -> bool:
    margin = float(np.array(half_space.b) @ u - half_space.c)
    return margin > 0 or (margin == 0 and not half_space.strict)


def _is_near(piece: Piece, half_spaces: list[HalfSpace], u: Floats) -> bool:
    """Whether the piece can be inside every half-space at the start or the end, with more than a share of 1e-15."""
    for half_space in half_spaces:
        margins = [
            (weights @ piece.mean - offset, weights @ piece.factor) for weights, offset in _rows(half_space, piece, u)
        ]
        if all(margin < -FAR_STDS * (np.linalg.norm(root) + SMALLEST_STD) for margin, root in margins):
            return False
    return True


def _is_met_by_mean(piece: Piece, half_spaces: list[HalfSpace], u: Floats) -> bool:
    """Whether the mean is inside the guard or moves towards it.

    Within a step only the first event may be due to noise: after it, the tails of what crossed are those of a fit. And
    what was just held lies where it was held: how well that place is known does not put it behind a guard that begins
    there.
    """
    margins = np.array([[weights @ piece.mean - offset for weights, offset in _rows(h, piece, u)] for h in half_spaces])
    start = np.where(np.isnan(piece.held), piece.mean[: piece.n], piece.held)
    is_inside = all(float(h.margin(start, u)) > SMALLEST_STD for h in half_spaces)
    return is_inside or bool((margins[:, 1] - margins[:, 0] > SMALLEST_STD).any())


def _rows(half_space: HalfSpace, piece: Piece, u: Floats) -> tuple[tuple[Floats, float], tuple[Floats, float]]:
    """The margins at start and end as affine functions of the joint state."""
    a, nothing = np.array(half_space.a), np.zeros(piece.n)
    offset = half_space.c - float(np.array(half_space.b) @ u)
    return (np.concatenate([a, nothing]), offset), (np.concatenate([nothing, a]), offset)


def _binding(piece: Piece, half_spaces: list[HalfSpace], u: Floats) -> HalfSpace:
    """The half-space that holds last: the one whose margin at the start is worst."""

    def worst(half_space: HalfSpace) -> float:
        (weights, offset), _ = _rows(half_space, piece, u)
        return float((weights @ piece.mean - offset) / (np.linalg.norm(weights @ piece.factor) + SMALLEST_STD))

    return min(half_spaces, key=worst)


def _cut(piece: Piece, half_spaces: list[HalfSpace], u: Floats) -> tuple[Part, Part]:
    """The share within all half-spaces, entering through the binding one: at the end, or on the way where it leaves.

    For several half-spaces the probability is the product of those of one after the other, each given the ones
    before, and what stays keeps the moments of the whole (the complement of a corner is no half-space).
    """
    binding = _binding(piece, half_spaces, u)
    taken, left = split(piece.mean, piece.factor, *_rows(binding, piece, u))
    if len(half_spaces) == 1:
        return taken, left
    probability = taken.probability
    for half_space in half_spaces:
        if half_space is binding or probability <= 0.0:
            continue
        (before, offset), (after, _) = _rows(half_space, piece, u)
        at = 1.0
        if (after - before) @ taken.mean < 0.0:
            starts, ends = (weights @ taken.mean - c for weights, c in _rows(binding, piece, u))
            at = 0.0 if starts >= 0.0 else min(1.0, -starts / max(ends - starts, 1e-30))
        there = (1.0 - at) * before + at * after, offset
        never = (np.zeros_like(before), 1.0)
        inner, _ = split(taken.mean, taken.factor, never, there)
        probability *= inner.probability
        taken = inner
    return Part(probability, taken.mean, taken.factor), Part(1.0 - probability, piece.mean, piece.factor)


def _event(automaton: HybridAutomaton, piece: Piece, edge: Edge, u: Floats, binding: HalfSpace | None) -> Piece:
    """The piece after the transition: reset where the path meets the guard, then the new mode's motion.

    With r the share of the path behind the guard, r = m1 / (m1 - m0) is linearised about the means, as are its products
    with the motion; for a sharp belief or a motion large against its noise this is exact.
    """
    n, motion = piece.n, piece.mean[piece.n :] - piece.mean[: piece.n]
    a, b, c = edge.reset.matrices(n, u.size)
    share, slope = _share_behind(piece, binding, u)
    start, end = np.eye(n, 2 * n), np.eye(n, 2 * n, n)
    behind_mean, behind = share * motion, share * (end - start) + np.outer(motion, slope)
    met_mean, met = piece.mean[n:] - behind_mean, end - behind
    new_start_mean, new_start = a @ met_mean + b @ u + c, a @ met
    if edge.is_self_transition:
        displacement = share * (a @ piece.displacement)
        new_end_mean, new_end = new_start_mean + a @ behind_mean, new_start + a @ behind
    else:
        nominal = piece.fraction * displaced(automaton, automaton.mode(edge.target), new_start_mean, u)[0]
        change = nominal - piece.displacement
        displacement = share * nominal
        new_end_mean = new_start_mean + behind_mean + share * change
        new_end = new_start + behind + np.outer(change, slope)
    mean = np.concatenate([new_start_mean, new_end_mean])
    factor = np.vstack([new_start, new_end]) @ piece.factor
    at_once = share > 1.0 - 1e-9
    arrived = replace(
        piece,
        mode=edge.target,
        mean=mean,
        factor=factor,
        fraction=share * piece.fraction,
        displacement=displacement,
        held=_held(automaton, piece, edge) if at_once else np.full(n, np.nan),
        entered=(piece.entered if at_once else frozenset([edge.source])) | {edge.target},
    )
    return arrived if edge.is_self_transition else _entered(automaton, arrived, edge, u)


def _held(automaton: HybridAutomaton, piece: Piece, edge: Edge) -> Floats:
    """(n,) where a piece that takes an edge at once was held before; a reset moves it elsewhere."""
    if not edge.reset.is_identity:
        return np.full(piece.n, np.nan)
    held = piece.held.copy()
    for pin in automaton.mode(edge.source).pins:
        held[pin.coordinate] = pin.value + (0.0 if pin.follows is None else piece.mean[pin.follows])
    return held


def _share_behind(piece: Piece, binding: HalfSpace | None, u: Floats) -> tuple[float, Floats]:
    """Expected share of the path behind the guard and its gradient (2n,) by the joint state; 1 if it starts behind."""
    constant = np.zeros(2 * piece.n)
    if binding is None:
        return 1.0, constant
    (weights0, offset), (weights1, _) = _rows(binding, piece, u)
    before, after = weights0 @ piece.mean - offset, weights1 @ piece.mean - offset
    if before >= 0 or after - before <= SMALLEST_STD:
        return 1.0, constant
    share = float(after / (after - before))
    return share, (weights1 - share * (weights1 - weights0)) / (after - before)


def _entered(automaton: HybridAutomaton, piece: Piece, edge: Edge, u: Floats) -> Piece:
    """The piece in its new mode: held coordinates stand still and are known, freed ones get their process noise.

    A pin that the guard locates replaces what was known of its coordinate, any other pin adds to it.
    """
    n = piece.n
    source, target = automaton.mode(edge.source), automaton.mode(edge.target)
    located = automaton.pins_located_by(edge)
    mean, factor = replaced_at_pins(piece.mean, lower_factor(piece.factor), located)
    displacement = piece.displacement.copy()
    for pin in target.pins:
        mean[n + pin.coordinate], factor[n + pin.coordinate] = mean[pin.coordinate], factor[pin.coordinate]
        displacement[pin.coordinate] = 0.0
    for tie in target.ties:
        weights, i = np.array(tie.weights), tie.coordinate
        mean[n + i], factor[n + i] = tie.offset + weights @ mean[n:], weights @ factor[n:]
        displacement[i] = weights @ displacement
    old, new = (step_noise_std(automaton, mode, u) for mode in (source, target))
    noise = np.vstack([np.zeros((n, n)), np.diag(piece.fraction * np.where(old == 0, new, 0.0))])
    factor = lower_factor(np.hstack([factor, noise]))
    mean, factor = condition_on_pins(mean, factor, automaton.pins_met_by(edge))
    return replace(piece, mean=mean, factor=factor, displacement=displacement)
