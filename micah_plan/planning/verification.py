"""Whether a plan works: roll-outs of the real hybrid system from sampled true states, closed loop.

Shares nothing with the transcription: the motion is that of `automaton.transition` with events inside the steps and
with thresholds drawn anew for every roll-out, as well as they are known; the estimate is that of the hybrid filter with
noisy measurements, and the inputs are those of the policy.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.thresholds import with_drawn_thresholds
from micah_plan.automaton.transition import step
from micah_plan.belief import filter as belief_filter
from micah_plan.planning.limits import Limits, limited_input, limits_of
from micah_plan.planning.plan import Plan, Trajectory
from micah_plan.planning.policy import feedback_input, time_knots
from micah_plan.planning.problem import Goal, Problem
from micah_plan.planning.start_state import sample_start

Floats = NDArray[np.float64]

# The share of successes may fall short of the confidence by that many of its standard errors.
_STANDARD_ERRORS = 2.0


def verify(problem: Problem, plan: Plan, trials: int | None = None, seed: int = 0) -> Plan:
    """The plan with its success probability; ``"not_verified"`` if that is clearly below the asked confidence.

    Args:
        problem: what the plan is for.
        plan: as `pomdp_hd.plan` returned it; without a trajectory it is returned unchanged.
        trials: number of roll-outs; None: from the settings. 0 verifies nothing.
        seed: of the roll-outs.
    """
    count = problem.settings.verification_trials if trials is None else trials
    if plan.trajectory is None or count <= 0:
        return plan
    limits, rng = limits_of(problem), np.random.default_rng(seed)
    ends = [roll_out(problem, plan.trajectory, limits, child) for child in rng.spawn(count)]
    successes = sum(is_in_goal(problem.goal, mode, x) for mode, x in ends)
    share = successes / count
    answer = replace(plan, success_probability=share, verification_trials=count)
    confidence = problem.settings.confidence
    # The standard error at the asked confidence: that of the observed share vanishes where nothing succeeds.
    error = float(np.sqrt(confidence * (1.0 - confidence) / count))
    if share + _STANDARD_ERRORS * error >= confidence:
        return answer
    reason = (
        f"found {' -> '.join(plan.mode_sequence)}, but {successes} of {count} roll-outs ({share:.0%}) end in the goal, "
        f"fewer than the confidence {confidence:.0%} asks for; widen the tolerance, lower the confidence or the noise"
    )
    return replace(answer, outcome="not_verified", reason=reason)


def roll_out(problem: Problem, trajectory: Trajectory, limits: Limits, rng: np.random.Generator) -> tuple[str, Floats]:
    """One closed-loop execution: the true mode and state (n,) at its end."""
    automaton = problem.automaton
    process, observation = (np.array(s) for s in (automaton.noise.process_std, automaton.noise.observation_std))
    truth = with_drawn_thresholds(automaton, rng)
    mode, x = sample_start(truth, replace(problem.start, mode=trajectory.modes[0]), rng)
    belief = belief_filter.initial_belief(automaton, problem.start.mean, problem.start.std, trajectory.modes[0])
    for knot in time_knots(trajectory):
        believed, estimate = automaton.modes[belief.most_likely], belief.means[belief.most_likely]
        wanted = feedback_input(trajectory, int(knot), estimate)
        u = limited_input(believed, estimate, wanted, limits.max_step)
        moved = step(truth, mode, x, u, process * rng.standard_normal(automaton.n))
        mode, x = moved.mode, moved.x
        measured = x + observation * rng.standard_normal(automaton.n)
        measured[~np.isfinite(observation)] = np.nan
        belief = belief_filter.update(automaton, belief_filter.predict(automaton, belief, u), measured)
    return mode, x


def is_in_goal(goal: Goal, mode: str, x: Floats) -> bool:
    """Whether a true mode and state (n,) lie in the goal set."""
    return (not goal.modes or mode in goal.modes) and all(
        abs(float(x[index]) - value) <= tolerance for index, value, tolerance in goal.target
    )
