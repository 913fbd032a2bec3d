"""Display of a release: the object is lowered and settles, then the hand withdraws."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.quantities import quantity
from micah_plan.task.contact_poses import settled_poses
from micah_plan.task.plan import ArmTrajectory, Plan, ReleasePlan
from micah_plan.task.problem import Problem
from micah_plan.task.release import Rest, resting_place
from micah_plan.task.robot_description import RobotDescription
from micah_plan.view.motion import Keyframes, Moved
from micah_plan.view.page import Band
from micah_plan.view.palette import GOAL, INK, MUTED
from micah_plan.view.scene import transforms

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

    Poses = dict[str, RigidTransform]

# Duration of each part on the page's clock [s], and frames in it.
_LOWERING, _OPENING, _WITHDRAWING, _END = 1.2, 0.6, 1.2, 0.8
_FRAMES = 8


@dataclass(frozen=True, eq=False)
class ReleaseMotion:
    """The release after a plan, as it is shown.

    Attributes:
        keys: the states of the hand at the following frames; the belief is constant.
        moved: poses of the parts there.
        bands: on the timeline.
        arm_times, arm: (K,) [s] and (K, J) joints of the arm at them; empty without one.
        open_robot: with its gripper open; None without one.
        opened: (2,) from when until when it opens [s].
    """

    keys: Keyframes
    moved: Moved
    bands: tuple[Band, ...]
    arm_times: Floats
    arm: Floats
    open_robot: RobotDescription | None
    opened: Floats


def release_motion_of(plan: Plan, problem: Problem, last: Keyframes, begin: float) -> ReleaseMotion | None:
    """Keyframes of the release after the last frame of a plan, from time `begin` [s]; None without a release."""
    if plan.release is None or problem.release is None:
        return None
    release_plan, rest = plan.release, resting_place(problem)
    ends = begin + np.cumsum([0.0, _LOWERING, _OPENING, _WITHDRAWING])
    down, turn, away = (np.linspace(a, b, _FRAMES + 1)[1:] for a, b in pairwise(ends))
    share = np.concatenate([(down - ends[0]) / _LOWERING, np.ones(len(turn) + len(away))])
    states = last.states[-1] + share[:, None] * (release_plan.contact - last.states[-1])
    turned = np.concatenate([np.zeros(len(down)), (turn - ends[1]) / _OPENING, np.ones(len(away))])
    times = np.concatenate([down, turn, away])
    single = []
    for x, part in zip(states, turned, strict=True):
        held = settled_poses(problem, rest.mode, x)
        single.append(held if not part else held | _turned(problem, rest, held, x, float(part)))
    moved = {name: transforms([poses[name] for poses in single]) for name in single[0]}
    factors = np.repeat(last.factors[-1:], len(times), axis=0)
    keys = Keyframes(times, (rest.mode,) * len(times), states, factors)
    names = ("lower", "release", "withdraw")
    colors = (MUTED, GOAL, INK)
    looks = zip(pairwise(ends.tolist()), colors, names, strict=True)
    bands = [Band(a, b, color, name) for (a, b), color, name in looks]
    bands[-1] = replace(bands[-1], end=bands[-1].end + _END)
    arm_times, arm, robot = _arm(release_plan, ends, problem)
    return ReleaseMotion(keys, moved, tuple(bands), arm_times, arm, robot, ends[1:3])


def joined_keyframes(first: Keyframes, then: ReleaseMotion | None) -> Keyframes:
    """Keyframes of a plan followed by those of its release."""
    if then is None:
        return first
    later = then.keys
    return Keyframes(
        np.concatenate([first.times, later.times]),
        (*first.modes, *later.modes),
        np.concatenate([first.states, later.states]),
        np.concatenate([first.factors, later.factors]),
    )


def goal_poses(problem: Problem, x: Floats) -> Moved | None:
    """Poses of the parts at rest in a goal state x (n,); None without a release."""
    if problem.release is None:
        return None
    rest, hand = resting_place(problem), np.array(x)
    hand[:3] -= rest.shift
    held = settled_poses(problem, rest.mode, hand)
    return held | _turned(problem, rest, held, hand, 1.0)


def release_facts(plan: Plan, problem: Problem) -> list[tuple[str, str]]:
    """Facts on the release: the support, the expected contact, and the steps."""
    if plan.release is None or problem.release is None:
        return []
    height = quantity(float(plan.release.contact[2]), "m")
    spread = quantity(problem.release.support_std, "m", digits=2)
    steps = f"at most {plan.release.steps} of {quantity(problem.release.step, 'm')}"
    return [
        ("Released on", problem.release.support),
        ("Contact expected with the hand at", f"{height} ± {spread} (1 σ)"),
        ("Steps down until it is felt", steps),
    ]


def _turned(problem: Problem, rest: Rest, held: Poses, hand: Floats, share: float) -> Poses:
    grip = problem.hold.grip if problem.hold is not None else None
    held_parts = {} if grip is None else {part.name: held[part.name] for part in (grip.held, grip.moving)}
    return rest.poses(held_parts, np.array(hand[:3]), share)


def _arm(release_plan: ReleasePlan, ends: Floats, problem: Problem) -> tuple[Floats, Floats, RobotDescription | None]:
    """Times and joints of the arm, and the robot with its gripper open."""
    if release_plan.lowering is None or release_plan.withdrawing is None:
        return np.zeros(0), np.zeros((0, 0)), None
    from micah_plan.robot.release_path import with_open_gripper

    def spread(arm: ArmTrajectory, begin: float, end: float) -> Floats:
        return np.linspace(begin, end, len(arm.positions))

    away = release_plan.withdrawing
    # Down to where contact is expected: there the withdrawal begins.
    count = 1 + int(np.argmin(np.abs(release_plan.lowering.positions - away.positions[0]).max(axis=1)))
    down = replace(release_plan.lowering, positions=release_plan.lowering.positions[:count])
    times = [spread(down, ends[0], ends[1]), spread(away, ends[2], ends[3])]
    return np.concatenate(times), np.vstack([down.positions, away.positions]), with_open_gripper(problem)
