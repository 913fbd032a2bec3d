"""Values of a held object among bodies: the grasp, the touching surfaces, and the surroundings.

To hold means here that the hand carries a part, which the grip fixes to it; that a mode fixes a coordinate is called a
pin (`hybrid.Pin`).

Shapes of a held object are given in a frame that is the same in any model of it, from any camera: its origin lies on
the joint's axis, y is the axis, and as the joint's coordinate grows the moving part rotates from x towards z (with a
prismatic joint: moves along z). Both parts are described at one configuration, the datum: where the object latches.
"""

from __future__ import annotations

from dataclasses import dataclass

from micah_plan.automaton.hybrid import Part
from micah_plan.automaton.joint import Vector3

AXES = ("x", "y", "z")
# Name of the mode of an object that has hit something.
COLLIDED = "collided"


HINGE: Vector3 = (0.0, 1.0, 0.0)
"""Direction, in the frame of the hinge, about which a held part turns in the hand."""


@dataclass(frozen=True)
class Grip:
    """How a hand holds an object: by one of its two parts, the held one, while the other swings freely.

    Attributes:
        held, moving: the two parts, with their shapes in the hinge frame and the joint at the datum.
        point: of the hand, in the hinge frame [m]. Its position in the base frame is the state (x, y, z).
        rotation: rotation vector from the hinge frame to the base frame without contact [rad]; the hand keeps it.
        pivots: whether the held part may turn in the hand about the hinge's direction when it is pressed on.
        travel: how far the joint opens from the datum [rad or m], towards smaller values.
        datum: configuration at which shapes are given; None: where the learned object latches.
        coordinate: name of the joint's coordinate.
    """

    held: Part
    moving: Part
    point: Vector3
    rotation: Vector3
    travel: float
    pivots: bool = False
    datum: float | None = None
    coordinate: str = "theta"


@dataclass(frozen=True)
class Solid:
    """A body of the surroundings: a box along the axes of the base frame, between two corners [m]."""

    name: str
    lower: Vector3
    upper: Vector3


@dataclass(frozen=True)
class Face:
    """A side of a solid that the moving part may touch.

    Attributes:
        solid: its name.
        axis: 0, 1 or 2 for x, y, z; sign: +1 or -1, of the outward normal.
        position: along the axis [m].
    """

    solid: str
    axis: int
    sign: int
    position: float


@dataclass(frozen=True)
class Surroundings:
    """The bodies around a held object.

    Attributes:
        solids: bodies that the object must not hit, except for contacts.
        faces: which faces the moving part may touch.
        lower, upper: corners of where the hand may go [m].
    """

    solids: tuple[Solid, ...]
    faces: tuple[Face, ...]
    lower: Vector3
    upper: Vector3


@dataclass(frozen=True)
class HandNoise:
    """Std of the hand's position: process (per step) and observation, per axis [m]; release: the upward step [m] that
    ends a contact."""

    process: Vector3 = (0.001, 0.001, 0.001)
    observation: Vector3 = (0.005, 0.005, 0.005)
    release: float = 0.0
