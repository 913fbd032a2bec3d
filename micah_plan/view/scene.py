"""The 3-D scene of a page as MeshCat commands. The only importer of meshcat.

MeshCat's own `Visualizer` starts a server that listens on all interfaces. Here its commands go to a list instead of to
a server, and the page carries the list: no process, no port. MeshCat's package imports that server (tornado, pyzmq,
IPython, Pillow) in any case, so its modules of geometry and commands are loaded here without the package.
"""

from __future__ import annotations

import base64
import re
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import umsgpack  # type: ignore[import-untyped]
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import Primitive
from micah_plan.errors import InputError, shown
from micah_plan.view.solids import Mesh

FRAMES_PER_SECOND = 30
_SMALLEST_SPAN = 0.01
_ROOT = "meshcat"  # of the viewer's scene tree
_REFERENCES = ("uuid", "geometry", "material")


def _meshcat_package() -> ModuleType:
    """A package with MeshCat's modules without its `__init__`; `meshcat` itself is unchanged."""
    place = find_spec("meshcat")
    if place is None or place.submodule_search_locations is None:
        raise ModuleNotFoundError("No module named 'meshcat'", name="meshcat")
    package = ModuleType("_meshcat_without_server")
    package.__path__ = list(place.submodule_search_locations)
    return sys.modules.setdefault(package.__name__, package)


_PACKAGE = _meshcat_package()
geometry, commands, paths, animation = (
    import_module(f"{_PACKAGE.__name__}.{name}") for name in ("geometry", "commands", "path", "animation")
)


def viewer_javascript() -> str:
    """MeshCat's viewer (three.js included), as its wheel ships it."""
    return Path(_PACKAGE.__path__[0], "viewer", "dist", "main.min.js").read_text(encoding="utf-8")


