"""Plans that the arm can follow: planned for the object first, and again where the arm fails.

The states around the knot where the arm fails become a body for the next plans: roll-outs that get there count as
collided, so the belief keeps as clear of it as of the bodies of the scene. A collision between the tool's load and the
scene happens in every posture: then all places of the hand are cut out where no side of the two bounding boxes
separates them. If the two meet at all corners of the goal, they do in all of it, being convex: there is no plan with
this grasp. The same holds for the path down on which an object is released: where fingers would meet the support, the
object is not brought above it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.region import HalfSpace, Region
from micah_plan.planning import messages
from micah_plan.planning.around_bodies import slides_of
from micah_plan.planning.cuts import half_space, with_cuts_as_bodies
from micah_plan.planning.release import with_release
from micah_plan.task.deadline import Deadline, TimeLimitError
from micah_plan.task.plan import ArmTrajectory, Finding, Plan, Trajectory
from micah_plan.task.problem import Problem
from micah_plan.task.reason import Offer, one_of
from micah_plan.task.release import pre_release_problem

if TYPE_CHECKING:
    from micah_plan.robot.tool_path import ArmFailure

# Half the width of what is cut out around a hand: as the narrow side of what arms carry [m].
_AROUND = 0.04
# By how much more is cut out with each plan: where an arm ends it does so in a larger neighbourhood.
_GROWTH = 1.5
# Plans after the first, each with more cut out, until the last failure is the answer.
_MOST_PLANS = 5
# What is kept beyond the distance that an arm keeps anyway [m].
_FURTHER = 0.002
# Times what a tool is short of its place, by which the root is moved nearer at first, and at least so far [m].
_NEARER, _LEAST = 1.2, 0.05


@dataclass(frozen=True, eq=False)
class _Stop:
    """A place where the arm cannot follow the hand.

    Attributes:
        arm: its failure.
        x: (n,) state of the knot where it fails; of a path down, the one in which the object would touch its support.
        mode: there.
        lowest: of a path down, the height to which it must be free [m]; None: the failure is on the plan itself.
    """

    arm: ArmFailure
    x: Floats
    mode: str
    lowest: float | None = None


def planned_with_arm(problem: Problem, planned: Callable[[Problem], Plan], seed: int, deadline: Deadline) -> Plan:
    """A plan with the arm's trajectory; if the arm can follow no plan, the last one with the reason.

    Args:
        problem: without a robot, only how the object is released is added.
        planned: returns a verified plan for a problem, or one with the reason for failure.
        seed: of the arm's postures.
    """
    cuts, plans = list[Region](), 0
    answer, stop = _with_arm(problem, planned(problem), seed, deadline)
    first = answer.findings[0] if stop is not None else None
    while stop is not None and answer.trajectory is not None and plans < _MOST_PLANS and not deadline.is_over():
        if stop.arm.overlaps and _in_all_of_the_goal(problem, stop):
            return _refused_in_whole_goal(answer, stop)
        if not (found := _cuts(problem, stop, _AROUND * _GROWTH**plans)):
            break
        cuts, plans = cuts + found, plans + 1
        plan, stop = _with_arm(
            problem, planned(with_cuts_as_bodies(problem, [(None, cut) for cut in cuts])), seed, deadline
        )
        if plan.trajectory is None:
            break
        if plan.arm is not None or stop is not None:
            timings = {name: plan.timings.get(name, 0.0) + s for name, s in answer.timings.items()}
            answer = replace(plan, timings=timings)
    if first is not None and answer.outcome != "solved" and first not in answer.findings:
        reason = f"{answer.reason}{messages.fails_closer(first.sentence)}"
        return replace(answer, reason=reason, findings=(*answer.findings, first))
    return answer


def _with_arm(problem: Problem, plan: Plan, seed: int, deadline: Deadline) -> tuple[Plan, _Stop | None]:
    """The plan with the arm's trajectory and release, or refused with the arm's failure."""
    if (trajectory := plan.trajectory) is None:
        return plan, None
    if problem.robot is not None:
        plan, arm = _with_arm_trajectory(problem, plan, trajectory, seed, deadline)
        if arm is not None:
            return plan, _Stop(arm, trajectory.means[arm.knot], trajectory.modes[arm.knot])
        if plan.arm is None:
            return plan, None
    plan, blocked = with_release(problem, plan, deadline)
    if blocked is None:
        return plan, None
    return plan, _Stop(blocked.arm, blocked.contact, trajectory.modes[-1], blocked.lowest)


def _with_arm_trajectory(
    problem: Problem, plan: Plan, trajectory: Trajectory, seed: int, deadline: Deadline
) -> tuple[Plan, ArmFailure | None]:
    """The plan with the arm's trajectory, or refused with the arm's failure."""
    from micah_plan.robot.along_plan import arm_along

    begin, beginning = time.perf_counter(), messages.ARM_CANNOT_FOLLOW
    arm: ArmTrajectory | ArmFailure | None = None
    try:
        arm = arm_along(problem, trajectory, seed, deadline=deadline)
    except TimeLimitError as over:
        beginning, finding = "", Finding.of("arm", over.reason, plan.mode_sequence)
    spent = time.perf_counter() - begin
    plan = replace(plan, timings={**plan.timings, "arm": spent, "total": plan.timings["total"] + spent})
    if isinstance(arm, ArmTrajectory):
        return replace(plan, arm=arm), None
    if arm is not None:
        finding = _finding(problem, plan, arm, trajectory.modes[arm.knot])
    return plan.refused_for(finding, beginning), arm


def _finding(problem: Problem, plan: Plan, arm: ArmFailure, mode: str) -> Finding:
    constraint = f"{arm.kind}: {', '.join(arm.names)}" if arm.names else arm.kind
    ways: tuple[str | Offer, ...] = ()
    if arm.short is not None and problem.robot is not None:
        nearer = max(_NEARER, _LEAST / max(float(np.linalg.norm(arm.short)), 1e-9)) * arm.short
        place = np.array(problem.robot.position) + nearer
        move = messages.MOVE_ROOT
        moved = Offer(move, f"{move} to", "root", tuple(enumerate(place.tolist())))
        ways = (messages.MOVE_GRASP, moved) if arm.kind == "joint limit" else (moved,)
    where = plan.mode_sequence, mode, arm.knot, constraint
    remedy = one_of(ways) if ways else arm.remedy
    return Finding("arm", "arm_cannot_follow", arm.sentence, remedy, *where, amount=arm.amount, ways=ways)


def _refused_in_whole_goal(plan: Plan, stop: _Stop) -> Plan:
    """No plan: with this grasp the tool or object collides for every hand pose in the goal."""
    pair = stop.arm.names[0], stop.arm.names[1]
    sentence = messages.grasp_meets_obstacle(pair, stop.lowest is not None)
    finding = Finding("arm", "grasp_meets_obstacle", sentence, messages.OTHER_GRASP, plan.mode_sequence)
    return replace(
        plan,
        outcome="no_plan",
        reason=f"{sentence}; {finding.remedy}",
        trajectory=None,
        arm=None,
        findings=(finding,),
        success_probability=None,
        success_interval=None,
    )


def _in_all_of_the_goal(problem: Problem, stop: _Stop) -> bool:
    """Whether two solids overlap in all of the goal: overlaps of convex solids are convex, so corners decide."""
    from micah_plan.robot.along_plan import problem_clearance, tool_path

    if problem.hold is None:
        return False
    target = {index: (value, tolerance) for index, value, tolerance in pre_release_problem(problem).goal.target}
    ends = [(problem.hold.lower[i], problem.hold.upper[i]) for i in range(3)]
    ends = [(t[0] - t[1], t[0] + t[1]) if (t := target.get(i)) else ends[i] for i in range(3)]
    if stop.lowest is not None:  # it is put down where its support is
        ends[2] = (stop.x[2], stop.x[2])
    corners = np.tile(stop.x, (8, 1))
    corners[:, :3] = list(product(*ends))
    tools = tool_path(problem, [stop.mode] * 8, corners).tool
    distances = problem_clearance(problem).tool_distances((stop.arm.names[0], stop.arm.names[1]), tools)
    return bool((distances < 0.0).all(axis=0).any())


def _cuts(problem: Problem, stop: _Stop, around: float) -> list[Region]:
    """Regions of hand states around a failure of the arm; empty if position does not matter.

    Args:
        around: half the width of the region that is cut out where the arm fails [m].
    """
    carried = None if problem.grasp is None else _tool_jacobian(problem, stop.mode)
    if carried is None or problem.grasp is None:
        return []
    from micah_plan.robot.along_plan import tool_path

    (n, m), arm, x, slides = (problem.automaton.n, problem.automaton.m), stop.arm, stop.x, carried
    name = f"the arm's {' at '.join(arm.names)}" if arm.names else f"the arm: {arm.kind}"
    if not arm.overlaps:  # another posture may do where the hand is elsewhere
        if stop.lowest is not None:
            return []
        sides = [s * axis @ slides for axis, s in product(np.eye(3), (1.0, -1.0))]
        return [Region(tuple(half_space((n, m), a, float(a @ x) - around, name) for a in sides if a.any()))]
    path = tool_path(problem, [stop.mode], x[None])
    # From what slides with the state to the tool; what is left of the state's place is the part's at x = 0.
    from_hand = path.tool.translation[0] - slides @ x
    overlaps = [_overlapping(problem, overlap, slides, from_hand, stop.lowest, name) for overlap in arm.overlaps]
    return [region for region in overlaps if region is not None]


def _tool_jacobian(problem: Problem, mode: str) -> Floats | None:
    """(3, n) Jacobian of the tool if it only slides with the state; None if it rotates."""
    n = problem.automaton.n
    if problem.hold is not None:
        return np.eye(3, n)
    part = None if problem.grasp is None else problem.grasp.part
    return None if part is None else slides_of(problem.automaton, mode).get(part)


def _overlapping(
    problem: Problem,
    overlap: tuple[tuple[Floats, float], ...],
    slides: Floats,
    from_hand: Floats,
    lowest: float | None,
    name: str,
) -> Region | None:
    """Hand positions at which two solids may overlap, or above which they do on the way down; None if unbounded.

    Args:
        overlap: poses of the tool in collision, as returned by `ClearanceModel.overlap`.
        slides: (3, n) how the hand moves with the state.
        from_hand: (3,) from the hand to the tool [m].
    """
    from micah_plan.robot.tool_path import PathSettings

    n, m, rows = problem.automaton.n, problem.automaton.m, list[HalfSpace]()
    for side, most in overlap:
        least = float(side @ from_hand) - most - PathSettings.margin - _FURTHER
        if lowest is None:
            rows.append(half_space((n, m), -side @ slides, least, name))
            continue
        along, least = np.array([side[0], side[1], 0.0]), least + float(side[2]) * lowest
        if along.any():
            rows.append(half_space((n, m), -along, least, name))
        elif least > 0.0:
            return None
    if lowest is not None:  # above where the hand cannot go down, well beyond the height at which it ends
        highest = max(
            value + tolerance for index, value, tolerance in pre_release_problem(problem).goal.target if index == 2
        )
        rows.append(half_space((n, m), np.array([0.0, 0.0, -1.0]), -highest - _AROUND, name))
    return Region(tuple(rows))
