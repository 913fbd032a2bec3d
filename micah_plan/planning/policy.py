"""The executed input: the plan's nominal one and the feedback around it. Verification and execution both use this."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from micah_plan.task.plan import Trajectory

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def time_knots(trajectory: Trajectory) -> Ints:
    """(T,) the knots k whose step to knot k + 1 takes time; transitions are left out."""
    return np.asarray(np.flatnonzero(~trajectory.is_transition))


def feedback_input(trajectory: Trajectory, knot: int, estimate: Floats) -> Floats:
    """(..., m) planned displacement corrected for the estimate (..., n) of the state; limits are the caller's.

    A plan that knows fewer of its coordinates, none of a memory, looks at the first ones.
    """
    known = estimate[..., : trajectory.means.shape[1]]
    return np.asarray(trajectory.inputs[knot] + (known - trajectory.means[knot]) @ trajectory.gains[knot].T)