class DrawnScene:
    """A scene of objects at slash-separated paths with poses and one animation.

    The first name of a path is its layer, which the page can hide. Paths are made of `slug`s.
    """

    def __init__(self) -> None:
        self._commands: list[dict[str, Any]] = []
        self._identifiers: dict[str, str] = {}
        self._animation = animation.Animation(default_framerate=FRAMES_PER_SECOND)
        self._corners: list[Floats] = []

    def _send(self, command: Any) -> None:
        """Record a command, with identifiers that repeat from run to run."""
        self._commands.append(self._renumbered(command.lower()))

    def primitive(self, path: str, shape: Primitive, *, color: str | None = None, opacity: float = 1.0) -> None:
        """Draw a shape of a part at its pose below `path`."""
        turn = Rotation.identity()
        if shape.kind == "box":
            solid = geometry.Box([float(length) for length in shape.size])
        elif shape.kind == "cylinder":
            solid = geometry.Cylinder(height=float(shape.size[1]), radius=float(shape.size[0]))
            turn = Rotation.from_euler("x", 90, degrees=True)  # the viewer's cylinders stand along y
        elif shape.kind == "sphere":
            solid = geometry.Sphere(float(shape.size[0]))
        else:
            raise InputError(f"unknown kind of shape {shown(shape.kind)}", remedy="use box, cylinder or sphere")
        self._send(commands.SetObject(solid, _material(color or shape.color, opacity), _at(path)))
        rotation = Rotation.from_quat(shape.quaternion) * turn
        self.place(path, RigidTransform.from_components(shape.position, rotation))

    def mesh(self, path: str, mesh: Mesh, color: str, *, opacity: float = 1.0) -> None:
        """Draw triangles; an empty mesh is skipped."""
        if len(mesh.faces):
            solid = geometry.TriangularMeshGeometry(mesh.vertices, mesh.faces)
            self._send(commands.SetObject(solid, _material(color, opacity), _at(path)))

    def unit_sphere(self, path: str, color: str, *, opacity: float) -> None:
        """Add a sphere of radius 1 m, to be placed and scaled by an animation; visible through other objects."""
        self._send(commands.SetObject(geometry.Sphere(1.0), _material(color, opacity, depthTest=False), _at(path)))

    def lines(self, path: str, ends: Floats, color: str) -> None:
        """Thin line segments between the pairs of points in `ends` (2 k, 3)."""
        points = geometry.PointsGeometry(np.asarray(ends, dtype=np.float32).T)
        thin = geometry.LineSegments(points, geometry.LineBasicMaterial(color=_number(color)))
        self._send(commands.SetObject(thin, path=_at(path)))

    def place(self, path: str, pose: RigidTransform) -> None:
        """Set the pose of everything below `path` in its parent."""
        self._send(commands.SetTransform(pose.as_matrix(), _at(path)))

    def animate(self, path: str, times: Floats, poses: RigidTransform, *, scales: Floats | None = None) -> None:
        """Animate everything below `path`.

        Args:
            times: (k,) [s], increasing.
            poses: (k,) in the parent of `path`.
            scales: (k, 3), or None for 1.
        """
        frames = np.asarray(times, dtype=float) * FRAMES_PER_SECOND
        matrices = poses.as_matrix()
        self.place(path, RigidTransform.from_matrix(matrices[0]))
        for i, frame in enumerate(frames):
            view = animation.AnimationFrameVisualizer(self._animation, _at(path), float(frame))
            view.set_transform(matrices[i])
            if scales is not None:
                view.set_property("scale", "vector3", [float(s) for s in scales[i]])

    def reserve(self, points: Floats) -> None:
        """Include points (..., 3) in the camera's view."""
        flat = np.asarray(points, dtype=float).reshape(-1, 3)
        if len(flat):
            self._corners.append(np.array([flat.min(axis=0), flat.max(axis=0)]))

    def bounds(self) -> tuple[Floats, Floats]:
        """Lower and upper corner, (3,) each, of the reserved points, of at least a minimum size."""
        stacked = np.concatenate(self._corners) if self._corners else np.zeros((1, 3))
        lower, upper = stacked.min(axis=0), stacked.max(axis=0)
        if np.linalg.norm(upper - lower) < _SMALLEST_SPAN:
            lower, upper = lower - _SMALLEST_SPAN, upper + _SMALLEST_SPAN
        return np.asarray(lower), np.asarray(upper)

    def encoded(self) -> list[str]:
        """The commands in the viewer's own encoding (MessagePack), as base64 text."""
        recorded = list(self._commands)
        if self._animation.clips:
            recorded.append(self._renumbered(commands.SetAnimation(self._animation, play=False).lower()))
        return [base64.b64encode(umsgpack.packb(command)).decode("ascii") for command in recorded]

    def _renumbered(self, value: Any, key: str = "") -> Any:
        """MeshCat names objects by the clock; here the n-th name is always the same."""
        if isinstance(value, dict):
            return {name: self._renumbered(item, name) for name, item in value.items()}
        if isinstance(value, list):
            return [self._renumbered(item) for item in value]
        if key in _REFERENCES and isinstance(value, str):
            return self._identifiers.setdefault(value, f"00000000-0000-4000-8000-{len(self._identifiers):012d}")
        return value


def slug(name: str, index: int) -> str:
    """A path entry for a user's name: safe characters only, and unique by its index."""
    return f"{index}_{re.sub(r'[^0-9A-Za-z]+', '_', name)[:40]}"


def _at(path: str) -> Any:
    """MeshCat's path of an object."""
    return paths.Path((_ROOT,)).append(path)


def layer_path(layer: str) -> list[str]:
    """Path of a layer in the viewer's scene tree; ``runs/3`` is a layer within another."""
    return [_ROOT, *layer.split("/")]


def transforms(poses: Sequence[RigidTransform]) -> RigidTransform:
    """(k,) poses of k single ones."""
    return RigidTransform.from_matrix(np.stack([pose.as_matrix() for pose in poses]))


def _material(color: str, opacity: float, **properties: Any) -> Any:
    solid = opacity == 1.0
    if not solid:  # a ghost on the face of a solid lies behind it everywhere, not here and there
        properties |= {"polygonOffset": True, "polygonOffsetFactor": 1.0, "polygonOffsetUnits": 4.0}
    return geometry.MeshPhongMaterial(
        color=_number(color), opacity=opacity, shininess=20, depthWrite=solid, **properties
    )


def _number(color: str) -> int:
    if not re.fullmatch(r"#[0-9a-fA-F]{6}", color):
        raise InputError(f"a colour must be '#rrggbb'. Got {shown(color)}")
    return int(color[1:], 16)
