"""Kinematic chains of the handle: slides and hinges in sequence, fitted to poses and to the force odometer.

With s the path length of the handle [m], a joint rotates it by w per metre, from the direction t at its beginning; w =
0 is a slide, w normal to t a hinge with its axis along w at the distance 1/|w|. A joint continues where the one before
ends, at a path length that is fitted as well. Tracker and odometer determine each row's place along the chain; their
residuals are the components normal to it, and the orientations. Pose and force are fused in this way: where the hand's
force has a component that no friction explains, the handle did not move there.

Chains are compared by their evidence: Laplace's approximation, each under the noise of the tracker that it leaves.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import solveh_banded

from micah_plan.arrays import DIFFERENCE, Booleans, Floats

# What is known before of the numbers of a chain (std): turning [rad/m], where a joint takes over [m], its direction.
# The pose at s = 0 is common to all chains that are compared, so that its prior does not matter.
_RATE, _BEGIN, _DIRECTION, _POSE = 4.0, 0.1, 1.0, 1e3
# Noise of a tracker (std) per axis, of how many numbers that is worth, and what the odometer states of itself.
PLACE_STD, TURN_STD, PRIOR_ROWS = 0.002, 0.02, 4.0
_PRIOR_ROWS = np.array([PRIOR_ROWS, PRIOR_ROWS, 10.0])
_HUBER = 2.5
_SHORTEST, _NOWHERE = 0.01, 1e6  # m that a joint moves at least, otherwise it is play; nats against one that does not
_BACKTRACKING = (1.0, 0.3, 0.05)


@dataclass(frozen=True, eq=False)
class StepRows:
    """Observations of k rows: before the first step, and after each.

    Attributes:
        place: (k, 3) measured place of the handle [m]; NaN where not seen.
        turn: (k, 3, 3) its orientation; NaN where not seen.
        moved: (k - 1, 3) displacement by the odometer [m].
        moved_std: (k - 1,) its std per axis.
    """

    place: Floats
    turn: Floats
    moved: Floats
    moved_std: Floats

    def __len__(self) -> int:
        return len(self.place)

    @property
    def seen(self) -> Booleans:
        """(k,) rows in which the tracker saw the handle."""
        return np.asarray(np.isfinite(self.place).all(axis=1))


@dataclass(frozen=True, eq=False)
class Chain:
    """n joints in sequence that move the handle. Position to rate may have leading axes for batches of chains.

    Attributes:
        hinges: (n,) whether each joint is a hinge; otherwise it is a slide.
        place, turn: (3,) and (3, 3), pose of the handle at s = 0.
        begin: (n,) path length at which each joint begins [m]; 0 for the first, which also extends backwards.
        direction: (n, 3) unit vectors of the handle's motion there.
        rate: (n, 3) rotation per metre of path, normal to the direction; 0 for a slide.
        way: (k,) s of each row [m].
        place_std, turn_std: of the tracker, from the residuals [m, rad].
        moved_share: std of the odometer, relative to its own estimate.
        covariance: of the numbers, in the order of `numbers`.
        loss: negative log likelihood of the rows [nats].
        evidence: log evidence against other chains for the same rows [nats].
    """

    hinges: tuple[bool, ...]
    place: Floats
    turn: Floats
    begin: Floats
    direction: Floats
    rate: Floats
    way: Floats
    place_std: float = PLACE_STD
    turn_std: float = TURN_STD
    moved_share: float = 1.0
    covariance: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    loss: float = 0.0
    evidence: float = 0.0

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kind of each joint."""
        return tuple("revolute" if hinge else "prismatic" for hinge in self.hinges)

    def poses(self, way: Floats) -> tuple[Floats, Floats, Floats]:
        """Positions (..., k, 3), orientations (..., k, 3, 3) and tangents (..., k, 3) at distances s (k,) along the
        chain.
        """
        places, turns = self.place[..., None, :], self.turn[..., None, :, :]
        ends = np.concatenate([self.begin[..., 1:], np.full((*self.begin.shape[:-1], 1), np.inf)], axis=-1)
        tangents = np.zeros(3)
        for i in range(len(self.hinges)):
            begin, end = self.begin[..., i, None], ends[..., i, None]
            s = np.minimum(way, end) if i == 0 else np.clip(way, begin, end) - begin
            moved, turned, along = _carried(self.direction[..., i, :], self.rate[..., i, :], s)
            places, turns = places + moved, turned @ turns
            tangents = along if i == 0 else np.where((way >= begin)[..., None], along, tangents)
        return places, turns, tangents

    def numbers(self) -> tuple[Floats, Floats]:
        """Free parameters: (p, q) directions of change for `changed`, and (p,) their prior stds.

        The place along the first direction is not one of them: the first row is at 0.
        """
        n = len(self.hinges)
        every = np.eye(6 + 7 * n)
        pose = every[:5].copy()
        pose[:2, :3] = _normal_to(self.direction[0])
        pose[2:] = every[3:6]
        parts, free = [pose, every[7 : 6 + n]], [np.full(5, _POSE), np.full(n - 1, _BEGIN)]
        for i, hinge in enumerate(self.hinges):
            both = np.stack(_normal_to(self.direction[i]))
            parts.append(both @ every[6 + n + 3 * i : 9 + n + 3 * i])
            free.append(np.full(2, _DIRECTION))
            if hinge:
                parts.append(both @ every[6 + 4 * n + 3 * i : 9 + 4 * n + 3 * i])
                free.append(np.full(2, _RATE))
        return np.concatenate(parts), np.concatenate(free)

    def changed(self, by: Floats) -> Chain:
        """The chain with small changes (..., q): place 3, turn 3, begin n, direction 3 n, rate 3 n."""
        n = len(self.hinges)
        place, turn, begin, direction, rate = np.split(by, [3, 6, 6 + n, 6 + 4 * n], axis=-1)
        direction = self.direction + direction.reshape(*by.shape[:-1], n, 3)
        direction = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
        return replace(
            self,
            place=self.place + place,
            turn=_rotations(turn, np.ones((*by.shape[:-1], 1)))[..., 0, :, :] @ self.turn,
            begin=self.begin + begin,
            direction=direction,
            rate=_across(self.rate + rate.reshape(*by.shape[:-1], n, 3), direction),
        )

    def ahead(self, way: float) -> tuple[Floats, Floats]:
        """(tangent (3,) at a distance, its derivatives (p, 3) by the free parameters)."""
        here = self.poses(np.array([way]))[2][0]
        return here, (self.changed(DIFFERENCE * self.numbers()[0]).poses(np.array([way]))[2][:, 0] - here) / DIFFERENCE


