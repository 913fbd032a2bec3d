"""Closed-loop execution: measure, filter, decide, command and log, until the goal is believed reached or steps end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.tracks import read_by_sensors
from micah_plan.belief.filter import initial_belief, predict, update
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.execution.follower import Advice, PlanFollower
from micah_plan.execution.log import RunLog
from micah_plan.execution.plant import Command, Measurement, Plant
from micah_plan.execution.pose import command, configuration
from micah_plan.execution.scoring import goal_error, goal_probability, true_state
from micah_plan.planning.plan import Trajectory
from micah_plan.planning.problem import Problem
from micah_plan.planning.remembering import coasted, remembering
from micah_plan.planning.verification import is_in_goal
from micah_plan.recording.value import Recording

Floats = NDArray[np.float64]
Replan = Callable[[HybridBelief], Trajectory | None]
ContinuePlan = Callable[[HybridBelief, Trajectory, int], Trajectory | None]

_SPARE_STEPS = 20
_MOST_REPLANS = 5
# Steps that a late transition or a belief held at the last knot may take before a new plan is asked for.
_PATIENCE = 3


@dataclass(frozen=True, eq=False)
class TrialResult:
    """One execution and how it ended.

    Attributes:
        recording: the log; `learn` and `predict` accept it.
        success: whether the true state at the end lies in the goal set.
        reason: one sentence.
        final_error: largest distance of a true constrained coordinate from its target [rad or m].
        final_mode, final_x: the true state at the end, in the model's terms; (n,) [rad or m].
        confidence: the belief's probability of the goal at the end.
        steps: control steps taken.
        replans: new plans followed.
        continuations: how often the rest of the plan was optimised again.
        beliefs: after each measurement, steps + 1 of them.
    """

    recording: Recording
    success: bool
    reason: str
    final_error: float
    final_mode: str
    final_x: Floats
    confidence: float
    steps: int
    replans: int
    continuations: int
    beliefs: tuple[HybridBelief, ...]


def execute(
    problem: Problem,
    trajectory: Trajectory,
    plant: Plant,
    rng: np.random.Generator,
    *,
    run: int = 0,
    max_steps: int | None = None,
    replan: Replan | None = None,
    continue_plan: ContinuePlan | None = None,
) -> TrialResult:
    """Carry out a plan on a plant.

    Every step measures the poses, updates the belief, and applies the plan's feedback. It stops when the plan is done
    and the belief is in the goal set with the problem's confidence: stopping earlier ends at its edge. A new plan is
    asked for where a belief leaves it, misses a transition or ends short of the goal; where none leads on, it stops.

    Args:
        problem: automaton, start belief, goal, confidence and input limits.
        trajectory: the plan.
        plant: where to execute; it is reset first.
        rng: feeds the plant's start and noise.
        run: the run's number in the log.
        max_steps: control steps at most; None: twice the plan's plus 20.
        replan: gives a trajectory from a belief, or None if there is none; None: never replan.
        continue_plan: the rest of a trajectory from a knot on, optimised again every `replan_every` steps; None: never.
    """
    automaton, known = problem.automaton, remembering(problem)
    longest = 2 * int((~trajectory.is_transition).sum()) + _SPARE_STEPS if max_steps is None else max_steps
    log, pilot = RunLog(automaton), _Pilot(known, trajectory, replan, continue_plan)
    measurement = plant.reset(rng)
    prior = initial_belief(known.automaton, known.start.mean, known.start.std, trajectory.modes[0])
    beliefs = [_updated(problem, known, prior, measurement)]
    confidence = _lasting_probability(known, beliefs[-1])
    while len(beliefs) <= longest and not pilot.is_lost:
        belief = beliefs[-1]
        if confidence >= problem.settings.confidence and (len(beliefs) == 1 or pilot.is_finished(belief)):
            break
        u = pilot.input(belief)
        order = _order(automaton, belief, u)
        log.add(measurement, belief, true_state(automaton, plant.truth())[1], order.origin)
        measurement = plant.apply(order)
        beliefs.append(_updated(problem, known, predict(known.automaton, belief, u), measurement))
        confidence = _lasting_probability(known, beliefs[-1])
    mode, x = true_state(automaton, plant.truth())
    log.add(measurement, beliefs[-1], x, None)
    return TrialResult(
        recording=log.recording(run),
        success=is_in_goal(problem.goal, mode, x),
        reason=_reason(problem, _ending(problem, pilot, beliefs, confidence), mode, x, plant.truth().incident),
        final_error=goal_error(problem.goal, x),
        final_mode=mode,
        final_x=x,
        confidence=confidence,
        steps=len(beliefs) - 1,
        replans=pilot.replans,
        continuations=pilot.continuations,
        beliefs=tuple(beliefs),
    )


class _Pilot:
    """Decides the input of each step: follows the plan, and asks for another when the plan no longer serves."""

    def __init__(
        self, problem: Problem, trajectory: Trajectory, replan: Replan | None, continue_plan: ContinuePlan | None
    ) -> None:
        self._problem = problem
        self._replan = replan
        self._continue_plan = continue_plan
        self._every = problem.settings.replan_every
        self._followed = 0
        self._waited = 0
        self._asked = 0
        self.replans = 0
        self.continuations = 0
        self.is_lost = False
        """Whether the belief has left the plan for good: none of the new plans asked for leads on."""
        self._follower = PlanFollower(self._problem, trajectory)

    def is_finished(self, belief: HybridBelief) -> bool:
        """Whether the plan that is followed has no further steps for this belief."""
        return self._follower.is_finished(belief)

    def input(self, belief: HybridBelief) -> Floats:
        """(m,) the input to apply now."""
        self._look_ahead(belief)
        self._followed += 1
        advice = self._follower.advise(belief)
        self._waited = 0 if advice.fit == "on_plan" else self._waited + 1
        if not self._wants_replan(advice) or self._replan is None:
            return advice.u
        if self._asked == _MOST_REPLANS:
            self.is_lost = advice.fit in ("lagging", "off_plan")
            return advice.u
        self._asked += 1
        self._waited = 0
        fresh = self._replan(belief)
        if fresh is None:
            return advice.u
        self.replans += 1
        self._follow(fresh)
        return self._follower.advise(belief).u

    def _follow(self, trajectory: Trajectory) -> None:
        self._follower = PlanFollower(self._problem, trajectory)
        self._followed = 0

    def _look_ahead(self, belief: HybridBelief) -> None:
        """Where it is time to, optimise the rest of the plan from the belief."""
        due = self._continue_plan is not None and 0 < self._every <= self._followed
        if self._continue_plan is None or not due or self._follower.is_finished(belief):
            return
        fresh = self._continue_plan(belief, *self._follower.place)
        self._followed = 0
        if fresh is not None:
            self.continuations += 1
            self._follow(fresh)

    def _wants_replan(self, advice: Advice) -> bool:
        return advice.fit in ("strayed", "off_plan") or self._waited > _PATIENCE


def _order(automaton: HybridAutomaton, belief: HybridBelief, u: Floats) -> Command:
    mode = automaton.modes[belief.most_likely].name
    return command(automaton, mode, belief.means[belief.most_likely, : automaton.n], u)


def _updated(problem: Problem, known: Problem, belief: HybridBelief, measurement: Measurement) -> HybridBelief:
    """The belief over the known problem's states after a measurement, which shows only those of the problem."""
    automaton, number = problem.automaton, belief.most_likely
    poses = measurement.position, measurement.quaternion
    z = configuration(automaton, automaton.modes[number].name, *poses, belief.means[number, : automaton.n])
    z = read_by_sensors(automaton, z[None], np.array([measurement.time]))[0]
    unseen = np.full(known.automaton.n - automaton.n, np.nan)
    return update(known.automaton, belief, np.concatenate([z, unseen]))


