"""Damped Gauss-Newton iterations for fits of a single joint to all of its rows.

Source: Nocedal and Wright, Numerical Optimization, 2006, section 10.3 (Levenberg and Marquardt).
"""

from __future__ import annotations

from typing import Protocol, Self, TypeVar

import numpy as np

from micah_plan.arrays import Floats

UNKNOWN = 1.0  # rad, m, m/rad, 1/m: std of parameters that the rows do not determine
_DAMPING = 3e-3  # after the first step that fails
_MORE, _LESS = 30.0, 0.1  # damping, after a step that fails and after one that does not


class Fitted(Protocol):
    """A fit with p free parameters, as Gauss-Newton sees it."""

    @property
    def information(self) -> Floats:
        """(p, p) Fisher information of the rows."""

    @property
    def pull(self) -> Floats:
        """(p,) negative gradient of the cost."""

    @property
    def cost(self) -> float:
        """Negative log likelihood of the rows [nats]."""

    def moved(self, step: Floats) -> Self | None:
        """The fit after a step (p,) of its parameters; None if the step leaves the valid range."""


F = TypeVar("F", bound=Fitted)


def descended(now: F, steps: int, converged: float) -> F:
    """The fit after at most `steps` steps, or until the next promises less than `converged` [nats]."""
    damping = 0.0
    for _ in range(steps):
        damped = now.information + damping * np.diag(np.diag(now.information)) + np.eye(len(now.pull)) / UNKNOWN**2
        step = np.asarray(np.linalg.solve(damped, now.pull))
        if 0.5 * float(step @ now.pull) < converged:
            break
        after = now.moved(step)
        if after is not None and after.cost < now.cost:
            now, damping = after, damping * _LESS
        else:
            damping = max(damping * _MORE, _DAMPING)
    return now
