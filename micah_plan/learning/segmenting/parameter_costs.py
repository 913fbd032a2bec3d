"""Parameter costs of joints: log ratio of prior to posterior volume (Laplace's approximation).

ln p(y | M) ≈ ln p(y | θ_fit) - 1/2 ln det(I + Σ₀ F), with the parameters' prior covariance Σ₀ and Fisher information F.
The term k/2 ln n of MICAH's ln L is its limit for many rows, but leaves out the information of one row: with wide
priors and a tracker precise to millimetres that is most of it.
"""

from __future__ import annotations

import numpy as np

from micah_plan.arrays import Booleans, Floats
from micah_plan.automaton.joint import KINDS, JointKind
from micah_plan.learning.joints.final_fit import PITCH, SCREW_COST
from micah_plan.learning.joints.joint_arrays import JointArrays
from micah_plan.learning.segmenting.noise import NoiseModel
from micah_plan.learning.segmenting.pool import Pool
from micah_plan.learning.segmenting.pool_fits import parameter_design
from micah_plan.learning.track import PartTrack

_SAMPLES = 10  # rows at which the information is looked at
_HELD_SHARE = 4  # a joint that explains so much of the recording may hold the part elsewhere on it
_IMPLAUSIBLE_KIND_NATS = (
    10.0  # nats: a joint without motion beyond noise is no joint; a rest with a motion in it, no rest
)
BLOCKS = 8  # in which rows are averaged to see whether anything moves
TRAVEL = 7.0  # a motion, in the noise of these means
_DRIFT = 14.0  # more than a tracker wanders during a rest, in the noise of these means
# Prior stds of `JointArrays.moved`'s step: turns [rad] and shifts [m] of both sides, pitch [m/rad].
_WIDTHS = np.array([1.0] * 12 + [PITCH])


def parameter_costs(pool: Pool, track: PartTrack, noise: NoiseModel, likelihood_power: float) -> tuple[Floats, Floats]:
    """(h,) costs of the hypotheses' parameters [nats], and the part of it for implausible kinds.

    Args:
        likelihood_power: power of the likelihood.
    """
    denied = _implausible_kind_cost(pool, noise)
    return _parameter_cost(pool, track, noise, likelihood_power) + denied, denied


def _parameter_cost(pool: Pool, track: PartTrack, noise: NoiseModel, likelihood_power: float) -> Floats:
    """(h,) log ratio of prior to posterior volume of the parameters, including the prior of joints [nats]."""
    joints, used = pool.hypotheses.joints, pool.hypotheses.used
    count = np.maximum(used.sum(axis=1), 1)
    # Evenly spaced ones among the used rows.
    ranks = (np.linspace(0, 1, _SAMPLES)[None] * (count - 1)[:, None]).round().astype(np.int64)
    order = np.argsort(~used, axis=1, kind="stable")
    index = np.take_along_axis(order, ranks, axis=1)
    design = parameter_design(joints, pool.seen.rows(index), track.position[index])
    scaling = noise.decorrelation * np.sqrt(noise.information_share / noise.left[:, -1])[:, None]
    widths = _WIDTHS[: design.shape[2]]
    flat = (scaling @ design.reshape(*design.shape[:2], -1)).reshape(design.shape) * widths[:, None]
    information = (flat @ flat.swapaxes(2, 3)).sum(axis=1) * (count / _SAMPLES)[:, None, None]
    narrower = np.linalg.slogdet(np.eye(len(widths)) + likelihood_power * information)[1]
    reach = np.where(joints.turning, np.linalg.norm(joints.position - joints.center, axis=1), 0.0)
    far = 0.5 * (reach**2 + (joints.pitch / PITCH) ** 2)
    return np.asarray(far + SCREW_COST * joints.twisting + 0.5 * narrower)


