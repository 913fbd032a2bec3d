"""Closed-loop execution: measure, filter, decide, command and log, until the goal is believed reached or steps end."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.tracks import read_by_sensors
from micah_plan.belief.filter import initial_belief, predict, update
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.execution.log import RunLog
from micah_plan.execution.pilot import MOST_REPLANS, AskArm, ContinuePlan, Pilot, Replan
from micah_plan.execution.plant import Command, Measurement, Plant, Truth
from micah_plan.execution.pose import command, configuration
from micah_plan.execution.scoring import goal_probability, true_state
from micah_plan.planning.input_memory import coasted, with_input_memory
from micah_plan.recording.value import Recording
from micah_plan.task.plan import ArmTrajectory, Trajectory
from micah_plan.task.problem import Problem

Floats = NDArray[np.float64]

_SPARE_STEPS = 20


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
        refusals: why new plans were not followed.
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
    refusals: tuple[str, ...]
    beliefs: tuple[HybridBelief, ...]


def execute(
    problem: Problem,
    trajectory: Trajectory,
    plant: Plant,
    rng: np.random.Generator,
    *,
    run: int = 0,
    max_steps: int | None = None,
    arm: ArmTrajectory | None = None,
    ask_arm: AskArm | None = None,
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
        arm: joints of the arm along the trajectory; None: there is no arm.
        ask_arm: gives those along a new trajectory, from the joints that the arm is at, or what stands in the way: such
            a trajectory is refused. None: new trajectories are followed without asking.
        replan: gives a trajectory from a belief, or None if there is none; None: never replan.
        continue_plan: the rest of a trajectory from a knot on, optimised again every `replan_every` steps; None: never.
    """
    automaton, known = problem.automaton, with_input_memory(problem)
    longest = 2 * int((~trajectory.is_transition).sum()) + _SPARE_STEPS if max_steps is None else max_steps
    log, pilot = RunLog(automaton), Pilot(known, trajectory, arm, ask_arm, replan, continue_plan)
    measurement = plant.reset(rng)
    prior = initial_belief(known.automaton, known.start.mean, known.start.std, trajectory.modes[0])
    beliefs = [_updated(problem, known, prior, measurement)]
    confidence = _lasting_probability(known, beliefs[-1])
    while len(beliefs) <= longest and not pilot.is_lost:
        belief = beliefs[-1]
        if confidence >= problem.settings.confidence and (len(beliefs) == 1 or pilot.is_finished(belief)):
            break
        u = pilot.input(belief, measurement.joints)
        order = replace(_order(automaton, belief, u), posture=pilot.posture)
        log.add(measurement, belief, true_state(automaton, plant.truth())[1], order.origin)
        measurement = plant.apply(order)
        beliefs.append(_updated(problem, known, predict(known.automaton, belief, u), measurement))
        confidence = _lasting_probability(known, beliefs[-1])
    log.add(measurement, beliefs[-1], true_state(automaton, plant.truth())[1], None)
    return _result(problem, pilot, beliefs, plant.truth(), log.recording(run))


def _result(
    problem: Problem, pilot: Pilot, beliefs: list[HybridBelief], truth: Truth, recording: Recording
) -> TrialResult:
    """How an execution ended."""
    mode, x = true_state(problem.automaton, truth)
    confidence = _lasting_probability(with_input_memory(problem), beliefs[-1])
    return TrialResult(
        recording=recording,
        success=problem.goal.contains(mode, x),
        reason=_reason(problem, _ending(problem, pilot, beliefs, confidence), mode, x, truth.incident),
        final_error=problem.goal.error(x),
        final_mode=mode,
        final_x=x,
        confidence=confidence,
        steps=len(beliefs) - 1,
        replans=pilot.replans,
        continuations=pilot.continuations,
        refusals=tuple(pilot.refusals),
        beliefs=tuple(beliefs),
    )


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


def _ending(problem: Problem, pilot: Pilot, beliefs: list[HybridBelief], confidence: float) -> str:
    """Why the execution ended."""
    if confidence >= problem.settings.confidence:
        return f"stopped with probability {confidence:.3f} of the goal"
    steps, refused = len(beliefs) - 1, ""
    if pilot.refusals:
        refused = f"; {len(pilot.refusals)} new plans were refused, the last because {pilot.refusals[-1]}"
    if pilot.is_lost:
        mode = problem.automaton.modes[beliefs[-1].most_likely].name
        asked = f"off the plan after asking {MOST_REPLANS} times for another"
        return f"stopped after {steps} steps, believed {mode}: {asked}{refused}"
    return f"the {steps} allowed steps ended with probability {confidence:.3f} of the goal{refused}"


def _reason(problem: Problem, ending: str, mode: str, x: Floats, incident: str) -> str:
    if problem.goal.contains(mode, x):
        return ending
    misses = [
        f"{problem.automaton.coordinates[i].name} is {abs(x[i] - value):.4g} {problem.automaton.coordinates[i].unit} "
        f"from its target (tolerance {tolerance:g})"
        for i, value, tolerance in problem.goal.target
        if abs(x[i] - value) > tolerance
    ]
    if not problem.goal.admits(mode):
        misses.append(f"the true mode is {mode}, not {' or '.join(problem.goal.modes)}")
    return f"{ending}, but {' and '.join([incident, *misses] if incident else misses)}"
