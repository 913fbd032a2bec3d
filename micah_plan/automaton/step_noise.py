"""Noise of one step: process noise, and the uncertainty of gains times the input.

The gain error is how much further a coordinate moves than its input, because its joint is uncertain. An input u
commands the displacement by which the *model's* joint moves the part's handle (its origin, if it has none) when its
coordinate grows by u. With t = dp/dc the tangent there and dt its error, the true joint moves by ``u (1 - t·dt /
|t|²)``. To first order that is the relative error of |t|: of a lever, if the joint rotates. It is the same all along
the motion, as is |t|, and zero for a joint that slides. So one number per joint describes the uncertainty of its gain,
and an object, which has one joint, has one gain.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.arrays import EQUAL, Booleans, Floats
from micah_plan.automaton.augmented import mapped
from micah_plan.automaton.hybrid import HybridAutomaton, Mode
from micah_plan.automaton.joint import Joint, Vector3, axis_basis
from micah_plan.automaton.memo import memoised

# A gain is drawn no further from 1 than this, so that nothing moves backwards.
_MOST = 0.9


@lru_cache(maxsize=1024)
def gain_std(joint: Joint, handle: Vector3 = (0.0, 0.0, 0.0)) -> float:
    """Std of the relative gain, t·dt / |t|², under the covariance of a joint's parameters.

    Args:
        handle: in the part's frame [m].

    Returns:
        0 for a joint without covariance, for one that does not turn, and for a handle on the axis.
    """
    if joint.covariance is None or not joint.turns:
        return 0.0
    slopes, squared = _slopes(joint, handle)
    if squared < EQUAL**2:
        return 0.0
    # A parameter that was not estimated, as those of the pose where counting starts elsewhere, counts as known.
    gradient = np.array([slopes.get(name, 0.0) for name in joint.covariance.names]) / squared
    return float(np.sqrt(max(0.0, gradient @ np.array(joint.covariance.matrix) @ gradient)))


def _slopes(joint: Joint, handle: Vector3) -> tuple[dict[str, float], float]:
    """t·dt per unit of each parameter, and |t|².

    With r from the centre to the handle, |t|² = |r|² - (a·r)² + pitch².
    """
    axis, basis = np.array(joint.axis), axis_basis(joint.axis)
    carried = Rotation.from_quat(joint.quaternion).apply(handle)
    r = np.subtract(joint.position, joint.center) + carried
    along = float(r @ axis)
    lever = r - along * axis
    # A rotation of the part by w moves its handle by w x carried.
    turned = np.cross(carried, lever)
    slopes = {f"position_{i + 1}": lever[i] for i in range(3)} | {f"rotation_{i + 1}": turned[i] for i in range(3)}
    # A tilt about the first direction of the basis moves the axis against the second.
    slopes |= {"axis_1": along * (lever @ basis[1]), "axis_2": -along * (lever @ basis[0])}
    slopes |= {"center_1": -lever @ basis[0], "center_2": -lever @ basis[1], "pitch": joint.pitch}
    return {name: float(value) for name, value in slopes.items()}, float(lever @ lever) + joint.pitch**2


def mode_gains(automaton: HybridAutomaton, mode: Mode) -> tuple[tuple[int, tuple[Joint, Vector3], float], ...]:
    """(coordinate, its joint with the handle, std of the gain) of the coordinates whose gain is uncertain in a mode.

    If several links have one coordinate, the most uncertain joint counts.
    """
    worst: dict[int, tuple[tuple[Joint, Vector3], float]] = {}
    for link, joint in zip(automaton.links, mode.joints, strict=False):
        handle = automaton.part(link.child).handle or (0.0, 0.0, 0.0)
        std = gain_std(joint, handle)
        if std > worst.get(link.coordinate, (None, 0.0))[1]:
            worst[link.coordinate] = (joint, handle), std
    return tuple((i, which, std) for i, (which, std) in sorted(worst.items()))


@memoised
def uncertain_gains(automaton: HybridAutomaton) -> dict[tuple[Joint, Vector3], float]:
    """Std of each uncertain gain by joint and handle, in the order of the modes."""
    return {which: std for mode in automaton.modes for _, which, std in mode_gains(automaton, mode)}


def drawn_gains(automaton: HybridAutomaton, rng: np.random.Generator, count: int) -> Floats:
    """(count, g) relative errors of the gains of that many objects, in the order of `uncertain_gains`.

    `rng` is not used where all gains are certain.
    """
    stds = np.array(list(uncertain_gains(automaton).values()))
    return np.clip(stds * rng.standard_normal((count, stds.size)), -_MOST, _MOST)


def gain_factors(automaton: HybridAutomaton, mode: Mode, errors: Floats) -> Floats:
    """(..., n) factors on each coordinate's motion in a mode, for objects with relative gain errors (..., g)."""
    order = list(uncertain_gains(automaton))
    factors = np.ones((*errors.shape[:-1], automaton.n))
    for i, which, _ in mode_gains(automaton, mode):
        factors[..., i] += errors[..., order.index(which)]
    return factors


def with_gains(automaton: HybridAutomaton, errors: Floats) -> HybridAutomaton:
    """The automaton whose joints move by relative errors (g,) more per input.

    The joints are unchanged: where poses are drawn from a configuration, those of the model count.
    """
    if not errors.size:
        return automaton

    def scaled(mode: Mode) -> Mode:
        B = gain_factors(automaton, mode, errors)[:, None] * mode.B
        return replace(mode, input_matrix=tuple(map(tuple, B.tolist())))

    return mapped(automaton, scaled)


@memoised
def free_process_std(automaton: HybridAutomaton, mode: Mode) -> tuple[float, ...]:
    """(n,) std of the process noise in a mode: that of the model, and 0 for coordinates that it pins or ties."""
    return tuple(np.where(_independent_coordinates(mode), automaton.noise.process_std, 0.0).tolist())


@memoised
def free_gain_std(automaton: HybridAutomaton, mode: Mode) -> Floats:
    """(n,) relative std of how far an input moves each coordinate in a mode (`gain`); 0 for pinned and tied ones."""
    stds = np.zeros(automaton.n)
    for i, _, std in mode_gains(automaton, mode):
        stds[i] = std
    return np.where(_independent_coordinates(mode), stds, 0.0)


def step_noise_std(automaton: HybridAutomaton, mode: Mode, u: Floats) -> Floats:
    """(..., n) std of the noise of a step under inputs u (..., m): process noise, and the uncertain gain's."""
    free, gain = np.array(free_process_std(automaton, mode)), free_gain_std(automaton, mode)
    if not gain.any():
        return np.broadcast_to(free, (*u.shape[:-1], automaton.n))
    return np.asarray(np.hypot(free, gain * (u @ mode.B.T)))


def _independent_coordinates(mode: Mode) -> Booleans:
    """(n,) the coordinates that a mode neither pins nor ties."""
    free = mode.free.copy()
    free[[tie.coordinate for tie in mode.ties]] = False
    return free
