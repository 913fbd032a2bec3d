"""Belief over motions of the handle: directions, thresholds, and friction under side forces.

A hypothesis: the handle can move along t (and not back), once the pull along t exceeds a threshold τ (dry friction, or
additionally a latch) by more than μ times the force across; or it is fixed. Every push is informative, also those
without motion.

With c the compliance of the hand [m/N] and v its lead (equilibrium minus handle [m]), the handle moves as soon as v·t -
μ |v - (v·t) t| > c τ, and then by a distance between the excess and v·t, since friction in motion may be less.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from micah_plan.arrays import Floats

# A handle that is fast may still give: play of the joint and of the grip, a panel that bends. So often, and so far [m],
# and at most by that share of the lead.
_YIELDING_SHARE, _PLAY, _BENDS = 0.15, 0.003, 0.35
_OUTLIER = 1e-6
_SIDE_FRICTION = np.array([0.05, 0.35])
# Prior of what holds a handle at rest: [N], median and spread of dry friction, and the range of latches.
_FRICTION, _FRICTION_SPREAD, _LATCHES = 3.0, 0.6, (6.0, 60.0)
_SHARE_FRICTION, _SHARE_LATCHED = 0.65, 0.25


@dataclass(frozen=True, eq=False)
class Moves:
    """Weighted hypotheses; an infinite threshold means a stuck handle, which may yield elastically.

    Attributes:
        direction: (n, 3) unit vectors, base frame.
        threshold: (n,) [N].
        side: (n,) friction coefficient of the force across.
        weight: (n,) probabilities.
    """

    direction: Floats
    threshold: Floats
    side: Floats
    weight: Floats

    @property
    def p_stuck(self) -> float:
        """Probability that the handle is stuck."""
        return float(self.weight[np.isinf(self.threshold)].sum())

    def leads_to_move(self, directions: Floats, compliance: float) -> Floats:
        """(k, n) smallest lead [m] along k unit directions that moves each hypothesis; infinite if none."""
        along = directions @ self.direction.T
        across = np.sqrt(np.maximum(1.0 - along**2, 0.0))
        effective = along - self.side * across
        with np.errstate(divide="ignore"):
            return np.where(effective > 0.05, compliance * self.threshold / np.maximum(effective, 0.05), np.inf)

    def updated(self, lead: Floats, moved: Floats, std: float, compliance: float) -> Moves:
        """The belief after a push with a lead (3,) and a measured displacement (3,) with std [m]."""
        along, shift = self.direction @ lead, self.direction @ moved
        across = np.sqrt(np.maximum(lead @ lead - along**2, 0.0))
        excess = along - self.side * across - compliance * self.threshold
        off = np.maximum(moved @ moved - shift**2, 0.0)
        normal = np.exp(-0.5 * off / std**2) / std**2
        far = np.where(np.isfinite(excess), np.maximum(along - excess, std), std)
        goes = (ndtr((along - shift) / std) - ndtr((np.maximum(excess, 0.0) - shift) / std)) / far
        rests = _at_rest(lead, moved, std)
        floor = _OUTLIER / std**3
        likelihood = np.where(excess > 0.0, normal * goes, rests) + floor
        weight = self.weight * likelihood
        return replace(self, weight=weight / weight.sum())

    def likely_directions(self, count: int = 4) -> Floats:
        """((k, 3) directions of the most probable hypotheses), preceded by their mean if they agree."""
        mean = self.weight @ self.direction
        size = float(np.linalg.norm(mean))
        heaviest = self.direction[np.argpartition(-self.weight, count)[:count]]
        return np.concatenate([[mean / size], heaviest]) if size > 0.5 else heaviest


def _at_rest(lead: Floats, moved: Floats, std: float) -> float:
    """Density of a displacement (3,) at rest: none, or elastic yielding in the direction of the push."""
    size, squared = float(np.linalg.norm(lead)), float(moved @ moved)
    none = math.exp(-0.5 * squared / std**2) / (std**3 * math.sqrt(2 * math.pi))
    if size == 0.0:
        return none
    shift = float(moved @ lead) / size
    normal = math.exp(-0.5 * max(squared - shift**2, 0.0) / std**2) / std**2
    room = max(min(_PLAY, _BENDS * size), std)
    gives = float(ndtr((room - shift) / std) - ndtr((-room - shift) / std)) / (2 * room)
    return (1 - _YIELDING_SHARE) * none + _YIELDING_SHARE * normal * gives


def sphere(count: int) -> Floats:
    """(count, 3) unit vectors spread evenly (Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    height, angle = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    ring = np.sqrt(1.0 - height**2)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1)


def compass() -> Floats:
    """(26, 3) unit vectors to the faces, edges and corners of a cube."""
    grid = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3).astype(float)
    grid = grid[np.abs(grid).sum(axis=1) > 0]
    return np.asarray(grid / np.linalg.norm(grid, axis=1)[:, None])


def prior_moves(turn: Floats, mass: float = 1.0, friction: float = _FRICTION, count: int = 240) -> Moves:
    """The prior: uniform directions; friction or a latch holds the handle, or it is stuck.

    Args:
        turn: (3, 3) orientation of the handle, with which the directions turn, so that the answer does.
        mass: of the whole.
        friction: expected of it [N].
    """
    thresholds = np.geomspace(1.0, _LATCHES[1], 12)
    logs = np.log(thresholds)
    dry = np.exp(-0.5 * ((logs - np.log(friction)) / _FRICTION_SPREAD) ** 2)
    latched = (thresholds >= _LATCHES[0]).astype(float)
    prior = _SHARE_FRICTION * dry / dry.sum() + _SHARE_LATCHED * latched / latched.sum()
    thresholds, prior = np.append(thresholds, np.inf), np.append(prior, 1.0 - _SHARE_FRICTION - _SHARE_LATCHED)
    number, level, side = (
        a.ravel() for a in np.meshgrid(np.arange(count), np.arange(len(thresholds)), np.arange(2), indexing="ij")
    )
    weight = mass * prior[level] / (count * 2)
    return Moves((sphere(count) @ turn.T)[number], thresholds[level], _SIDE_FRICTION[side], weight)


def moves_after_motion(tangents: Floats, friction: float, turn: Floats, change: float) -> Moves:
    """The belief after a motion: it continues along the path against similar friction, or all is new.

    Args:
        tangents: (k, 3) equally probable directions of motion.
        friction: that held it last [N].
        change: probability that the previous force no longer moves it.
    """
    ratio = np.geomspace(0.5, 4.0, 8)
    prior = np.exp(-0.5 * ((np.log(ratio) - np.log(1.1)) / 0.3) ** 2) + 0.02
    number, level, side = (
        a.ravel() for a in np.meshgrid(np.arange(len(tangents)), np.arange(len(ratio)), np.arange(2), indexing="ij")
    )
    weight = (1.0 - change) * (prior / prior.sum())[level] / (len(tangents) * 2)
    new = prior_moves(turn, change, max(friction, 1.0))
    back = new.direction @ tangents.mean(axis=0) < -0.5  # whence it came
    new = replace(new, weight=np.where(back, 0.0, new.weight))
    return Moves(
        np.concatenate([tangents[number], new.direction]),
        np.concatenate([max(friction, 0.5) * ratio[level], new.threshold]),
        np.concatenate([_SIDE_FRICTION[side], new.side]),
        np.concatenate([weight, new.weight]),
    )
