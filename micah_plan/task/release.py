"""Release of held objects: the resting pose without a hand.

A placement ends with the object released. The hand carries it to a place above its support and lowers it until contact
is felt; the gripper opens, and the object rotates until a side lies flat. It rotates about the fingers: as they loosen,
friction lets it rotate between them before it lets it slide, and the edge that touched slides. Its final place follows
from where the hand was, except for the height: that is the support's.

The goal of a problem with a release speaks of the object at rest: of the state in which a hand would hold it there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.arrays import EQUAL, Floats
from micah_plan.automaton.contacts.touch import box_corners
from micah_plan.automaton.contacts.values import AXES, HINGE
from micah_plan.automaton.joint import Vector3
from micah_plan.automaton.kinematics import part_poses
from micah_plan.errors import InputError
from micah_plan.quantities import quantity
from micah_plan.task.body import corners, vector3
from micah_plan.task.goal import Goal
from micah_plan.task.problem import Problem

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

# An object that turns further than this after it was released is dropped rather than put down [rad].
_MOST_TURN = 0.25
# Before it is lowered, the object is held so far above its support, give or take as much [m].
_HOVER = 0.01


@dataclass(frozen=True)
class Rest:
    """Resting pose of an object on its support after a release in a mode.

    Attributes:
        mode: of the object.
        top: height of the support [m].
        touching: height of the hand above the support as the first edge touches [m].
        shift: displacement of the hand's point on the object from there until it lies flat [m].
        turn: rotation vector of the object meanwhile [rad].
    """

    mode: str
    top: float
    touching: float
    shift: Vector3
    turn: Vector3

    def state(self, hand: Floats, height_error: float = 0.0) -> Floats:
        """(..., n) states at rest after a release in states (..., n), with the support higher by an error."""
        at_rest = np.array(hand)
        at_rest[..., :2] += self.shift[:2]
        at_rest[..., 2] = self.top + height_error + self.touching + self.shift[2]
        return at_rest

    def poses(self, lowered: dict[str, RigidTransform], hand: Floats, share: float = 1.0) -> dict[str, RigidTransform]:
        """Poses of the parts after a fraction of the release's turn, from those at which they were put down by a hand
        at (3,).
        """
        from scipy.spatial.transform import RigidTransform

        turn = Rotation.from_rotvec(share * np.array(self.turn))
        moved = RigidTransform.from_components(hand + share * np.array(self.shift) - turn.apply(hand), turn)
        return {name: moved * pose for name, pose in lowered.items()}


def resting_place(problem: Problem) -> Rest:
    """The resting pose of a problem's object after its release.

    Raises:
        InputError: if it cannot be released there: it is not latched, would tip over, or contradicts the goal.
    """
    release, hold = problem.release, problem.hold
    if release is None or hold is None:
        raise InputError("the problem has no release", remedy="add 'release' to a problem with 'hold'")
    joint = problem.automaton.n - 1
    latched = [
        mode
        for mode in problem.automaton.modes
        if problem.goal.admits(mode.name) and any(pin.coordinate == joint for pin in mode.pins)
    ]
    if not latched:
        problem_text = "only an object that has latched can be released: a free joint moves when no hand holds it"
        raise InputError(problem_text, remedy="admit a mode in which the joint is latched, or leave 'release' out")
    top = support_height(problem)
    points, center = _shape(problem, latched[0].name)
    touching, turn, drop = _settled(points, center, Rotation.from_rotvec(hold.grip.rotation).apply(HINGE))
    fingers = np.zeros(3) if problem.grasp is None else np.array(problem.grasp.position)
    shift = fingers + Rotation.from_rotvec(turn).apply(-fingers)
    shift[2] = drop
    rest = Rest(latched[0].name, top, touching, vector3(shift), vector3(turn))
    height = float(rest.state(np.zeros(problem.automaton.n))[2])
    for index, value, tolerance in problem.goal.target:
        if index == 2 and abs(value - height) > tolerance:
            text = f"goal.target.{AXES[2]}: released on '{release.support}', the object rests with the hand's point at"
            raise InputError(f"{text} z = {height:.4g} m, found {value:g}", remedy=f"write {height:.4g}")
    return rest


def support_height(problem: Problem) -> float:
    """Height of the upper side of a release's support [m]."""
    name = problem.release.support if problem.release is not None else ""
    body = next((body for body in problem.scene if body.name == name), None)
    if body is None:
        raise InputError(f"release.support: the scene has no body '{name}'", remedy="name what the object is put on")
    return float(max(body.pose.apply(corners(shape))[:, 2].max() for shape in body.shapes))


