"""Planning of releases: from the last knot down to contact, and away with the gripper open.

The height of the support is uncertain, so the hand goes down in small steps to the lowest place where contact may be
felt. It withdraws along the first direction that is free: back along its fingers, up, or in between.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtr

from micah_plan.arrays import Floats
from micah_plan.planning import messages
from micah_plan.task.acceptance import least_share
from micah_plan.task.deadline import Deadline, TimeLimitError
from micah_plan.task.plan import ArmTrajectory, Finding, Plan, ReleasePlan
from micah_plan.task.problem import Problem, Release
from micah_plan.task.release import Rest, resting_place

if TYPE_CHECKING:
    from micah_plan.robot.tool_path import ArmFailure

# An arm yields before it pushes, and more so a grip in which the object may turn: the hand may go so much deeper until
# the contact is felt [m].
_YIELDS, _TURNING = 0.003, 0.012
# Longest step of a hand that withdraws [m].
_LONGEST = 0.03
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Blocked:
    """A place where the arm cannot lower the held object.

    Attributes:
        arm: its failure.
        contact: (n,) state in which the object would touch its support.
        lowest: height of the hand to which the path must be free [m].
    """

    arm: ArmFailure
    contact: Floats
    lowest: float


def with_release(problem: Problem, plan: Plan, deadline: Deadline) -> tuple[Plan, Blocked | None]:
    """The plan with its release, if the problem has one; a plan that cannot release cannot be executed.

    Returns:
        the plan, and the obstacle to lowering the object if there is one.
    """
    if problem.release is None or plan.trajectory is None:
        return plan, None
    rest, release, last = resting_place(problem), problem.release, plan.trajectory.means[-1][: problem.automaton.n]
    contact = np.array(last)
    contact[2] = rest.top + rest.touching
    yields = _TURNING if problem.hold is not None and problem.hold.grip.pivots else _YIELDS
    lowest = contact[2] - problem.settings.sigmas * release.support_std - yields
    height = float(last[2] + problem.settings.sigmas * np.linalg.norm(plan.trajectory.factors[-1][2]))
    release_plan = ReleasePlan(
        math.ceil((height - lowest) / release.step), contact, rest.state(contact), _withdrawal(_UP, release)
    )
    if problem.robot is not None and plan.arm is not None:
        begin = perf_counter()
        try:
            answer = _with_arm(problem, plan, (release_plan, rest, lowest), deadline)
        except TimeLimitError as over:
            return _refused(plan, Finding.of("arm", over.reason, plan.mode_sequence)), None
        spent = perf_counter() - begin
        plan = replace(plan, timings={key: s + spent * (key in ("arm", "total")) for key, s in plan.timings.items()})
        if isinstance(answer, Blocked):
            return _refused(plan, _finding(plan, messages.LOWER, answer.arm)), answer
        if isinstance(answer, Finding):
            return _refused(plan, answer), None
        release_plan = answer
    return _with_support_probability(problem, replace(plan, release=release_plan)), None


def _withdrawal(direction: Floats, release: Release) -> Floats:
    """(W, 3) displacements of the hand along a direction (3,) of length 1 [m]."""
    count = math.ceil(release.withdraw / _LONGEST)
    return np.tile(direction * release.withdraw / count, (count, 1))


def _with_arm(
    problem: Problem, plan: Plan, asked: tuple[ReleasePlan, Rest, float], deadline: Deadline
) -> ReleasePlan | Blocked | Finding:
    """The release with the arm's path down and away, or the obstacle to it."""
    from micah_plan.robot.release_path import lowered, withdrawn

    (release_problem, rest, lowest), trajectory, arm = asked, plan.trajectory, plan.arm
    if problem.release is None or trajectory is None or arm is None:  # `with_release` has looked
        raise RuntimeError("nothing to release")
    last = trajectory.means[-1][: problem.automaton.n]
    count = max(1, math.ceil((float(last[2]) - lowest) / problem.release.step))
    states = np.tile(last, (count + 1, 1))
    states[:, 2] = np.linspace(last[2], lowest, count + 1)
    down = lowered(problem, rest.mode, states, arm.positions[-1], deadline)
    if not isinstance(down, ArmTrajectory):
        return Blocked(down, release_problem.contact, lowest)
    near = down.positions[int(np.argmin(np.abs(states[:, 2] - release_problem.contact[2])))]
    failures = []
    for direction in _directions(problem):
        displacements = _withdrawal(direction, problem.release)
        away = withdrawn(problem, rest, release_problem.contact, displacements, near, deadline)
        if isinstance(away, ArmTrajectory):
            return replace(release_problem, withdrawal=displacements, lowering=down, withdrawing=away)
        failures.append(away)
    return _finding(plan, messages.WITHDRAW, max(failures, key=lambda failure: failure.knot))


def _directions(problem: Problem) -> Iterator[Floats]:
    """Unit directions (3,) for withdrawing the hand, in order of preference."""
    back = _UP if problem.grasp is None else -problem.grasp.pose.rotation.apply(_UP)
    for share in (0.0, 0.5, 1.0):
        way = (1.0 - share) * back + share * _UP
        if (length := float(np.linalg.norm(way))) > 1e-6:
            yield way / length


def _finding(plan: Plan, task: str, failure: ArmFailure) -> Finding:
    sentence = messages.arm_cannot(task, failure.sentence)
    return Finding("arm", "arm_cannot_release", sentence, failure.remedy, plan.mode_sequence, constraint=failure.kind)


def _refused(plan: Plan, finding: Finding) -> Plan:
    return plan.refused_for(finding)


def _with_support_probability(problem: Problem, plan: Plan) -> Plan:
    """The plan with the probability that the support's height suits the goal included in its success."""
    release, release_plan, share = problem.release, plan.release, plan.success_probability
    heights = [(value, tol) for index, value, tol in problem.goal.target if index == 2]
    if release is None or release_plan is None or share is None or not heights:
        return plan
    (value, tolerance), std = heights[0], max(release.support_std, 1e-9)
    away = float(release_plan.rest[2]) - value
    holds = float(ndtr((tolerance - away) / std) - ndtr((-tolerance - away) / std))
    low, high = plan.success_interval or (share, share)
    plan = replace(plan, success_probability=share * holds, success_interval=(low * holds, high * holds))
    if plan.outcome != "solved" or share * holds >= least_share(problem.settings.confidence, plan.verification_trials):
        return plan
    sentence, remedy = messages.support_uncertain(tolerance, holds, std), messages.MEASURE_SUPPORT
    return _refused(plan, Finding("goal", "support_uncertain", sentence, remedy, plan.mode_sequence))