def _normal_to(direction: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors (3,) normal to a direction and each other."""
    offset = np.zeros(3)
    offset[int(np.argmin(np.abs(direction)))] = 1.0
    first = np.cross(direction, offset)
    first = first / np.linalg.norm(first)
    return first, np.cross(direction, first)


def _trigonometric_series(rate: Floats, s: Floats) -> tuple[Floats, Floats, Floats]:
    """cos(a), s sin(a) / a and s² (1 - cos a) / a², (..., k, 1) each, for angles a = |w| s; smooth at w = 0."""
    angle = np.linalg.norm(rate, axis=-1)[..., None] * s / np.pi
    values = np.cos(np.pi * angle), s * np.sinc(angle), 0.5 * s**2 * np.sinc(0.5 * angle) ** 2
    return values[0][..., None], values[1][..., None], values[2][..., None]


def _rotations(rate: Floats, s: Floats) -> Floats:
    """(..., k, 3, 3) rotations by w s (Rodrigues), for rates (..., 3) and distances (..., k)."""
    x, y, z = rate[..., 0], rate[..., 1], rate[..., 2]
    zero = np.zeros_like(x)
    hat = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*x.shape, 1, 3, 3)
    _, first, second = _trigonometric_series(rate, s)
    return np.asarray(np.eye(3) + first[..., None] * hat + second[..., None] * (hat @ hat))


def _carried(direction: Floats, rate: Floats, s: Floats) -> tuple[Floats, Floats, Floats]:
    """Displacements, rotations and tangents at distances s (..., k) along a joint."""
    cosine, first, second = _trigonometric_series(rate, s)
    side, straight = np.cross(rate, direction)[..., None, :], direction[..., None, :]
    return first * straight + second * side, _rotations(rate, s), cosine * straight + first * side


def _with_placed_rows(chain: Chain, rows: StepRows) -> Chain:
    """The chain with each row at its most probable distance given tracker and odometer: a tridiagonal system."""
    places, _, tangents = chain.poses(chain.way)
    is_seen = rows.seen
    off = np.where(is_seen, np.einsum("ij,ij->i", np.nan_to_num(rows.place) - places, tangents), 0.0)
    chord = _chords(tangents)
    step = np.einsum("ij,ij->i", rows.moved, chord) - np.einsum("ij,ij->i", np.diff(places, axis=0), chord)
    tracker, odometer = is_seen / chain.place_std**2, 1.0 / (chain.moved_share * rows.moved_std) ** 2
    diagonal = tracker + 1e-9
    diagonal[:-1] += odometer
    diagonal[1:] += odometer
    right = tracker * off
    right[:-1] -= odometer * step
    right[1:] += odometer * step
    band = np.stack([np.append(0.0, -odometer), diagonal])
    way = chain.way + np.clip(solveh_banded(band, right), -0.1, 0.1)
    place, turn, tangent = (values[0] for values in chain.poses(way[:1]))
    begin = np.append(0.0, chain.begin[1:] - way[0])
    direction = np.concatenate([tangent[None], chain.direction[1:]])
    return replace(chain, place=place, turn=turn, begin=begin, direction=direction, way=way - way[0])


def _residuals(chain: Chain, rows: StepRows) -> tuple[Floats, Floats, Floats]:
    """Residuals in stds: positions (k, 3) and steps (k - 1, 3) normal to the path, and orientations (k, 3)."""
    places, turns, tangents = chain.poses(chain.way)
    is_seen = rows.seen[:, None]
    off = np.where(is_seen, np.nan_to_num(rows.place) - places, 0.0) / chain.place_std
    turned = np.where(is_seen, _vectors(np.nan_to_num(rows.turn) @ turns.transpose(0, 2, 1)), 0.0) / chain.turn_std
    step = (rows.moved - np.diff(places, axis=0)) / (chain.moved_share * rows.moved_std[:, None])
    return _across(off, tangents), turned, _across(step, _chords(tangents))


def _weights(residual: Floats) -> Floats:
    """(k, 1) square roots of Huber weights of residuals (k, 3)."""
    size = np.linalg.norm(residual, axis=1)
    return np.asarray(np.sqrt(np.minimum(1.0, _HUBER / np.maximum(size, 1e-12)))[:, None])


def _stacked(chain: Chain, rows: StepRows) -> Floats:
    """(r,) weighted residuals of all rows, then the prior's."""
    parts = [(_weights(part) * part).ravel() for part in _residuals(chain, rows)]
    return np.concatenate([*parts, chain.rate.ravel() / _RATE])


def fitted(chain: Chain, rows: StepRows, rounds: int = 1) -> Chain:
    """The maximum-likelihood chain of these kinds, from a guess whose `way` may be shorter than the rows.

    Args:
        rounds: of placing the rows along the path and refining the chain; one is enough from a good guess.
    """
    missing = len(rows) - len(chain.way)
    if missing > 0:
        tangent = chain.poses(chain.way[-1:])[2][0]
        chain = replace(chain, way=np.append(chain.way, chain.way[-1] + np.cumsum(rows.moved[-missing:] @ tangent)))
    chain = _with_placed_rows(chain, rows)
    for _ in range(rounds):
        chain, change = _improved(chain, rows)
        chain = _with_estimated_noise(_with_placed_rows(chain, rows), rows)
        if change < 1e-4:
            break
    return _with_evidence(chain, rows)


def _improved(chain: Chain, rows: StepRows) -> tuple[Chain, float]:
    """(chain after one damped Gauss-Newton step, largest change)."""
    here, (steps, free) = _stacked(chain, rows), chain.numbers()
    slope = _slope(chain, rows, steps)
    change = -np.linalg.solve(slope.T @ slope + np.diag(free**-2.0), slope.T @ here)
    for share in _BACKTRACKING:
        tried = chain.changed(share * change @ steps)
        after = _stacked(tried, rows)
        if after @ after <= here @ here + 1e-9:
            return tried, share * float(np.abs(change).max())
    return chain, 0.0


def _slope(chain: Chain, rows: StepRows, steps: Floats) -> Floats:
    """(r, p) derivative of the stacked residuals by the free parameters, at fixed tangents."""
    places, turns, tangents = chain.poses(chain.way)
    tried = chain.changed(DIFFERENCE * steps)
    moved, turned, _ = tried.poses(chain.way)
    shifts, spins = (moved - places) / DIFFERENCE, _vectors(turned @ turns.transpose(0, 2, 1)) / DIFFERENCE
    off, turned_off, step_off = _residuals(chain, rows)
    is_seen = rows.seen[:, None]
    place = np.where(is_seen, _weights(off), 0.0) / chain.place_std * _across(shifts, tangents)
    turn = np.where(is_seen, _weights(turned_off), 0.0) / chain.turn_std * spins
    step = np.diff(shifts, axis=1)
    way = _weights(step_off) / (chain.moved_share * rows.moved_std[:, None]) * _across(step, _chords(tangents))
    rate = (chain.rate - tried.rate) / (DIFFERENCE * _RATE)
    return -np.concatenate([part.reshape(len(steps), -1) for part in (place, turn, way, rate)], axis=1).T


def _across(vectors: Floats, directions: Floats) -> Floats:
    """Components of vectors (..., 3) across unit directions (..., 3)."""
    return np.asarray(vectors - (vectors * directions).sum(axis=-1, keepdims=True) * directions)


def _chords(tangents: Floats) -> Floats:
    """(k - 1, 3) unit directions between neighbouring tangents."""
    chord = tangents[:-1] + tangents[1:]
    return np.asarray(chord / np.maximum(np.linalg.norm(chord, axis=1), 1e-9)[:, None])


def _vectors(matrices: Floats) -> Floats:
    """(..., 3) rotation vectors of small rotations (..., 3, 3)."""
    m = matrices
    return 0.5 * np.stack(
        [m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]], axis=-1
    )


