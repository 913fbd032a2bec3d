"""How joints, frames, bodies and the ground look: in the 3-D scene, and as curves that the figures share."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.automaton.hybrid import HybridAutomaton, Link, Primitive
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.kinematics import forward
from micah_plan.automaton.tracks import moving_joint
from micah_plan.view.default_shapes import base_shapes, moving_shapes
from micah_plan.view.palette import FRAME_AXES, GRID, INK
from micah_plan.view.placement import coordinate_range
from micah_plan.view.scene import Scene, slug
from micah_plan.view.solids import arrow, merge, perpendicular, tube

Floats = NDArray[np.float64]

VIEW_ANGLE_DEG = 36.0
_MARGIN = 1.08
_HIDDEN_COST = 2.0
_CURVE_POINTS = 49
_ELEVATION, _LOW_ELEVATION = math.radians(28.0), math.radians(13.0)
_AZIMUTHS = np.radians(np.arange(-60, 300, 15))


def joint_curve(joint: Joint, lower: float, upper: float, point: Floats | None = None) -> Floats:
    """(k, 3) path of a point of the part [part frame, m; None: its origin] from one configuration to another.

    An arc for revolute, a helix for screw, a line for prismatic, one point for rigid.
    """
    count = 1 if joint.kind == "rigid" else 2 if joint.kind == "prismatic" else _CURVE_POINTS
    poses = forward(joint, np.linspace(lower, upper, count))
    return np.asarray(poses.apply(np.zeros(3) if point is None else point))


def joint_axis(joint: Joint, length: float) -> Floats | None:
    """(2, 3) ends of the axis to draw, centred beside the part's origin; None for rigid."""
    if joint.kind == "rigid":
        return None
    axis = np.array(joint.axis)
    middle = np.array(joint.position if joint.kind == "prismatic" else joint.center)
    return np.stack([middle - axis * length / 2, middle + axis * length / 2])


def circle(center: Floats, normal: Floats, radius: float) -> Floats:
    """(k, 3) closed circle."""
    angle = np.linspace(0.0, 2 * np.pi, _CURVE_POINTS)[:, None]
    across = perpendicular(normal)
    return np.asarray(center + radius * (np.cos(angle) * across + np.sin(angle) * np.cross(normal, across)))


def draw_joint(
    scene: Scene,
    path: str,
    joint: Joint,
    limits: tuple[float, float],
    color: str,
    size: float,
    point: Floats | None = None,
    thickness: float = 1.0,
) -> None:
    """A joint in the frame of its parent: an axis with an arrow, and an arc, a line or (rigid) a ring.

    Args:
        limits: configurations between which it moves [rad or m].
        size: of the object [m]; thicknesses follow it.
        point: the point of the part whose path is drawn, in its frame [m]; None: its origin.
        thickness: of the path, relative to the usual.
    """
    curve = joint_curve(joint, *limits, point)
    axis = joint_axis(joint, 1.1 * size if joint.kind == "prismatic" else 1.25 * size)
    scene.reserve(curve)
    if axis is None:
        rings = [tube(circle(curve[0], normal, 0.07 * size), 0.007 * thickness * size) for normal in np.eye(3)[1:]]
        scene.mesh(f"{path}/rigid", merge(rings), color)
        return
    if joint.kind in ("revolute", "screw"):
        scene.reserve(axis)
        scene.mesh(f"{path}/axis", arrow(axis[0], axis[1], 0.009 * size), INK)
        scene.mesh(f"{path}/path", tube(curve, 0.008 * thickness * size), color)
    else:
        scene.mesh(f"{path}/path", arrow(curve[0], curve[-1], 0.009 * thickness * size), color)


def draw_frame(scene: Scene, path: str, length: float) -> None:
    """A coordinate frame: x red, y green, z blue."""
    for name, direction, color in zip("xyz", np.eye(3), FRAME_AXES, strict=True):
        scene.mesh(f"{path}/{name}", arrow(np.zeros(3), length * direction, 0.03 * length), color)


