"""Triangle meshes of tubes, arrows and point clouds, which the viewer lacks. Lengths in m."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from micah_plan.arrays import Floats, Ints

_SIDES = 10


class Mesh(NamedTuple):
    """Triangles: vertices (v, 3) in m, faces (f, 3) of vertex indices."""

    vertices: Floats
    faces: Ints


def merge(meshes: Iterable[Mesh]) -> Mesh:
    """One mesh of several, so that the viewer draws and lists them as one object."""
    vertices: list[Floats] = []
    faces: list[Ints] = []
    offset = 0
    for mesh in meshes:
        vertices.append(mesh.vertices)
        faces.append(mesh.faces + offset)
        offset += len(mesh.vertices)
    if not vertices:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
    return Mesh(np.concatenate(vertices), np.concatenate(faces))


def tube(points: Floats, radius: float | Floats) -> Mesh:
    """A tube of round cross-section along a polyline.

    Args:
        points: (k, 3), k >= 1; repeated points are dropped.
        radius: of the tube, or (k,) radii along it.
    """
    radii = np.broadcast_to(np.asarray(radius, dtype=float), (len(points),))
    keep = np.r_[True, np.any(np.diff(points, axis=0) != 0, axis=1)] | np.r_[False, np.diff(radii) != 0]
    points, radii = np.asarray(points, dtype=float)[keep], radii[keep]
    if not np.any(np.diff(points, axis=0)):
        return merge([])
    normal, binormal = _cross_sections(points)
    angle = np.linspace(0.0, 2 * np.pi, _SIDES, endpoint=False)
    ring = np.cos(angle)[:, None] * normal[:, None] + np.sin(angle)[:, None] * binormal[:, None]
    body = (points[:, None] + radii[:, None, None] * ring).reshape(-1, 3)
    side = np.arange(_SIDES)
    lower = (np.arange(len(points) - 1)[:, None] * _SIDES + side).ravel()
    upper = (np.arange(len(points) - 1)[:, None] * _SIDES + (side + 1) % _SIDES).ravel()
    first, last = len(body), len(body) + 1
    end = (len(points) - 1) * _SIDES
    faces = np.concatenate(
        [
            np.column_stack([lower, upper, upper + _SIDES]),
            np.column_stack([lower, upper + _SIDES, lower + _SIDES]),
            np.column_stack([np.full(_SIDES, first), (side + 1) % _SIDES, side]),
            np.column_stack([np.full(_SIDES, last), end + side, end + (side + 1) % _SIDES]),
        ]
    )
    return Mesh(np.concatenate([body, points[:1], points[-1:]]), faces)


def straightened(points: Floats, tolerance: float = 1e-6) -> Floats:
    """(k', 3) a polyline (k, 3) without points that lie between their neighbours, within a tolerance [m]."""
    kept = [0]
    for k in range(1, len(points) - 1):
        way, ahead = points[k] - points[kept[-1]], points[k + 1] - points[k]
        length = float(np.linalg.norm(ahead))
        beside = np.linalg.norm(np.cross(way, ahead)) / length if length > 0 else 0.0
        if beside > tolerance or float(way @ ahead) < 0:
            kept.append(k)
    return np.asarray(points[[*kept, len(points) - 1]] if len(points) > 1 else points)


def arrow(start: Floats, end: Floats, radius: float) -> Mesh:
    """An arrow from start to end, (3,) each; the head takes up to a third of it."""
    start, end = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    length = float(np.linalg.norm(end - start))
    if length == 0.0:
        return merge([])
    neck = end - (end - start) / length * min(6.0 * radius, length / 3.0)
    return tube(np.array([start, neck, neck, end]), np.array([radius, radius, 2.6 * radius, 0.0]))


def beads(points: Floats, size: float) -> Mesh:
    """A small octahedron of half-width `size` at each of the points (k, 3)."""
    corners = size * np.concatenate([np.eye(3), -np.eye(3)])
    triangles = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])
    vertices = (np.asarray(points, dtype=float)[:, None] + corners).reshape(-1, 3)
    faces = (np.arange(len(points))[:, None, None] * 6 + triangles).reshape(-1, 3)
    return Mesh(vertices, faces)


def perpendicular(direction: Floats) -> Floats:
    """A unit vector (3,) at right angles to a nonzero direction (3,)."""
    helper = np.eye(3)[np.argmin(np.abs(direction))]
    across = np.cross(direction, helper)
    return np.asarray(across / np.linalg.norm(across))


def _cross_sections(points: Floats) -> tuple[Floats, Floats]:
    """(k, 3) normals and binormals along a polyline, carried from point to point so that the tube does not twist."""
    step = np.diff(points, axis=0)
    length = np.linalg.norm(step, axis=1)
    # A step of no length changes only the radius (the shoulder of an arrow): it keeps the direction before it.
    moving = length > 0
    source = np.maximum.accumulate(np.where(moving, np.arange(len(step)), np.argmax(moving)))
    step = step[source] / length[source][:, None]
    tangent = np.concatenate([step[:1], step[:-1] + step[1:], step[-1:]])
    weak = np.linalg.norm(tangent, axis=1) < 1e-9
    tangent[weak] = np.concatenate([step, step[-1:]])[weak]
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    normal = np.empty_like(tangent)
    normal[0] = perpendicular(tangent[0])
    for i in range(1, len(tangent)):
        across = normal[i - 1] - tangent[i] * (normal[i - 1] @ tangent[i])
        size = np.linalg.norm(across)
        normal[i] = across / size if size > 1e-9 else perpendicular(tangent[i])
    return normal, np.cross(tangent, normal)
