"""Belief-LQR: time-varying feedback on the estimate around a planned trajectory, and the input that is executed.

Certainty equivalence: with the covariance of the belief as planned, the optimal linear feedback acts on the mean alone,
with the gains of the finite-horizon linear-quadratic regulator (Bertsekas, "Dynamic Programming and Optimal Control",
vol. 1, ch. 4 and 5). The final cost is the plan's own: goal error against effort.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from micah_plan.arrays import Booleans, Floats, Ints
from micah_plan.automaton.hybrid import Edge
from micah_plan.automaton.input_reversal import matrix_after
from micah_plan.planning.input_memories import linear_step, steps_of_memory
from micah_plan.planning.limits import Limits
from micah_plan.planning.plan_cost import goal_weights, in_steps
from micah_plan.task.plan import Trajectory
from micah_plan.task.problem import Problem

# Cost of being one step's length off the trajectory, against 1 for a full extra step: an error shrinks by 0.4 per step.
_TRACKING_WEIGHT = 0.3
# Half of the width of a guard that is no wider than a point [rad or m].
_NARROWEST = 1e-4


def _relative(problem: Problem, edge: Edge, tracking: Floats) -> tuple[Floats, Floats]:
    """(n, n) weights of deviations on the way to a guard, and (n, n) at the guard.

    A guard between two bounds on the distance from something that no input of the source mode moves is met by following
    its estimate, not the planned place: there, deviations of the distance count instead of those of its coordinates.
    Missing the guard by half its width costs as much as missing the goal by its tolerance.
    """
    automaton = problem.automaton
    driven = automaton.mode(edge.source).B.any(axis=1)
    at, rows = np.zeros_like(tracking), edge.guard.half_spaces
    for first, second in combinations([h for h in rows if not h.on_input], 2):
        a = np.array(first.a)
        if not np.array_equal(a, -np.array(second.a)) or not a[driven].any() or not a[~driven].any():
            continue
        half, involved = max(-0.5 * (second.c + first.c), _NARROWEST), np.flatnonzero(a)
        weight = float(tracking.diagonal()[driven & (a != 0.0)].min())
        tracking = tracking.copy()
        tracking[involved, involved] = 0.0
        tracking += weight * np.outer(a, a)
        at += in_steps(problem, np.array(problem.settings.weight_goal)) * np.outer(a, a) / half**2
    return tracking, at


def time_knots(trajectory: Trajectory) -> Ints:
    """(T,) knots k whose step to knot k + 1 takes time; transitions are excluded."""
    return np.asarray(np.flatnonzero(~trajectory.is_transition))


def feedback_input(trajectory: Trajectory, knot: int, estimate: Floats) -> Floats:
    """(..., m) planned displacement corrected for the estimate (..., n) of the state; limits are the caller's.

    Verification and execution both use this. A plan over fewer coordinates, without a memory of inputs, looks at the
    first ones.
    """
    planned = estimate[..., : trajectory.means.shape[1]]
    return np.asarray(trajectory.inputs[knot] + (planned - trajectory.means[knot]) @ trajectory.gains[knot].T)


def belief_lqr(
    problem: Problem,
    limits: Limits,
    modes: tuple[str, ...],
    is_transition: Booleans,
    around: tuple[Floats, Floats] | None = None,
) -> Floats:
    """(K-1, m, n) gains for the executed input = inputs[k] + gains[k] @ (estimate - means[k]).

    Args:
        modes: (K,) mode at each knot.
        is_transition: (K-1,) whether the step from knot to knot is a transition; its gain is zero.
        around: means (K, n) and inputs (K-1, m) near which a memory of inputs is linear; None: largest inputs at rest.

    A coordinate that a mode pins has no feedback: its apparent deviation is not motion.
    """
    automaton, n, m = problem.automaton, problem.automaton.n, problem.automaton.m
    tracking = np.diag(_TRACKING_WEIGHT / limits.speed**2)
    effort = np.diag(1.0 / limits.max_step**2)
    goal = np.diag(in_steps(problem, goal_weights(problem)))
    value = tracking + goal
    if automaton.input_memories:  # later arrivals count too, otherwise the last inputs are huge
        last = np.array(problem.start.mean) if around is None else around[0][-1]
        A = linear_step(automaton, modes[-1], last, limits.max_step, limits.max_step)[0]
        rest = np.linalg.matrix_power(A, steps_of_memory(automaton, limits.max_step)[1])
        value += rest.T @ goal @ rest
    gains, restricted_to_nearby_modes = np.zeros((len(is_transition), m, n)), tracking
    free, linear = {mode: automaton.mode(mode).free for mode in set(modes)}, dict[str, tuple[Floats, Floats]]()
    for k in reversed(range(len(is_transition))):
        value = value * (free[modes[k + 1]][:, None] & free[modes[k + 1]])
        if is_transition[k]:
            # Cheapest-to-go through the reset; of several edges between two modes the first represents all.
            edge = next(e for e in automaton.edges if (e.source, e.target) == (modes[k], modes[k + 1]))
            A = matrix_after(automaton, edge)
            restricted_to_nearby_modes, at_guard = _relative(problem, edge, tracking)
            value = restricted_to_nearby_modes + A.T @ value @ A + at_guard
            continue
        if automaton.input_memories or modes[k] not in linear:  # otherwise it is the same at all places of the mode
            x, u = (np.array(problem.start.mean), limits.max_step) if around is None else (around[0][k], around[1][k])
            linear[modes[k]] = linear_step(automaton, modes[k], x, u, limits.max_step)
        A, B = linear[modes[k]]
        carried = B.T @ value
        gain = -np.linalg.solve(effort + carried @ B, carried @ A)
        gains[k] = gain * free[modes[k]]
        closed = A + B @ gain
        value = restricted_to_nearby_modes + gain.T @ effort @ gain + closed.T @ value @ closed
    return gains