def _lasting_probability(problem: Problem, belief: HybridBelief) -> float:
    """Probability of the goal now, and when all that was commanded has arrived: the smaller of both."""
    automaton, now = problem.automaton, goal_probability(problem.automaton, problem.goal, belief)
    if not automaton.registers:
        return now
    ends = [coasted(automaton, q.name, mean) for q, mean in zip(automaton.modes, belief.means, strict=True)]
    return min(now, goal_probability(automaton, problem.goal, replace(belief, means=np.array(ends))))


def _ending(problem: Problem, pilot: _Pilot, beliefs: list[HybridBelief], confidence: float) -> str:
    """Why the execution ended."""
    if confidence >= problem.settings.confidence:
        return f"stopped with probability {confidence:.3f} of the goal"
    steps = len(beliefs) - 1
    if pilot.is_lost:
        mode = problem.automaton.modes[beliefs[-1].most_likely].name
        return (
            f"stopped after {steps} steps, believed {mode}: off the plan after asking {_MOST_REPLANS} times for another"
        )
    return f"the {steps} allowed steps ended with probability {confidence:.3f} of the goal"


def _reason(problem: Problem, ending: str, mode: str, x: Floats, incident: str) -> str:
    if is_in_goal(problem.goal, mode, x):
        return ending
    misses = [
        f"{problem.automaton.coordinates[i].name} is {abs(x[i] - value):.4g} {problem.automaton.coordinates[i].unit} "
        f"from its target (tolerance {tolerance:g})"
        for i, value, tolerance in problem.goal.target
        if abs(x[i] - value) > tolerance
    ]
    if problem.goal.modes and mode not in problem.goal.modes:
        misses.append(f"the true mode is {mode}, not {' or '.join(problem.goal.modes)}")
    return f"{ending}, but {' and '.join([incident, *misses] if incident else misses)}"
