"""CHAMP and Act-CHAMP, as the paper has them: when does the joint between two parts change, and into which joint?

Sources: Jain and Niekum, "Learning hybrid object kinematics for efficient hierarchical planning under uncertainty"
(MICAH), Sec. IV-A; Niekum et al., "Online Bayesian changepoint detection for articulated motion models", ICRA 2015
(CHAMP); Fearnhead and Liu, JRSS B 2007 (the recursion); Sturm et al., JAIR 2011 (the joints); Torr and Zisserman, CVIU
2000 (MLESAC). Everything is exact but for the lattice of rows on which a segment may begin: no particle filter.

Poses are positions (T, 3) [m] and rotations (T) of a part in the frame of the other one; an action (3,) is the
displacement [m] that is asked of the part's origin until the next row.
"""

# ruff: noqa: ARG001, ARG002 - joints and likelihoods have one signature each, whatever they need of it

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import gamma

Floats = NDArray[np.float64]


class Poses(NamedTuple):
    """Positions (T, 3) [m] and rotations (T)."""

    position: Floats
    rotation: Rotation

    def rows(self, chosen: slice | Sequence[int]) -> Poses:
        return Poses(self.position[chosen], self.rotation[chosen])


# -- joints: forward kinematics f(c) and its inverse, and the inverse Jacobian of an action


class Joint(Protocol):
    """A candidate model M with its parameters θ.

    Attributes:
        size: k_q, how many numbers θ are. fewest: rows that it can be fitted to. freedom: 1 if it moves, else 0.
    """

    name: str
    size: int
    fewest: int
    freedom: int

    def forward(self, c: Floats) -> Poses:
        """f: configurations (T,) -> poses."""

    def inverse(self, y: Poses) -> Floats:
        """f⁻¹: poses -> the nearest configurations (T,)."""

    def inverse_jacobian(self, c: Floats, a: Floats) -> Floats:
        """J⁻¹: actions (T, 3) at c (T,) -> changes of the configuration (T,)."""


@dataclass(frozen=True)
class Rigid:
    """The part stays where it is."""

    position: Floats
    rotation: Rotation
    name, size, fewest, freedom = "rigid", 6, 1, 0

    @classmethod
    def fitted(cls, y: Poses) -> Rigid:
        return cls(y.position.mean(axis=0), y.rotation.mean())

    def forward(self, c: Floats) -> Poses:
        return Poses(np.tile(self.position, (len(c), 1)), Rotation.concatenate([self.rotation] * len(c)))

    def inverse(self, y: Poses) -> Floats:
        return np.zeros(len(y.position))

    def inverse_jacobian(self, c: Floats, a: Floats) -> Floats:
        return np.zeros(len(c))


@dataclass(frozen=True)
class Prismatic:
    """The part slides along an axis (3,) through its position at c = 0 [m]."""

    axis: Floats
    position: Floats
    rotation: Rotation
    name, size, fewest, freedom = "prismatic", 8, 2, 1

    @classmethod
    def fitted(cls, y: Poses) -> Prismatic:
        middle = y.position.mean(axis=0)
        axis = np.linalg.svd(y.position - middle)[2][0]  # the direction of most variance
        return cls(axis, middle, y.rotation.mean())

    def forward(self, c: Floats) -> Poses:
        return Poses(self.position + c[:, None] * self.axis, Rotation.concatenate([self.rotation] * len(c)))

    def inverse(self, y: Poses) -> Floats:
        return np.asarray((y.position - self.position) @ self.axis)

    def inverse_jacobian(self, c: Floats, a: Floats) -> Floats:
        return np.asarray(a @ self.axis)


@dataclass(frozen=True)
class Revolute:
    """The part turns about an axis (3,) through a center (3,), from a position and a rotation at c = 0 [rad]."""

    axis: Floats
    center: Floats
    position: Floats
    rotation: Rotation
    name, size, fewest, freedom = "revolute", 10, 3, 1

    @classmethod
    def fitted(cls, y: Poses) -> Revolute:
        first = y.rotation[0]
        turns = y.rotation * first.inv()
        axis = np.linalg.svd(turns.as_rotvec())[2][0]
        # p_i = q + R_i (p_0 - q): linear in the center q, but for its place along the axis.
        matrix = np.concatenate([np.eye(3) - turn for turn in turns.as_matrix()])
        moved = np.concatenate(list(y.position - turns.apply(y.position[0])))
        center = np.linalg.lstsq(matrix, moved, rcond=1e-3)[0]
        center += ((y.position.mean(axis=0) - center) @ axis) * axis
        return cls(axis, center, y.position[0], first)

    def forward(self, c: Floats) -> Poses:
        turns = Rotation.from_rotvec(c[:, None] * self.axis)
        return Poses(self.center + turns.apply(self.position - self.center), turns * self.rotation)

    def inverse(self, y: Poses) -> Floats:
        arm = self.position - self.center
        side, up = np.cross(self.axis, arm), arm - (arm @ self.axis) * self.axis
        of_position = np.arctan2((y.position - self.center) @ side, (y.position - self.center) @ up)
        of_rotation = (y.rotation * self.rotation.inv()).as_rotvec() @ self.axis
        # The place on the circle is the better known of the two wherever the radius is more than a few centimetres.
        return np.asarray(of_position + 2 * np.pi * np.round((of_rotation - of_position) / (2 * np.pi)))

    def inverse_jacobian(self, c: Floats, a: Floats) -> Floats:
        arm = Rotation.from_rotvec(c[:, None] * self.axis).apply(self.position - self.center)
        velocity = np.cross(self.axis, arm)  # [m per rad]
        return np.asarray((a * velocity).sum(axis=1) / np.maximum(np.square(velocity).sum(axis=1), 1e-12))