def _with_estimated_noise(chain: Chain, rows: StepRows) -> Chain:
    """The chain with noise scales of tracker and odometer from its residuals, and its likelihood."""
    rows_seen = int(rows.seen.sum())
    parts = _residuals(chain, rows)
    off, turned, step = (np.square(_weights(part) * part).sum() for part in parts)
    # The pose at s = 0 takes three of each of the tracker's numbers.
    count = np.maximum([2.0 * rows_seen - 3.0, 3.0 * rows_seen - 3.0, 2.0 * len(parts[2])], 0.0)
    variances = np.array([off * chain.place_std**2, turned * chain.turn_std**2, step * chain.moved_share**2])
    variance = (_PRIOR_ROWS * np.square([PLACE_STD, TURN_STD, 1.0]) + variances) / (_PRIOR_ROWS + count)
    place_std, turn_std, moved_share = (float(std) for std in np.sqrt(variance))
    loss = 0.5 * float((_PRIOR_ROWS + count) @ np.log(variance))
    return replace(chain, place_std=place_std, turn_std=turn_std, moved_share=moved_share, loss=loss)


def _with_evidence(chain: Chain, rows: StepRows) -> Chain:
    """The chain with covariance and log evidence; a joint shorter than its play gets none."""
    steps, free = chain.numbers()
    slope = _slope(chain, rows, steps)  # of the rates' prior too
    precision = slope.T @ slope + np.diag(np.where(free == _RATE, 0.0, free**-2.0))
    before = 0.5 * float(np.square(chain.rate).sum()) / _RATE**2
    evidence = -chain.loss - before - float(np.log(free).sum()) - 0.5 * float(np.linalg.slogdet(precision)[1])
    if len(chain.hinges) > 1 and np.diff(np.append(chain.begin, chain.way.max())).min() < _SHORTEST:
        evidence -= _NOWHERE
    return replace(chain, covariance=np.linalg.inv(precision), evidence=evidence)


def oriented_outwards(chain: Chain) -> Chain:
    """The chain oriented so that its distance grows toward the farthest point."""
    if chain.way.max() >= -chain.way.min() or len(chain.hinges) > 1:
        return chain
    return replace(chain, direction=-chain.direction, rate=-chain.rate, way=-chain.way)
