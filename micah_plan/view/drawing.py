"""Appearance of joints, frames, parts and the ground in the 3-D scene; default shapes by kind of joint."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.arrays import Floats
from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import HybridAutomaton, Link, Primitive
from micah_plan.automaton.joint import Joint, Quaternion
from micah_plan.automaton.kinematics import origin
from micah_plan.task.body import corners, vector3
from micah_plan.view.palette import BODY, FRAME_AXES, GRID, INK, MUTED
from micah_plan.view.placement import CURVE_POINTS, coordinate_range, joint_axis, joint_curve
from micah_plan.view.scene import DrawnScene, slug
from micah_plan.view.solids import arrow, merge, perpendicular, tube

_SMALLEST = 0.02


def circle(center: Floats, normal: Floats, radius: float) -> Floats:
    """(k, 3) closed circle."""
    angle = np.linspace(0.0, 2 * np.pi, CURVE_POINTS)[:, None]
    across = perpendicular(normal)
    return np.asarray(center + radius * (np.cos(angle) * across + np.sin(angle) * np.cross(normal, across)))


@dataclass(frozen=True, eq=False)
class JointLook:
    """How a joint is drawn.

    Attributes:
        color: of its path.
        size: of the object [m]; thicknesses follow it.
        thickness: of the path, relative to the usual.
        point: (3,) of the part whose path is drawn, in its frame [m]; None: its origin.
    """

    color: str
    size: float
    thickness: float = 1.0
    point: Floats | None = None


def draw_joint(scene: DrawnScene, path: str, joint: Joint, limits: tuple[float, float], look: JointLook) -> None:
    """Draw a joint in its parent's frame: an axis with an arrow, and an arc, a line or (rigid) a ring.

    Args:
        limits: configurations between which it moves [rad or m].
    """
    size, thickness, color = look.size, look.thickness, look.color
    curve = joint_curve(joint, *limits, look.point)
    axis = joint_axis(joint, 1.1 * size if joint.slides else 1.25 * size)
    scene.reserve(curve)
    if joint.moves and axis is None:
        scene.mesh(f"{path}/path", tube(curve, 0.008 * thickness * size), color)
        return
    if axis is None:
        rings = [tube(circle(curve[0], normal, 0.07 * size), 0.007 * thickness * size) for normal in np.eye(3)[1:]]
        scene.mesh(f"{path}/rigid", merge(rings), color)
        return
    if joint.turns:
        scene.reserve(axis)
        scene.mesh(f"{path}/axis", arrow(axis[0], axis[1], 0.009 * size), INK)
        scene.mesh(f"{path}/path", tube(curve, 0.008 * thickness * size), color)
    else:
        scene.mesh(f"{path}/path", arrow(curve[0], curve[-1], 0.009 * thickness * size), color)


def draw_frame(scene: DrawnScene, path: str, length: float) -> None:
    """A coordinate frame: x red, y green, z blue."""
    for name, direction, color in zip("xyz", np.eye(3), FRAME_AXES, strict=True):
        scene.mesh(f"{path}/{name}", arrow(np.zeros(3), length * direction, 0.03 * length), color)


def draw_ground(scene: DrawnScene) -> float:
    """Draw a ground grid; returns the spacing of its lines [m] (1, 2 or 5 times a power of ten)."""
    lower, upper = scene.bounds()
    span = float(np.linalg.norm(upper - lower))
    spacing = rounded_up(span / 8)
    half = spacing * math.ceil(0.9 * span / spacing)
    center = spacing * np.round((lower + upper)[:2] / 2 / spacing)
    offsets = np.arange(-half, half + spacing / 2, spacing)
    floor = lower[2] - 0.04 * span
    ends = []
    for offset in offsets:
        ends += [[offset, -half, 0.0], [offset, half, 0.0], [-half, offset, 0.0], [half, offset, 0.0]]
    scene.lines("ground/grid", np.array(ends) + np.array([*center, floor]), GRID)
    return spacing


def link_shapes(automaton: HybridAutomaton, link: int) -> tuple[Primitive, ...]:
    """The shapes of a link's child; default ones by joint if no moving part has any.

    A part without shapes among others that have some is a frame only, such as the hand of a held object.
    """
    if any(automaton.part(item.child).shapes for item in automaton.links):
        return automaton.part(automaton.links[link].child).shapes
    return moving_shapes(automaton.moving_joint(link), reach(automaton, link))


def shown_links(automaton: HybridAutomaton) -> list[tuple[int, Link]]:
    """The links whose child is drawn, with their numbers."""
    return [(number, link) for number, link in enumerate(automaton.links) if link_shapes(automaton, number)]


def fixed_shapes(automaton: HybridAutomaton) -> tuple[Primitive, ...]:
    """The shapes of fixed parts, or default ones that carry the joints attached to the base."""
    children = {link.child for link in automaton.links}
    shapes = tuple(shape for part in automaton.parts if part.name not in children for shape in part.shapes)
    if shapes:
        return shapes
    carried = (i for i, link in shown_links(automaton) if link.parent not in children)
    return tuple(s for i in carried for s in base_shapes(automaton.moving_joint(i), reach(automaton, i)))


def with_shapes(automaton: HybridAutomaton) -> HybridAutomaton:
    """The model with default shapes where no moving part has any."""
    if any(automaton.part(link.child).shapes for link in automaton.links):
        return automaton
    shapes = {link.child: link_shapes(automaton, number) for number, link in enumerate(automaton.links)}
    if not automaton.part(BASE).shapes:
        shapes[BASE] = fixed_shapes(automaton)
    parts = {part.name: part for part in automaton.parts} | {name: automaton.part(name) for name in shapes}
    return replace(automaton, parts=tuple(replace(part, shapes=shapes.get(name, ())) for name, part in parts.items()))


def reach(automaton: HybridAutomaton, link: int) -> float:
    """Largest displacement of a link's part over all modes [m]."""
    number = automaton.links[link].coordinate
    limits = [coordinate_range(automaton, mode, number)[:2] for mode in automaton.modes]
    joint = automaton.moving_joint(link)
    path = joint_curve(joint, min(lo for lo, _ in limits), max(hi for _, hi in limits))
    return float(np.linalg.norm(path[:, None] - path[None], axis=-1).max())