def pre_release_problem(problem: Problem) -> Problem:
    """The problem of the hand before the release, with a goal above the support; unchanged without one.

    The place is the one from which the object comes to rest at the target. The margin for the shift as the gripper
    opens is taken from the tolerance; the height keeps clear of the support, as high as that may be.
    """
    if problem.release is None:
        return problem
    rest, release, sigmas = resting_place(problem), problem.release, problem.settings.sigmas
    target = []
    for index, value, tolerance in problem.goal.target:
        if index < 2:
            room = math.sqrt(max(0.0, tolerance**2 - (sigmas * release.shift_std) ** 2))
            if not room:
                text = f"release.shift_std: the release moves the object by more than the tolerance {tolerance:g} m"
                raise InputError(text, remedy=f"widen the tolerance of '{AXES[index]}', or hold it more gently")
            target.append((index, value - rest.shift[index], room))
        elif index != 2:
            target.append((index, value, tolerance))
    target.append((2, rest.top + rest.touching + _HOVER + sigmas * release.support_std, _HOVER))
    goal = Goal(tuple(sorted(target)), (rest.mode,))
    return replace(problem, goal=goal, release=None)


def _shape(problem: Problem, mode: str) -> tuple[Floats, Floats]:
    """(k, 3) corners of the object in a mode and (3,) its centre of mass, from the hand's point, base axes [m]."""
    if problem.hold is None:
        raise InputError("the problem does not define how the object is held", remedy="add the block 'hold'")
    poses = part_poses(problem.automaton, problem.automaton.mode(mode), np.zeros(problem.automaton.n))
    parts = (problem.hold.grip.held, problem.hold.grip.moving)
    points = [np.asarray(poses[part.name].apply(box_corners(part.shapes))) for part in parts]
    centers = []
    for part in parts:  # which weigh the same
        volumes = np.array([np.prod(np.ptp(box_corners((shape,)), axis=0)) for shape in part.shapes])
        middles = np.array([shape.position for shape in part.shapes])
        centers.append(poses[part.name].apply(volumes @ middles / volumes.sum()))
    return np.concatenate(points), np.mean(centers, axis=0)


def _settled(points: Floats, center: Floats, axis: Floats) -> tuple[float, Floats, float]:
    """(hand height at first contact, rotation vector to rest, rise of the hand) for corner points.

    Args:
        points, center: of `_shape`.
        axis: (3,) level direction about which it turns.

    Raises:
        InputError: if it would tip over.
    """
    if abs(axis[2]) > 1e-3:
        raise InputError("an object can be released only with its hinge level", remedy="hold it so, or drop 'release'")
    along = np.cross(axis, [0.0, 0.0, 1.0])  # a positive turn about the axis lifts what lies behind the edge
    touching, turned = -float(points[:, 2].min()), 0.0
    flat = np.stack([points @ along, points[:, 2]], axis=1)
    edge = flat[np.lexsort((flat[:, 0], flat[:, 1].round(9)))[0]]
    origin = np.zeros(2)
    middle = np.array([center @ along, center[2]])
    for _ in range(len(flat)):
        low = flat[flat[:, 1] < flat[:, 1].min() + EQUAL]
        left, right = low[low[:, 0].argmin()], low[low[:, 0].argmax()]
        if left[0] - EQUAL <= middle[0] <= right[0] + EQUAL:
            return touching, turned * axis, float(origin[1])
        edge, side = (left, -1.0) if middle[0] < left[0] else (right, 1.0)
        ahead = side * (flat[:, 0] - edge[0]) > EQUAL
        angle = float(np.arctan2(flat[ahead, 1] - edge[1], side * (flat[ahead, 0] - edge[0])).min())
        turned += side * angle
        if abs(turned) > _MOST_TURN:
            break
        c, s = np.cos(angle), np.sin(angle) * side
        turn = np.array([[c, s], [-s, c]])
        flat, middle, origin = ((np.atleast_2d(p) - edge) @ turn.T + edge for p in (flat, middle, origin))
        middle, origin = middle[0], origin[0]
    angle_text = quantity(abs(turned), "rad", degrees=False)
    raise InputError(
        f"released as it is held, it would tip over, by {angle_text} or more",
        remedy="hold it more nearly as it shall stand ('hold.rotation'), or leave 'release' out",
    )
