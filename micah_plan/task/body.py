"""Bodies of a scene: solids around the object, such as a table, a stack of books or corridor walls."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import Primitive
from micah_plan.automaton.joint import IDENTITY, Quaternion, Vector3

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform


@dataclass(frozen=True)
class Hull:
    """A convex solid given by its corners, as meshes become.

    Attributes:
        vertices: corners in the shape's frame [m], at least four that span a volume.
        position, quaternion: pose of the shape's frame in the body's frame.
        color: ``"#rrggbb"``.
    """

    vertices: tuple[Vector3, ...]
    position: Vector3 = (0.0, 0.0, 0.0)
    quaternion: Quaternion = IDENTITY
    color: str = "#9aa5b1"


Shape = Primitive | Hull


@dataclass(frozen=True)
class Body:
    """A solid of the scene.

    Attributes:
        name: in messages and plans.
        shapes: its solids in its own frame.
        position, quaternion: pose of its frame in the base frame.
        mass: of a loose body, which can be pushed over [kg]; None: it is fixed. Planning takes both as fixed.
    """

    name: str
    shapes: tuple[Shape, ...]
    position: Vector3 = (0.0, 0.0, 0.0)
    quaternion: Quaternion = IDENTITY
    mass: float | None = None

    @property
    def pose(self) -> RigidTransform:
        """Pose of the body's frame in the base frame (single)."""
        return transform(self.position, self.quaternion)


def volume(shape: Shape) -> float:
    """Volume of a solid [m^3]; of a mesh that of its bounding box."""
    if isinstance(shape, Hull):
        return float(np.prod(np.ptp(np.array(shape.vertices), axis=0)))
    if shape.kind == "box":
        return math.prod(shape.size)
    radius = shape.size[0]
    return math.pi * radius**2 * shape.size[1] if shape.kind == "cylinder" else 4.0 / 3.0 * math.pi * radius**3


def transform(position: Vector3, quaternion: Quaternion) -> RigidTransform:
    """The pose (single) with a position [m] and an orientation, scalar last."""
    from scipy.spatial.transform import RigidTransform, Rotation

    return RigidTransform.from_components(position, Rotation.from_quat(quaternion))


def vector3(values: Floats) -> Vector3:
    """Three numbers (3,) as a plain value."""
    x, y, z = np.asarray(values).tolist()
    return x, y, z


def corners(shape: Shape) -> Floats:
    """(k, 3) corners of a hull, or of the box around a primitive, in the frame of the body [m]."""
    from micah_plan.automaton.contacts.touch import box_corners

    if isinstance(shape, Hull):
        return np.asarray(transform(shape.position, shape.quaternion).apply(shape.vertices))
    return box_corners((shape,))