def draw_ground(scene: Scene) -> float:
    """A grid under what the camera sees; returns the spacing of its lines [m] (1, 2 or 5 times a power of ten)."""
    lower, upper = scene.bounds()
    span = float(np.linalg.norm(upper - lower))
    spacing = _round_length(span / 8)
    half = spacing * math.ceil(0.9 * span / spacing)
    center = spacing * np.round((lower + upper)[:2] / 2 / spacing)
    offsets = np.arange(-half, half + spacing / 2, spacing)
    floor = lower[2] - 0.04 * span
    ends = []
    for offset in offsets:
        ends += [[offset, -half, 0.0], [offset, half, 0.0], [-half, offset, 0.0], [half, offset, 0.0]]
    scene.lines("ground/grid", np.array(ends) + np.array([*center, floor]), GRID)
    return spacing


def camera(scene: Scene, motion: Floats, blockers: Floats | None = None) -> dict[str, object]:
    """Position, target and clipping that show the whole scene, from where the motion spreads widest.

    Args:
        motion: (k, 3) points that the moving parts pass.
        blockers: (b, 2, 3) lower and upper corners of boxes that should not stand before them [m].
    """
    lower, upper = scene.bounds()
    target = (lower + upper) / 2
    radius = max(float(np.linalg.norm(upper - lower)) / 2, 1e-3)
    best = viewing_direction(motion, target, radius, blockers)
    distance = _distance_to_see(upper - target, best)
    position = target + distance * best
    return {
        "position": [float(p) for p in position],
        "target": [float(p) for p in target],
        "near": distance / 200,
        "far": distance * 50,
        "angle": VIEW_ANGLE_DEG,
    }


def viewing_direction(motion: Floats, target: Floats, radius: float, blockers: Floats | None = None) -> Floats:
    """(3,) unit vector from the target (3,) [m] towards a camera, a little above, that sees the motion (k, 3) best.

    Args:
        radius: of what the camera looks at [m].
        blockers: as for `camera`.
    """
    toward = _directions(_ELEVATION)
    if blockers is not None and len(blockers):
        toward = np.concatenate([toward, _directions(_LOW_ELEVATION)])  # to look under what stands above
    hidden = [_hidden_share(way, motion, blockers) for way in toward]
    quality = [_view_quality(way, motion, target, radius) for way in toward]
    return np.asarray(toward[np.argmax(np.array(quality) - _HIDDEN_COST * np.array(hidden))])


def _directions(elevation: float) -> Floats:
    """(a, 3) unit vectors all around, at an elevation [rad]."""
    level = math.cos(elevation) * np.stack([np.cos(_AZIMUTHS), np.sin(_AZIMUTHS)], axis=1)
    return np.column_stack([level, np.full(len(level), math.sin(elevation))])


def _hidden_share(way: Floats, motion: Floats, blockers: Floats | None) -> float:
    """Share of the points (k, 3) that a camera in direction `way` does not see for the boxes (b, 2, 3)."""
    if blockers is None or not len(blockers):
        return 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = (blockers[None] - motion[:, None, None]) / way  # (k, b, 2, 3): where the rays cross the boxes' planes
    enter, leave = np.nanmax(ends.min(axis=2), axis=2), np.nanmin(ends.max(axis=2), axis=2)
    return float(((leave > enter) & (leave > 0)).any(axis=1).mean())


def _distance_to_see(half: Floats, way: Floats) -> float:
    """Distance at which a camera in direction `way` sees a box of half lengths `half` in a square picture [m]."""
    across = np.cross([0.0, 0.0, 1.0], way)
    across /= np.linalg.norm(across)
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T * half
    offset = np.abs(corners @ np.column_stack([across, np.cross(way, across)])).max(axis=1)
    tangent = math.tan(math.radians(VIEW_ANGLE_DEG) / 2)
    return float((corners @ way + _MARGIN * offset / tangent).max())


