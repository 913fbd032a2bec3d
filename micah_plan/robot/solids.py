"""Shapes as Coal solids, and an arm's solids as shapes to draw."""

from __future__ import annotations

from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import Primitive
from micah_plan.automaton.joint import Quaternion, Vector3
from micah_plan.errors import InputError, shown
from micah_plan.robot.arm import Arm
from micah_plan.task.body import Hull, Shape, vector3

_DEFAULT_COLOR = "#c9d1d9"
_DIRECTIONS = 12
_PRIMITIVES = {"box": coal.Box, "cylinder": coal.Cylinder, "sphere": coal.Sphere}


class LinkShape(NamedTuple):
    """A solid of a link.

    Attributes:
        joint: number of the joint that moves it, from 1; 0 if none does.
        shape: in the frame of that joint.
    """

    joint: int
    shape: Shape


def solid(shape: Shape) -> tuple[Any, Any]:
    """A shape as (Coal geometry, Pinocchio pose in the body's frame).

    Raises:
        InputError: for an unknown kind of primitive, or corners without volume.
    """
    placement = pin.SE3(Rotation.from_quat(shape.quaternion).as_matrix(), np.array(shape.position))
    if isinstance(shape, Hull):
        return convex(np.array(shape.vertices)), placement
    if shape.kind not in _PRIMITIVES:
        raise InputError(f"unknown kind of shape {shown(shape.kind)}", remedy="use box, cylinder, sphere or mesh")
    return _PRIMITIVES[shape.kind](*shape.size), placement


def arm_shapes(arm: Arm) -> tuple[LinkShape, ...]:
    """The solids of the arm's clearances, as shapes to draw."""
    solids = []
    for item in arm.geometry.geometryObjects:
        x, y, z, w = Rotation.from_matrix(item.placement.rotation).as_quat().tolist()
        place = vector3(item.placement.translation), (x, y, z, w), arm.colors.get(item.name, _DEFAULT_COLOR)
        solids.append(LinkShape(int(item.parentJoint), _drawn(item.geometry, *place)))
    return tuple(solids)


def mesh_hulls(arm: Arm) -> dict[tuple[str, Vector3], Floats]:
    """(k, 3) corners [m] of the convex hulls that stand for the robot's meshes, scaled, by file and scale."""
    meshes = [item for item in arm.geometry.geometryObjects if isinstance(item.geometry, coal.ConvexBase)]
    return {(item.meshPath, vector3(item.meshScale)): _corners(item.geometry) for item in meshes if item.meshPath}


def _drawn(geometry: Any, position: Vector3, quaternion: Quaternion, color: str) -> Shape:
    if isinstance(geometry, coal.Box):
        return Primitive("box", vector3(2 * geometry.halfSide), position, quaternion, color)
    if isinstance(geometry, coal.Cylinder):
        return Primitive("cylinder", (geometry.radius, 2 * geometry.halfLength), position, quaternion, color)
    if isinstance(geometry, coal.Sphere):
        return Primitive("sphere", (geometry.radius,), position, quaternion, color)
    points = _corners(geometry)
    return Hull(tuple(vector3(point) for point in points), position, quaternion, color)


def _corners(geometry: Any) -> Floats:
    """(k, 3) corners of a convex solid; of a round one, points on its surface."""
    if isinstance(geometry, coal.ConvexBase):
        return np.array(geometry.points())
    angle = np.linspace(0.0, 2 * np.pi, _DIRECTIONS, endpoint=False)
    height = np.linspace(-1.0, 1.0, _DIRECTIONS // 2 + 1)
    ring = np.sqrt(1 - height**2)
    x, y, z = np.outer(np.cos(angle), ring), np.outer(np.sin(angle), ring), np.tile(height, (len(angle), 1))
    sphere = np.unique(np.round(np.stack([x, y, z], axis=-1).reshape(-1, 3), 12), axis=0)
    if isinstance(geometry, coal.Capsule):
        shift = np.array([0.0, 0.0, geometry.halfLength])
        return np.concatenate([geometry.radius * sphere + shift, geometry.radius * sphere - shift])
    if isinstance(geometry, coal.Ellipsoid):
        return np.asarray(sphere * np.array(geometry.radii))
    geometry.computeLocalAABB()  # all others are drawn as their bounding box
    box = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, -1).T
    return np.asarray(geometry.aabb_local.min_ + box * (geometry.aabb_local.max_ - geometry.aabb_local.min_))


def convex(points: Floats) -> Any:
    """The convex hull of corners (k, 3) [m], as a Coal solid."""
    hull = ConvexHull(points)
    number = np.full(len(points), -1)
    number[hull.vertices] = np.arange(len(hull.vertices))
    corners, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for index in hull.vertices:
        corners.append(points[index])
    for simplex, normal in zip(hull.simplices, hull.equations[:, :3], strict=True):
        a, b, c = points[simplex]
        # Qhull leaves the sense of rotation open; Coal wants it seen from outside.
        order = simplex if np.cross(b - a, c - a) @ normal > 0 else simplex[::-1]
        triangles.append(coal.Triangle(*(int(number[i]) for i in order)))
    return coal.Convex(corners, triangles)
