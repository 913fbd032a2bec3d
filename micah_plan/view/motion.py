"""Keyframes of a scene: states, a planned belief on the page's clock, and poses of the parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.kinematics import poses_of_states
from micah_plan.task.plan import Trajectory
from micah_plan.view.placement import ellipsoid, handle_in_part, handle_jacobian

Moved = Mapping[str, RigidTransform]
"""(k,) poses by part."""

_DURATION_S = 10.0
_FRAMES_PER_STEP = 3
_TRANSITION_S = 0.02
# A mode that is left in the instant in which it is entered is shown so long.
_PASSING_S = 0.4
REST_S = 0.8
"""How long the end is shown."""
SHORTEST_S, LONGEST_S = 4.0, 15.0
"""Of pages that play what was measured."""


@dataclass(frozen=True, eq=False)
class Keyframes:
    """States to show in time order.

    Attributes:
        times: (k,) [s], strictly increasing.
        modes: (k,) mode names.
        states: (k, n) [rad or m].
        factors: (k, n, n) Cholesky factors of the belief's covariance; empty if there is no belief.
    """

    times: Floats
    modes: tuple[str, ...]
    states: Floats
    factors: Floats = field(default_factory=lambda: np.zeros((0, 0, 0)))

    @property
    def duration(self) -> float:
        return float(self.times[-1])


def step_times(trajectory: Trajectory) -> NDArray[np.int64]:
    """(K,) number of time steps before each knot; a transition takes none."""
    return np.concatenate([[0], np.cumsum(~trajectory.is_transition)]).astype(np.int64)


def knot_times(trajectory: Trajectory) -> Floats:
    """(K,) [s] on the page's clock, strictly increasing."""
    steps = step_times(trajectory)
    takes = np.where(trajectory.is_transition, _TRANSITION_S, 0.0)
    for first, until in mode_stretches(trajectory.modes)[:-1]:
        if steps[first] == steps[until]:
            takes[until - 1] = _PASSING_S
    passed = np.concatenate([[0.0], np.cumsum(takes)])
    return np.asarray(steps * (_DURATION_S / max(int(steps[-1]), 1)) + passed)


def times_of_steps(trajectory: Trajectory, steps: Floats) -> Floats:
    """(k,) times [s] on the page's clock of steps (k,), extrapolated beyond the plan's last."""
    durations, times = step_times(trajectory), knot_times(trajectory)
    beyond = np.maximum(steps - durations[-1], 0.0) * (_DURATION_S / max(int(durations[-1]), 1))
    return np.asarray(np.interp(steps, durations, times) + beyond)


def shown_duration(trajectory: Trajectory, steps: float = 0.0) -> float:
    """[s] on the page's clock, with a pause at the end so that the last mode is visible.

    Args:
        steps: that are shown at least, where runs took more than the plan.
    """
    last = max(float(step_times(trajectory)[-1]), steps)
    return float(times_of_steps(trajectory, np.array([last]))[0]) + REST_S


def keyframes(trajectory: Trajectory) -> Keyframes:
    """Mean and factor on the page's clock: steps of equal length, transitions in passing."""
    frames = np.append(np.where(trajectory.is_transition, 1, _FRAMES_PER_STEP), 1)  # the last knot is the last frame
    knot = np.repeat(np.arange(len(frames)), frames)
    following = np.minimum(knot + 1, knot[-1])
    share = np.concatenate([np.arange(count) / count for count in frames])

    def between(values: Floats) -> Floats:
        weight = share.reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray((1 - weight) * values[knot] + weight * values[following])

    return Keyframes(
        between(knot_times(trajectory)),
        tuple(trajectory.modes[k] for k in knot),
        between(trajectory.means),
        between(trajectory.factors),
    )


def mode_stretches(modes: Sequence[str]) -> list[tuple[int, int]]:
    """First index of every stretch of one mode, and of the next (for the last stretch its own last)."""
    starts = [k for k in range(len(modes)) if k == 0 or modes[k] != modes[k - 1]]
    return list(zip(starts, [*starts[1:], len(modes) - 1], strict=True))


def poses_over_time(automaton: HybridAutomaton, keys: Keyframes, offset: float | Floats = 0.0) -> Moved:
    """(k,) poses by part; `offset` (k, n) is added to the states."""
    states = keys.states + offset
    matrices = {link.child: np.empty((len(states), 4, 4)) for link in automaton.links}
    for name in dict.fromkeys(keys.modes):  # all states of a mode at once
        rows = np.flatnonzero([mode == name for mode in keys.modes])
        for child, poses in poses_of_states(automaton, automaton.mode(name), states[rows]).items():
            matrices[child][rows] = poses.as_matrix()
    return {child: RigidTransform.from_matrix(matrix) for child, matrix in matrices.items()}


def handle_path(automaton: HybridAutomaton, keys: Keyframes, part: str) -> Floats:
    """(k, 3) positions of a part's handle [m, base frame]."""
    return np.asarray(poses_over_time(automaton, keys)[part].apply(handle_in_part(automaton, part)))


def belief_ellipsoids(
    automaton: HybridAutomaton, keys: Keyframes, part: str, factor: float, floor: float
) -> tuple[RigidTransform, Floats]:
    """(k,) poses and (k, 3) radii [m] of the ellipsoid {p: p' (J P J')⁻¹ p <= factor²} of a part's handle.

    J is the handle's Jacobian and P the belief's covariance; radii smaller than `floor` are drawn as `floor`.
    """
    axes: list[Floats] = []
    radii: list[Floats] = []
    for name, x, L in zip(keys.modes, keys.states, keys.factors, strict=True):
        spread = handle_jacobian(automaton, automaton.mode(name), x, part) @ L
        shape = ellipsoid(spread @ spread.T, factor, floor)
        turned, size = _matched(*shape, axes[-1]) if axes else shape
        axes.append(turned)
        radii.append(size)
    rotations = Rotation.from_matrix(np.stack(axes))
    return RigidTransform.from_components(handle_path(automaton, keys, part), rotations), np.stack(radii)


def _matched(axes: Floats, radii: Floats, before: Floats) -> tuple[Floats, Floats]:
    """The same ellipsoid with its axes permuted and flipped to be closest to the previous ones."""
    overlap = before.T @ axes
    order = np.zeros(3, dtype=int)
    free = np.abs(overlap).copy()
    for _ in range(3):
        i, j = np.unravel_index(np.argmax(free), free.shape)
        order[i] = j
        free[i, :] = free[:, j] = -1.0
    turned = axes[:, order] * np.where(np.diag(overlap[:, order]) < 0, -1.0, 1.0)
    if np.linalg.det(turned) < 0:
        turned = turned * np.array([1.0, 1.0, -1.0])
    return turned, radii[order]
