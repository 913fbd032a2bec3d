"""Detection of rests: all intervals at which a joint was held, from actions without motion.

In every step the part either follows the action along the joint, approximately, or it is held and does not move; this
is a hidden state that rarely changes. A filter of the configuration weighs the two row by row (generalised pseudo-Bayes
of first order), and a backward pass smooths them. The action channel is fitted to the steps that followed, by
expectation maximisation starting from the steps that moved: with pushes against a stop among them, the actions would
seem uninformative, and no stop would be found.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, log

import numpy as np

from micah_plan.arrays import Booleans, Floats
from micah_plan.learning.segmenting.linear_systems import least_norm
from micah_plan.learning.segmenting.pool import Pool

_CHANGES = 0.02  # probability that a part that followed is held in the next step, or vice versa
_ROUNDS = 8  # of expectation maximisation
_MOVED = 0.5  # of the typical step; what goes further moved
_FARTHEST = 4.0  # largest nats of one step: a tracker slips, and an arrival is half a step
_SLIPPED = 5.0  # stds by which a row misses both hypotheses: the filter restarts there
_LEAST_INFORMATION = 1e-6  # relative; in a direction of less, actions are uninformative
_SAME_PLACE = 0.03  # of the travel; rests at an end differ by what the end, the joint and the tracker give
_FEWEST_STEPS = 2  # of a rest
_FEWEST_FOLLOWED = 8  # steps from which a channel is estimated


@dataclass(frozen=True, eq=False)
class JointTrace:
    """Configurations and actions of a part along one joint, in n rows.

    Attributes:
        configuration: (n,) measured [rad or m].
        action: (n, 3) in the part's frame [m]; that of the last row is not used.
        white: variance of a measurement; drift: variance that a tracker's wander adds per row.
    """

    configuration: Floats
    action: Floats
    white: float
    drift: float


def joint_trace(pool: Pool, joint: int, action: Floats) -> JointTrace:
    """The trace of a pool's joint in its rows."""
    scales = pool.along.take([joint])
    noise = float((scales.white + scales.fast)[0]), float(scales.renewed[0])
    return JointTrace(pool.seen.configuration[joint], action, *noise)


def places_held(along: JointTrace) -> Booleans:
    """(p, n) rows of each place at which the part was held, with repeated rests at one place merged."""
    rests = held_rows(along)
    if not len(rests):
        return rests
    middle = (rests @ along.configuration) / rests.sum(axis=1)
    order = np.argsort(middle, kind="stable")
    apart = np.diff(middle[order]) > _SAME_PLACE * np.ptp(along.configuration)
    place = np.concatenate([[0], np.cumsum(apart)])
    return np.array([rests[order[place == k]].any(axis=0) for k in range(place[-1] + 1)])


def held_rows(along: JointTrace) -> Booleans:
    """(r, n) rows of each rest in order, without the row of arrival."""
    held = held_steps(along) > 0.5
    edges = np.flatnonzero(np.diff(np.concatenate([[False], held, [False]]).astype(int))).reshape(-1, 2)
    edges = edges[edges[:, 1] - edges[:, 0] >= _FEWEST_STEPS]
    rows = np.arange(len(along.configuration))
    # A part that is held from the beginning is so in the first row too.
    first = np.where(edges[:, :1] == 0, 0, edges[:, :1] + 1)
    return np.asarray((rows >= first) & (rows <= edges[:, 1:]))


def held_steps(along: JointTrace) -> Floats:
    """(n - 1,) probability of each step that the part was held; 0 where actions give no evidence."""
    step, action = np.diff(along.configuration), along.action[:-1]
    asked = np.any(action != 0, axis=1)
    smooth = np.convolve(step, np.full(3, 1 / 3), mode="same")
    typical = float(np.sqrt(np.mean(step**2)))
    followed = (asked & (np.abs(smooth) > _MOVED * typical)).astype(float)
    held = np.zeros(len(step))
    for _ in range(_ROUNDS):
        if followed.sum() < _FEWEST_FOLLOWED:
            return np.zeros(len(step))
        weighted = action * followed[:, None]
        gain = least_norm((weighted.T @ action)[None], (weighted.T @ step)[None], _LEAST_INFORMATION)[0]
        expected = action @ gain
        variance = float(followed @ (step - expected) ** 2 / followed.sum())
        before, held = held, _smoothed(along, expected, max(variance - 2 * along.white, 0.0))
        followed = asked * (1 - held)
        if np.abs(held - before).max() < 0.01:
            break
    return held


def _smoothed(along: JointTrace, expected: Floats, loose: float) -> Floats:
    """(n - 1,) posterior probability of being held, given expected steps (n - 1,) and their residual variance."""
    measured = along.configuration.tolist()
    mean, variance, chance = measured[0], along.white, 0.5
    forward, odds = [], []
    for value, by_action in zip(measured[1:], expected.tolist(), strict=True):
        chance = chance * (1 - _CHANGES) + (1 - chance) * _CHANGES
        quiet = variance + along.drift
        # As loosely as it follows on average, relative to the command: without a command it does not move.
        free = quiet + min(loose, by_action**2)
        total_held, total_free = quiet + along.white, free + along.white
        miss_held, miss_free = value - mean, value - mean - by_action
        if min(miss_held**2 / total_held, miss_free**2 / total_free) > _SLIPPED**2:
            mean, variance, log_odds = value, along.white, 0.0
        else:
            log_odds = 0.5 * (log(total_free / total_held) + miss_free**2 / total_free - miss_held**2 / total_held)
            log_odds = min(max(log_odds, -_FARTHEST), _FARTHEST)
            chance = chance / (chance + (1 - chance) * exp(-log_odds))
            kept_held, kept_free = quiet / total_held, free / total_free
            mean_held, mean_free = mean + kept_held * miss_held, mean + by_action + kept_free * miss_free
            mean = chance * mean_held + (1 - chance) * mean_free
            variance = chance * (quiet * (1 - kept_held) + (mean_held - mean) ** 2)
            variance += (1 - chance) * (free * (1 - kept_free) + (mean_free - mean) ** 2)
        forward.append(chance)
        odds.append(log_odds)
    ahead, behind = np.array(forward), _backward_probabilities(odds)
    together = ahead * behind
    return np.asarray(together / (together + (1 - ahead) * (1 - behind)))


def _backward_probabilities(odds: list[float]) -> Floats:
    """(k,) backward probability that a part is held in each step, from the log odds of the later steps [nats]."""
    chance = 0.5
    backward = [chance]
    for log_odds in odds[:0:-1]:
        chance = chance / (chance + (1 - chance) * exp(-log_odds))
        chance = chance * (1 - _CHANGES) + (1 - chance) * _CHANGES
        backward.append(chance)
    return np.array(backward[::-1])
