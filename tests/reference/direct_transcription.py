"""A belief trajectory along one mode sequence as a nonlinear programme, with SciPy in the place of CasADi and IPOPT.

Sources: Platt et al., RSS 2010 (plan as if every measurement were the most likely one: the mean follows the plan, the
variance shrinks); Betts, "Practical Methods for Optimal Control" (transcription in phases); Jain and Niekum, CoRL 2018
(a phase per mode, ended by its guard). One coordinate, so that every line is scalar:

    m_{k+1} = m_k + B_q u_k                       mean
    p       = s_k² + q²                            the variance grows with the motion
    s_{k+1}² = p r² / (p + r²)                     and shrinks with the measurement

    minimise    w_goal (m_N - target)² / tolerance² + w_covariance s_N² / tolerance² + w_effort Σ (u_k / u_max)²
                + w_goal Σ Φ(-(m - c) / s)         at the end of each phase: the probability that its guard is missed
    subject to  |u_k| <= u_max
                m - c >= κ s  (or c - m >= κ s)    at the end of a phase: its guard holds with the confidence Φ(κ)
                |m_N - target| <= tolerance
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import norm

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Phase:
    """One mode on the way.

    Attributes:
        gain: B_q, by how much a unit of input moves the coordinate.
        steps: how many.
        guard: c, at which the phase ends [rad or m]; None: the last phase.
        side: 1 if the guard is m >= c, -1 if it is m <= c.
    """

    gain: float
    steps: int
    guard: float | None = None
    side: int = 1


@dataclass(frozen=True)
class Task:
    """What is to be done, and how well the coordinate is known.

    Attributes:
        mean, std: at the start [rad or m]. target, tolerance: of the goal [rad or m].
        process, observation: q and r [rad or m]. max_step: u_max. kappa: κ.
        goal, covariance, effort: the weights w.
    """

    mean: float
    std: float
    target: float
    tolerance: float
    process: float
    observation: float
    max_step: float
    kappa: float
    goal: float = 1.0
    covariance: float = 1.0
    effort: float = 0.05


def trajectory(task: Task, phases: Sequence[Phase], u: Floats) -> tuple[Floats, Floats]:
    """Means and stds (N + 1,) of the inputs (N,) [rad or m]."""
    mean, std = [task.mean], [task.std]
    gains = [phase.gain for phase in phases for _ in range(phase.steps)]
    for gain, command in zip(gains, u, strict=True):
        mean.append(mean[-1] + gain * command)
        p, r = std[-1] ** 2 + task.process**2, task.observation**2
        std.append(float(np.sqrt(p * r / (p + r))))
    return np.array(mean), np.array(std)


def cost(task: Task, phases: Sequence[Phase], u: Floats) -> float:
    """What inputs (N,) cost."""
    mean, std = trajectory(task, phases, u)
    away, spread = (mean[-1] - task.target) / task.tolerance, std[-1] / task.tolerance
    effort = np.square(u / task.max_step).sum()
    missed = sum(norm.cdf(-inside / s) for inside, s in inside_guards(phases, mean, std))
    return float(task.goal * (away**2 + missed) + task.covariance * spread**2 + task.effort * effort)


def inside_guards(phases: Sequence[Phase], mean: Floats, std: Floats) -> list[tuple[float, float]]:
    """By how much each guard holds at the end of its phase, and the std there [rad or m]."""
    ends = np.cumsum([phase.steps for phase in phases])
    return [
        (phase.side * (mean[end] - phase.guard), std[end])
        for phase, end in zip(phases, ends, strict=True)
        if phase.guard is not None
    ]


def margins(task: Task, phases: Sequence[Phase], u: Floats) -> Floats:
    """What must not be negative: the guards at the ends of their phases, then the goal on both sides [rad or m]."""
    mean, std = trajectory(task, phases, u)
    guards = [inside - task.kappa * s for inside, s in inside_guards(phases, mean, std)]
    away = mean[-1] - task.target
    return np.array([*guards, task.tolerance - away, task.tolerance + away])


def plan(task: Task, phases: Sequence[Phase]) -> Floats:
    """The cheapest inputs (N,) that keep all constraints.

    Raises:
        ValueError: if there are none.
    """
    scale = task.max_step  # an input is then of the order of 1
    found = minimize(
        lambda v: cost(task, phases, scale * v),
        np.zeros(sum(phase.steps for phase in phases)),
        method="SLSQP",
        bounds=[(-1.0, 1.0)] * sum(phase.steps for phase in phases),
        constraints=[{"type": "ineq", "fun": lambda v: margins(task, phases, scale * v) / task.tolerance}],
        options={"maxiter": 500, "ftol": 1e-12},
    )
    if not found.success:
        raise ValueError(f"no inputs keep all constraints: {found.message}")
    return np.asarray(scale * found.x)