def held_costs(cost: Floats, denied: Floats, pool: Pool, noise: NoiseModel, likelihood_power: float) -> Floats:
    """(h,) costs with a discount for rigid poses on a moving joint of the pool: a part held on its path.

    Given the joint, the pose has only its configuration free, and the slow wander across it.
    """
    used = pool.hypotheses.used
    n = used.shape[1]
    joints = np.flatnonzero(pool.moving & (used.sum(axis=1) >= n / _HELD_SHARE))
    result = cost.copy()
    if not len(joints) or pool.moving.all():
        return result
    reach = np.ptp(pool.seen.configuration[joints], axis=1)
    information = likelihood_power * noise.information_share[0, :, None] * np.linalg.inv(noise.innovation[0])
    error, direction = pool.seen.error[joints], pool.seen.direction[joints]
    rigid = np.flatnonzero(~pool.moving)
    rows = [np.flatnonzero(used[i]) for i in rigid]
    missed_by = np.array([error[..., row].mean(axis=2) for row in rows])
    along = np.moveaxis(direction[..., [row[len(row) // 2] for row in rows]], 2, 0) * reach[:, None]
    prior = np.diag(noise.slow[0] + noise.white[0]) + along[..., :, None] * along[..., None, :]
    count = np.array([len(row) for row in rows])[:, None, None, None]
    size = np.linalg.slogdet(np.eye(prior.shape[-1]) + prior @ information * count)[1]
    missed = np.sum(missed_by * np.linalg.solve(prior, missed_by[..., None])[..., 0], axis=-1)
    result[rigid] = np.minimum(result[rigid], 0.5 * (size + missed).min(axis=1) + denied[rigid])
    return result


def _implausible_kind_cost(pool: Pool, noise: NoiseModel) -> Floats:
    """(h,) cost of a moving joint whose rows do not move beyond noise, or of a rigid one whose rows do [nats]."""
    used = pool.hypotheses.used
    rows = np.maximum(used.sum(axis=1), 1)[:, None]
    block = np.maximum(rows / BLOCKS, 1.0)
    inside, count = _blocks(used)
    travel = _span(inside, count, pool.seen.configuration[:, None])
    noises = np.sqrt(pool.along.white[:, None] / block + pool.along.renewed[:, None] * rows / BLOCKS / 3)
    travel = travel / np.where(pool.moving, noises[:, 0], 1.0)
    # The wander of a tracker goes on over all rows of a rest.
    drift = pool.seen.error / np.sqrt(noise.white / block + noise.renewed * rows)[..., None]
    drifts = [_span(inside, count, drift[:, i : i + 3]) for i in range(0, drift.shape[1], 3)]
    denied = np.where(pool.moving, travel < TRAVEL, np.max(drifts, axis=0) > _DRIFT)
    return np.asarray(_IMPLAUSIBLE_KIND_NATS * denied)


def _blocks(used: Booleans) -> tuple[Floats, Floats]:
    """(h, n, b) which block of the used rows (h, n) a row is in, 0 or 1; and (h, 1, b) how many rows a block has."""
    rows = np.maximum(used.sum(axis=1, keepdims=True), 1)
    block = np.minimum(BLOCKS * (np.cumsum(used, axis=1) - 1) // rows, BLOCKS - 1)
    inside = (used[..., None] & (block[..., None] == np.arange(BLOCKS))).astype(float)
    return inside, inside.sum(axis=1, keepdims=True)


def _span(inside: Floats, count: Floats, values: Floats) -> Floats:
    """(h,) how far apart the means of blocks lie, of values (h, d, n)."""
    means = values @ inside / np.maximum(count, 1)
    means = np.where(count > 0, means, means[..., :1])
    apart = ((means[..., :, None] - means[..., None, :]) ** 2).sum(axis=1)
    return np.asarray(np.sqrt(apart.max(axis=(1, 2))))


def parameter_counts(joints: JointArrays, has_orientation: bool) -> Floats:
    """(h,) k of the BIC term: the numbers that fix a joint and where on it the segment starts."""
    counts = {kind: float(parameter_count(kind, has_orientation)) for kind in set(joints.kinds)}
    return np.array([counts[kind] for kind in joints.kinds])


def parameter_count(kind: JointKind, has_orientation: bool) -> int:
    """k of the BIC term: the numbers that fix a joint and where on it the segment starts."""
    return (6 if has_orientation else 3) + len(KINDS[kind].parameters)
