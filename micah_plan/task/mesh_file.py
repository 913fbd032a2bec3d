"""Meshes (STL, OBJ) as convex hulls, `load_hull`, or as boxes, `load_box`.

Only the corners are read: planning and drawing use the convex hull, so a body that is not convex is given as several
meshes or primitives.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.joint import Vector3
from micah_plan.errors import InputError
from micah_plan.files import read_bytes
from micah_plan.task.body import vector3

LARGEST_MESH_BYTES = 64 * 1024 * 1024
MOST_CORNERS = 2000
THINNEST = 1e-3  # m
_STL_HEADER, _STL_TRIANGLE = 84, 50


def load_hull(path: str | Path, scale: Vector3 = (1.0, 1.0, 1.0)) -> tuple[Vector3, ...]:
    """Corners of the convex hull of a mesh, in the mesh's frame [m].

    Args:
        path: an .stl (binary or text) or .obj file.
        scale: factors per axis, e.g. 0.001 for millimetres.

    Raises:
        InputError: if it is no such mesh, has no volume or a hull of more than `MOST_CORNERS` corners.
    """
    return convex_corners(_points(path, scale), path)


def load_box(path: str | Path, scale: Vector3 = (1.0, 1.0, 1.0)) -> tuple[Vector3, Vector3]:
    """Full lengths and centre of the box around a mesh along its own axes [m]; a flat one is `THINNEST` thick.

    Args:
        path, scale: as for `load_hull`.

    Raises:
        InputError: if it is no such mesh, or has corners that are no numbers or kilometres away.
    """
    points = _points(path, scale)
    _check_places(points, path)
    if not len(points):
        raise InputError("expected a mesh, found no corners", source=path, remedy="leave it out")
    low, high = points.min(axis=0), points.max(axis=0)
    return vector3(np.maximum(high - low, THINNEST)), vector3((low + high) / 2)


def _points(path: str | Path, scale: Vector3) -> Floats:
    """(k, 3) the corners of a mesh [m]."""
    data, kind = read_bytes(path, LARGEST_MESH_BYTES), Path(path).suffix.lower()
    if kind == ".obj":
        points = _text_vertices(data, b"v", path)
    elif kind == ".stl":
        binary = _binary_stl(data)
        points = _text_vertices(data, b"vertex", path) if binary is None else binary
    else:
        raise InputError(f"expected an .stl or .obj mesh, found '{kind}'", source=path, remedy="convert it")
    return np.asarray(points * np.array(scale))


def _check_places(points: Floats, source: str | Path | None) -> None:
    if not np.isfinite(points).all() or np.abs(points).max(initial=0.0) > 1e6:
        raise InputError("a mesh has corners that are no numbers or kilometres away", source=source)


def convex_corners(points: Floats, source: str | Path | None = None) -> tuple[Vector3, ...]:
    """The corners of the convex hull of points (k, 3) [m].

    Raises:
        InputError: as for `load_hull`.
    """
    from scipy.spatial import ConvexHull, QhullError

    _check_places(points, source)
    try:
        hull = points[ConvexHull(points).vertices] if len(points) >= 4 else None
    except QhullError:
        hull = None
    if hull is None:
        raise InputError("a mesh needs at least four corners that span a volume", source=source, remedy="thicken it")
    if len(hull) > MOST_CORNERS:
        problem = f"expected a convex hull of at most {MOST_CORNERS} corners, found {len(hull)}"
        raise InputError(problem, source=source, remedy="simplify the mesh")
    return tuple(map(vector3, hull))


def _binary_stl(data: bytes) -> Floats | None:
    """(3 n, 3) corners of a binary STL; None if its length is not that of one."""
    if len(data) < _STL_HEADER:
        return None
    (count,) = struct.unpack_from("<I", data, _STL_HEADER - 4)
    if len(data) != _STL_HEADER + _STL_TRIANGLE * count:
        return None
    rows = np.frombuffer(data, np.uint8, offset=_STL_HEADER).reshape(count, _STL_TRIANGLE)
    return rows[:, 12:48].copy().view("<f4").astype(float).reshape(-1, 3)


def _text_vertices(data: bytes, key: bytes, source: str | Path) -> Floats:
    """(n, 3) numbers on the lines that start with a word."""
    meshes = []
    for number, line in enumerate(data.splitlines(), start=1):
        words = line.split()
        if words and words[0] == key:
            try:
                meshes.append([float(word) for word in words[1:4]])
            except ValueError:
                meshes.append([])
            if len(meshes[-1]) != 3:
                raise InputError("expected three numbers of a corner", source=source, where=f"line {number}")
    return np.array(meshes, dtype=float).reshape(-1, 3)
