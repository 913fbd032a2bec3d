"""What a page shows when: states at keyframes, and a planned belief on the clock of the page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micah_plan.task.plan import Trajectory

Floats = NDArray[np.float64]

_DURATION_S = 10.0
_FRAMES_PER_STEP = 3
_TRANSITION_S = 0.02
_REST_S = 0.8


@dataclass(frozen=True, eq=False)
class Keyframes:
    """States to show in time order.

    Attributes:
        times: (k,) [s], strictly increasing.
        modes: (k,) mode names.
        states: (k, n) [rad or m].
        factors: (k, n, n) Cholesky factors of the belief's covariance; None if there is no belief.
    """

    times: Floats
    modes: tuple[str, ...]
    states: Floats
    factors: Floats | None = None

    @property
    def duration(self) -> float:
        return float(self.times[-1])


def step_times(trajectory: Trajectory) -> NDArray[np.int64]:
    """(K,) number of time steps before each knot; a transition takes none."""
    return np.concatenate([[0], np.cumsum(~trajectory.is_transition)]).astype(np.int64)


def knot_times(trajectory: Trajectory) -> Floats:
    """(K,) [s] on the page's clock, strictly increasing."""
    steps = step_times(trajectory)
    passed = np.concatenate([[0], np.cumsum(trajectory.is_transition)])
    return np.asarray(steps * (_DURATION_S / max(int(steps[-1]), 1)) + passed * _TRANSITION_S)


def duration(trajectory: Trajectory) -> float:
    """[s] on the page's clock: the end rests a moment, so that a mode that is entered last is seen."""
    return float(knot_times(trajectory)[-1]) + _REST_S


def keyframes(trajectory: Trajectory) -> Keyframes:
    """Mean and factor on the page's clock: steps of equal length, a transition in passing."""
    at_knot = knot_times(trajectory)
    times: list[float] = []
    modes: list[str] = []
    states: list[Floats] = []
    factors: list[Floats] = []
    last = len(at_knot) - 1
    for k in range(last):
        count = 1 if trajectory.is_transition[k] else _FRAMES_PER_STEP
        for share in np.arange(count) / count:
            times.append(float((1 - share) * at_knot[k] + share * at_knot[k + 1]))
            modes.append(trajectory.modes[k])
            states.append((1 - share) * trajectory.means[k] + share * trajectory.means[k + 1])
            factors.append((1 - share) * trajectory.factors[k] + share * trajectory.factors[k + 1])
    return Keyframes(
        np.array([*times, at_knot[last]]),
        (*modes, trajectory.modes[last]),
        np.stack([*states, trajectory.means[last]]),
        np.stack([*factors, trajectory.factors[last]]),
    )


def stretches(modes: Sequence[str]) -> list[tuple[int, int]]:
    """First index of every stretch of one mode, and the first of the next (of the last stretch its own last)."""
    starts = [k for k in range(len(modes)) if k == 0 or modes[k] != modes[k - 1]]
    return list(zip(starts, [*starts[1:], len(modes) - 1], strict=True))