def object_size(automaton: HybridAutomaton) -> float:
    """Length scale of symbols [m]: largest distance of a part from its axis, or of its motion."""
    sizes = [0.02]
    for number, _ in shown_links(automaton):
        joint = automaton.moving_joint(number)
        if joint.turns:
            sizes.append(float(np.linalg.norm(np.array(joint.position) - joint.center)))
        elif joint.moves:
            sizes.append(reach(automaton, number))
        sizes += [float(max(shape.size)) for shape in link_shapes(automaton, number)]
    return max(sizes)


def draw_shapes(
    scene: DrawnScene, path: str, shapes: tuple[Primitive, ...], *, color: str | None = None, opacity: float = 1.0
) -> None:
    """Draw all shapes of a body below one path."""
    for number, shape in enumerate(shapes):
        scene.primitive(f"{path}/{slug(shape.kind, number)}", shape, color=color, opacity=opacity)


def draw_copy(
    scene: DrawnScene, path: str, shapes: tuple[Primitive, ...], pose: RigidTransform, color: str, opacity: float
) -> None:
    """Draw a translucent copy of a body at one pose (single), within the camera's view."""
    draw_shapes(scene, path, shapes, color=color, opacity=opacity)
    scene.place(path, pose)
    scene.reserve(shape_corners(shapes, pose))


def shape_corners(shapes: tuple[Primitive, ...], pose: RigidTransform) -> Floats:
    """(k, 3) corners of boxes around the shapes of a body at a pose (single), for `Scene.reserve`."""
    return np.concatenate([np.zeros((0, 3)), *(pose.apply(corners(shape)) for shape in shapes)])


def moving_shapes(joint: Joint, reach: float) -> tuple[Primitive, ...]:
    """Default shapes of a moving part, in its own frame.

    A thin panel from the axis to the part's origin for revolute and screw, a box along the motion for prismatic, a
    small cube for rigid and path.

    Args:
        joint: that moves the part.
        reach: length of its motion, to scale a prismatic part by [m].
    """
    pose = origin(joint)
    axis = np.array(joint.axis)
    if joint.slides:
        length = max(reach, 2 * _SMALLEST)
        frame = _level_frame(axis)
        return (_box(pose, pose.translation, frame, (length, 0.7 * length, 0.35 * length)),)
    arm = np.array(joint.position) - joint.center
    radius = float(np.linalg.norm(arm))
    if not joint.has_axis or radius < _SMALLEST / 4:
        return (_box(pose, pose.translation, np.eye(3), (_SMALLEST,) * 3),)
    frame = np.column_stack([arm / radius, np.cross(axis, arm / radius), axis])
    return (_box(pose, joint.center + arm / 2, frame, (radius, 0.05 * radius, 0.75 * radius)),)


def base_shapes(joint: Joint, reach: float) -> tuple[Primitive, ...]:
    """Default shapes of a joint's base in the base frame: a post on the axis, or a rail."""
    axis, position = np.array(joint.axis), np.array(joint.position)
    if not joint.has_axis:
        return ()
    if joint.slides:
        length = max(reach, 2 * _SMALLEST)
        frame = _level_frame(axis)
        center = position + axis * length / 2 - frame[:, 2] * 0.22 * length
        return (_box(RigidTransform.identity(), center, frame, (2 * length, 0.75 * length, 0.04 * length), MUTED),)
    radius = max(float(np.linalg.norm(position - joint.center)), _SMALLEST)
    across = perpendicular(axis)
    upright = Rotation.from_matrix(np.column_stack([across, np.cross(axis, across), axis]))
    return (Primitive("cylinder", (0.06 * radius, 0.85 * radius), joint.center, _quaternion(upright), MUTED),)


def _level_frame(axis: Floats) -> Floats:
    """(3, 3) right-handed axes in columns: motion, across, and closest to vertical."""
    upright = np.array([0.0, 0.0, 1.0]) - axis[2] * axis
    size = float(np.linalg.norm(upright))
    upright = upright / size if size > 0.1 else perpendicular(axis)
    return np.column_stack([axis, np.cross(upright, axis), upright])


def _box(
    part: RigidTransform, center: Floats, frame: Floats, size: tuple[float, float, float], color: str = BODY
) -> Primitive:
    """A box given in the base frame, written in the frame of a part at pose `part`."""
    relative = part.inv() * RigidTransform.from_components(center, Rotation.from_matrix(frame))
    return Primitive("box", size, vector3(relative.translation), _quaternion(relative.rotation), color)


def _quaternion(rotation: Rotation) -> Quaternion:
    x, y, z, w = rotation.as_quat().tolist()
    return x, y, z, w


def rounded_up(length: float) -> float:
    """The next round number: 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(length))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power >= length * 0.999)
