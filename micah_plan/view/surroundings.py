"""Surroundings of an object on a page: the bodies of the scene, and the arm."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.arrays import Floats
from micah_plan.quantities import plain, quantity
from micah_plan.task.body import Body, Hull, Shape, corners, transform
from micah_plan.task.plan import ArmTrajectory, Plan
from micah_plan.task.problem import Problem
from micah_plan.view.page import LegendEntry
from micah_plan.view.palette import MUTED
from micah_plan.view.release import ReleaseMotion
from micah_plan.view.scene import DrawnScene, slug
from micah_plan.view.solids import Mesh

SCENE_LAYER, ROBOT_LAYER = "scene", "robot"
_RESERVED_POSES = 4
_ROOM = 0.15


def draw_bodies(scene: DrawnScene, bodies: Sequence[Body]) -> None:
    """Draw the bodies of a problem's scene; drawn last, since the camera fits only those near the object."""
    lower, upper = scene.bounds()
    room = _ROOM * (upper - lower)
    for number, body in enumerate(bodies):
        path = f"{SCENE_LAYER}/{slug(body.name, number)}"
        for i, shape in enumerate(body.shapes):
            _draw(scene, f"{path}/{i}", shape)
            scene.reserve(np.clip(body.pose.apply(corners(shape)), lower - room, upper + room))
        scene.place(path, body.pose)


def body_boxes(bodies: Sequence[Body]) -> Floats:
    """(b, 2, 3) lower and upper corners of boxes around the bodies' shapes [m]."""
    points = [body.pose.apply(corners(shape)) for body in bodies for shape in body.shapes]
    return np.array([[p.min(axis=0), p.max(axis=0)] for p in points]).reshape(-1, 2, 3)


def draw_arm(
    scene: DrawnScene,
    problem: Problem,
    arm: ArmTrajectory,
    knot_times: Floats,
    times: Floats,
    after: ReleaseMotion | None = None,
) -> None:
    """The links of the arm, moving from knot to knot straight in the joints.

    Args:
        knot_times: (K,) of the plan's knots [s].
        times: (k,) of the keyframes [s].
        after: how it releases the object after the plan, if it does.

    Raises:
        InputError: if the robot's file cannot be used, for instance because its meshes are not where the plan is.
    """
    if problem.robot is None:
        return
    from micah_plan.robot.load_arm import load_arm
    from micah_plan.robot.solids import arm_shapes

    model = load_arm(problem.robot)
    positions = arm.positions
    if after is not None and len(after.arm):
        knot_times, positions = np.concatenate([knot_times, after.arm_times]), np.vstack([positions, after.arm])
    q = np.stack([np.interp(times, knot_times, column) for column in positions.T], axis=1)
    poses = np.stack([model.joint_matrices(row) for row in q])
    shapes = arm_shapes(model)
    robot = None if after is None else after.open_robot
    opened = shapes if robot is None else arm_shapes(load_arm(robot))
    for number, ((joint, shape), (_, away)) in enumerate(zip(shapes, opened, strict=True)):
        path = f"{ROBOT_LAYER}/{joint}/{number}"
        if after is not None and away != shape:  # a finger, which slides as the gripper opens
            moves = np.interp(times, after.opened, [0.0, 1.0])[:, None] * np.subtract(away.position, shape.position)
            still = np.tile([0.0, 0.0, 0.0, 1.0], (len(times), 1))
            path = f"{ROBOT_LAYER}/{joint}/finger {number}"
            scene.animate(path, times, RigidTransform.from_components(moves, Rotation.from_quat(still)))
            path += "/0"
        _draw(scene, path, shape)
        for i in range(0, len(q), max(1, len(q) // _RESERVED_POSES)):
            scene.reserve(RigidTransform.from_matrix(poses[i, joint]).apply(corners(shape)))
    for joint in range(1, poses.shape[1]):
        scene.animate(f"{ROBOT_LAYER}/{joint}", times, RigidTransform.from_matrix(poses[:, joint]))


def arm_facts(plan: Plan) -> list[tuple[str, str]]:
    """The arm's smallest margins."""
    arm = plan.arm
    if arm is None:
        return []
    facts = [("Least manipulability", plain(float(arm.manipulability.min())))]
    if arm.limit_margin is not None:
        away = quantity(arm.limit_margin, arm.limit_unit)
        facts.insert(0, ("Nearest to its limit", f"{arm.limit_joint}, {away} away"))
    if arm.least_clearance is not None:
        least = f"{quantity(arm.least_clearance, 'm')}, between {' and '.join(arm.closest_pair)}"
        facts.insert(0, ("Least clearance", least))
    return facts


def arm_legend(plan: Plan, problem: Problem) -> list[LegendEntry]:
    """Checkboxes for the scene and the arm."""
    entries = [LegendEntry(problem.scene[0].shapes[0].color, "scene", SCENE_LAYER)] if problem.scene else []
    if plan.arm is not None:
        entries.append(LegendEntry(MUTED, "arm, as its clearances are computed", ROBOT_LAYER))
    return entries


def _draw(scene: DrawnScene, path: str, shape: Shape) -> None:
    if not isinstance(shape, Hull):
        scene.primitive(path, shape)
        return
    points = np.array(shape.vertices)
    hull = ConvexHull(points)
    a, b, c = np.moveaxis(points[hull.simplices], 1, 0)
    turned = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces = np.where(turned[:, None], hull.simplices[:, ::-1], hull.simplices)  # seen from outside
    scene.mesh(path, Mesh(points, faces.astype(np.int64)), shape.color)
    scene.place(path, transform(shape.position, shape.quaternion))