JOINTS: tuple[type[Rigid] | type[Prismatic] | type[Revolute], ...] = (Rigid, Prismatic, Revolute)


# -- how likely poses are under a joint


@dataclass(frozen=True)
class Observed:
    """The observation model: y ~ Δ + N(0, Σ_y) or, with probability γ, anywhere in the volume; p(γ) ∝ exp(-w γ).

    Attributes:
        position, rotation: stds of a measured pose [m, rad].
        volume: side of the cube in which an outlier may be; travel: how far a joint may move its part [m].
        weight: w.
    """

    position: float
    rotation: float
    volume: float = 2.0
    travel: float = 0.5
    weight: float = 10.0

    def log_likelihood(self, y: Poses, predicted: Poses) -> float:
        """ln p(y | Δ̂) of all rows, with the likeliest share of outliers."""
        away = (y.position - predicted.position) / self.position
        turned = (y.rotation * predicted.rotation.inv()).as_rotvec() / self.rotation
        scale = 3 * np.log(self.position * self.rotation) + 3 * np.log(2 * np.pi)
        inlier = -0.5 * (np.square(away).sum(axis=1) + np.square(turned).sum(axis=1)) - scale
        outlier = -3 * np.log(self.volume) - np.log(8 * np.pi**2)
        return max(
            float(np.logaddexp(np.log1p(-share) + inlier, np.log(share) + outlier).sum()) - self.weight * share
            for share in (0.01, 0.05, 0.2)
        )


def act_champ(joint: Joint, y: Poses, a: Floats, noise: Observed) -> float:
    """ln p(y | M, θ, a): each row from the one before and its action, Δ̂_t = f(f⁻¹(y_{t-1}) + J⁻¹ a_{t-1})."""
    c = joint.inverse(y)[:-1]
    return noise.log_likelihood(y.rows(slice(1, None)), joint.forward(c + joint.inverse_jacobian(c, a[:-1])))


def champ(joint: Joint, y: Poses, a: Floats, noise: Observed) -> float:
    """ln p(y | M, θ) of poses alone: Δ̂_t = f(f⁻¹(y_t)), with each row's configuration anywhere on the way."""
    c = joint.inverse(y)
    likelihood = noise.log_likelihood(y, joint.forward(c))
    # ∫ N(y | f(c)) p(c) dc: the best c of each row, times the width of N over that of p.
    return likelihood + joint.freedom * len(c) * float(np.log(np.sqrt(2 * np.pi) * noise.position / noise.travel))


Method = Callable[[Joint, Poses, Floats, Observed], float]


def mlesac(kind: type, y: Poses, a: Floats, noise: Observed, method: Method, rng: np.random.Generator) -> Joint:
    """The joint of a kind that makes the rows likeliest, among those through a few drawn rows and one through all."""
    best, most = None, -np.inf
    draws = [np.arange(len(y.position))]
    draws += [np.sort(rng.choice(len(y.position), kind.fewest, replace=False)) for _ in range(4)]
    for rows in draws:
        joint = kind.fitted(y.rows(rows))
        likelihood = method(joint, y, a, noise)
        if best is None or likelihood > most:
            best, most = joint, likelihood
    return best


# -- the most probable changepoints


@dataclass(frozen=True)
class Segment:
    """Rows start to end (inclusive), and the joint that governs them."""

    start: int
    end: int
    joint: Joint


def segments(
    y: Poses,
    a: Floats,
    noise: Observed,
    method: Method = act_champ,
    *,
    mean_length: float = 40.0,
    stride: int = 3,
    shortest: int = 9,
    seed: int = 0,
) -> list[Segment]:
    """The MAP changepoints τ and joints.

    With β the distribution of a segment's length and B its cumulative,
    P_t(s, M) = (1 - B(t-s-1)) L(s, t, M) p(M) P^MAP_s and P^MAP_t = max_{s, M} β(t-s) / (1 - B(t-s-1)) P_t(s, M);
    ln L(s, t, M) = ln p(y_{s+1:t} | M, θ̂, a) - k_q / 2 ln(t - s) (BIC), θ̂ from MLESAC.

    Args:
        mean_length: of a segment [rows]; β is a gamma distribution of shape 2.
        stride: a segment begins at every so manieth row. shortest: segment [rows].
    """
    rng, rows = np.random.default_rng(seed), len(y.position)
    ends = [*range(0, rows - shortest + 1, stride), rows]
    length = gamma(2.0, scale=mean_length / 2.0)
    log_map, best = {0: 0.0}, dict[int, tuple[int, Joint]]()
    for t in ends[1:]:
        options = list[tuple[float, int, Joint]]()
        for s in (s for s in ends if s < t and s in log_map and t - s >= shortest):
            # All that P_t(s, M) and β / (1 - B) leave of the length: its probability or, of the last segment, survival.
            ended, open_end = length.cdf(t - s) - length.cdf(t - s - 1), length.sf(t - s - 1)
            log_length = np.log(max(open_end if t == rows else ended, 1e-300))
            part, acted = y.rows(slice(s, t)), a[s:t]
            for kind in JOINTS:
                joint = mlesac(kind, part, acted, noise, method, rng)
                evidence = method(joint, part, acted, noise) - 0.5 * joint.size * np.log(t - s)
                options.append((log_length + evidence - np.log(len(JOINTS)) + log_map[s], s, joint))
        if options:
            log_map[t], s, joint = max(options, key=lambda option: option[0])
            best[t] = s, joint
    path, t = list[Segment](), rows
    while t > 0:  # the Viterbi path, from the end
        s, joint = best[t]
        path.append(Segment(s, t - 1, joint))
        t = s
    return path[::-1]