def _view_quality(way: Floats, motion: Floats, target: Floats, radius: float) -> float:
    """How well a camera in direction `way` (unit, (3,)) shows the motion; larger is better.

    It should see the motion spread out (an arc as an arc), stand on the side of the moving part, and a little off the
    perpendicular of the motion, where a panel would be edge on in the middle of its swing.
    """
    centred = motion - motion.mean(axis=0)
    flat = centred - np.outer(centred @ way, way)
    wide, high, _ = np.sqrt(np.linalg.svd(flat.T @ flat, compute_uv=False))
    directions, extent, _ = np.linalg.svd(centred.T @ centred)
    spread = (0.3 * wide + high) / max(math.sqrt(extent[0]), 1e-12)
    side = float(way @ (motion.mean(axis=0) - target)) / radius
    off_perpendicular = abs(abs(float(way @ directions[:, 0])) - 0.45)
    return float(spread + 0.5 * side - 0.8 * off_perpendicular)


def link_shapes(automaton: HybridAutomaton, link: int) -> tuple[Primitive, ...]:
    """The shapes of a link's child; default ones that follow its joint if no part that moves has any.

    A part without shapes among others that have some is a frame only, such as the hand of a held object.
    """
    if any(automaton.part(item.child).shapes for item in automaton.links):
        return automaton.part(automaton.links[link].child).shapes
    return moving_shapes(moving_joint(automaton, link), reach(automaton, link))


def shown_links(automaton: HybridAutomaton) -> list[tuple[int, Link]]:
    """The links whose child is drawn, with their numbers."""
    return [(number, link) for number, link in enumerate(automaton.links) if link_shapes(automaton, number)]


def fixed_shapes(automaton: HybridAutomaton) -> tuple[Primitive, ...]:
    """The shapes of parts that nothing moves, or default ones that carry the joints attached to the base."""
    children = {link.child for link in automaton.links}
    shapes = tuple(shape for part in automaton.parts if part.name not in children for shape in part.shapes)
    if shapes:
        return shapes
    carried = (i for i, link in shown_links(automaton) if link.parent not in children)
    return tuple(s for i in carried for s in base_shapes(moving_joint(automaton, i), reach(automaton, i)))


def reach(automaton: HybridAutomaton, link: int) -> float:
    """How far the part of a link moves over all modes [m]: the longest distance between two of its positions."""
    number = automaton.links[link].coordinate
    limits = [coordinate_range(automaton, mode, number)[:2] for mode in automaton.modes]
    joint = moving_joint(automaton, link)
    path = joint_curve(joint, min(lo for lo, _ in limits), max(hi for _, hi in limits))
    return float(np.linalg.norm(path[:, None] - path[None], axis=-1).max())


def object_size(automaton: HybridAutomaton) -> float:
    """A length to scale symbols by [m]: the farthest that a part lies from its axis or moves."""
    sizes = [0.02]
    for number, _ in shown_links(automaton):
        joint = moving_joint(automaton, number)
        if joint.kind in ("revolute", "screw"):
            sizes.append(float(np.linalg.norm(np.array(joint.position) - joint.center)))
        elif joint.kind == "prismatic":
            sizes.append(reach(automaton, number))
        sizes += [float(max(shape.size)) for shape in link_shapes(automaton, number)]
    return max(sizes)


def draw_shapes(
    scene: Scene, path: str, shapes: tuple[Primitive, ...], *, color: str | None = None, opacity: float = 1.0
) -> None:
    """All shapes of a body below one path."""
    for number, shape in enumerate(shapes):
        scene.primitive(f"{path}/{slug(shape.kind, number)}", shape, color=color, opacity=opacity)


def shape_corners(shapes: tuple[Primitive, ...], pose: RigidTransform) -> Floats:
    """(k, 3) corners of boxes around the shapes of a body at a pose (single), for `Scene.reserve`."""
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    corners = [np.zeros((0, 3))]
    for shape in shapes:
        half = _half_lengths(shape)
        local = RigidTransform.from_components(shape.position, Rotation.from_quat(shape.quaternion))
        corners.append((pose * local).apply(signs * half))
    return np.concatenate(corners)


def _half_lengths(shape: Primitive) -> Floats:
    if shape.kind == "box":
        return np.array(shape.size) / 2
    if shape.kind == "cylinder":
        return np.array([shape.size[0], shape.size[0], shape.size[1] / 2])
    return np.full(3, shape.size[0])


def _round_length(length: float) -> float:
    power = 10.0 ** math.floor(math.log10(length))
    return power * next(step for step in (1, 2, 5, 10) if step * power >= length * 0.999)
