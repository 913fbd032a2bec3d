"""The true microwave and drawer of the simulated demonstrations: mechanism, shapes and handles, in one place.

The base frame has x to the right, y out of the front and z up, in metres. `micah-plan learn` does not see these values;
it sees recordings. Shapes and handles are not learned: a learned model takes them from `microwave_parts` and
`drawer_parts`, which are given in each part's own frame, the one that the tracker reports.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.automaton.hybrid import (
    Coordinate,
    Edge,
    HybridAutomaton,
    Link,
    Mode,
    Noise,
    Part,
    Pin,
    Primitive,
)
from micah_plan.automaton.joint import prismatic, revolute, rigid
from micah_plan.automaton.kinematics import forward
from micah_plan.automaton.region import Region, above, below, box, input_below

DOOR_OPEN = 1.2
"""Angle between the open door, where demonstrations start, and the shut one [rad]."""

DRAWER_TRAVEL = 0.32
"""From shut to the end stop [m]."""

_HINGE = (-0.24, 0.01, 0.0)
_TRACKED = 0.31
_DOOR = (0.36, 0.02, 0.28)
_BODY, _FRONT, _METAL = "#5b6470", "#c9d1d9", "#e6b450"


def microwave() -> HybridAutomaton:
    """A door on a vertical hinge at the left. It is 0 when open at 1.2 rad and latches shut at 1.2."""
    direction = Rotation.from_rotvec([0.0, 0.0, DOOR_OPEN])
    tracked = np.array(_HINGE) + direction.apply([_TRACKED, 0.0, 0.0])
    swing = revolute((0.0, 0.0, -1.0), _HINGE, tracked, direction.as_quat())
    pose = forward(swing, DOOR_OPEN)[0]
    shut = rigid(pose.translation, pose.rotation.as_quat(), DOOR_OPEN)
    swinging = Mode("swinging", (swing,), ((1.0,),), box([0.0], [DOOR_OPEN], 1, ["door"]))
    latched = Mode("latched", (shut,), ((0.0,),), Region((above(0, DOOR_OPEN, 1, 1),)), pins=(Pin(0, DOOR_OPEN, 1e-3),))
    edges = (
        Edge("swinging", "latched", Region((above(0, DOOR_OPEN, 1, 1, name="door"),))),
        Edge("latched", "swinging", Region((input_below(0, 0.0, 1, 1, strict=True, name="input door"),))),
    )
    return _object("door", "rad", microwave_parts(), (swinging, latched), edges)


def drawer() -> HybridAutomaton:
    """A drawer that is 0 when shut and runs out along y to its end stop."""
    slide = prismatic((0.0, 1.0, 0.0), (0.0, 0.0, 0.0))
    sliding = Mode("sliding", (slide,), ((1.0,),), box([0.0], [DRAWER_TRAVEL], 1, ["drawer"]))
    stop = Edge("sliding", "sliding", Region((below(0, 0.0, 1, 1, strict=True, name="drawer"),)))
    return _object("drawer", "m", drawer_parts(), (sliding,), (stop,))


def microwave_parts() -> tuple[Part, ...]:
    """The oven and its door; the door's frame: x from the hinge along the door, y outwards, z up, origin 0.31 m out."""
    oven = Part(
        "base",
        (
            Primitive("box", (0.48, 0.36, 0.01), (0.0, -0.18, 0.145), color=_BODY),
            Primitive("box", (0.48, 0.36, 0.01), (0.0, -0.18, -0.145), color=_BODY),
            Primitive("box", (0.48, 0.01, 0.28), (0.0, -0.355, 0.0), color=_BODY),
            Primitive("box", (0.01, 0.36, 0.28), (-0.235, -0.18, 0.0), color=_BODY),
            Primitive("box", (0.12, 0.36, 0.28), (0.18, -0.18, 0.0), color=_BODY),
        ),
    )
    middle = 0.5 * _DOOR[0] - _TRACKED
    door = Part(
        "door",
        (
            Primitive("box", _DOOR, (middle, 0.0, 0.0), color=_FRONT),
            Primitive("cylinder", (0.008, 0.2), (0.03, 0.045, 0.0), color=_METAL),
        ),
        handle=(0.03, 0.045, 0.0),
    )
    return oven, door


def drawer_parts() -> tuple[Part, ...]:
    """The cabinet and its drawer; the drawer's frame is parallel to the base, its origin in the middle of the front."""
    cabinet = Part(
        "base",
        (
            Primitive("box", (0.44, 0.36, 0.01), (0.0, -0.19, 0.085), color=_BODY),
            Primitive("box", (0.44, 0.36, 0.01), (0.0, -0.19, -0.085), color=_BODY),
            Primitive("box", (0.01, 0.36, 0.16), (-0.215, -0.19, 0.0), color=_BODY),
            Primitive("box", (0.01, 0.36, 0.16), (0.215, -0.19, 0.0), color=_BODY),
            Primitive("box", (0.42, 0.01, 0.16), (0.0, -0.365, 0.0), color=_BODY),
        ),
    )
    sides = tuple(Primitive("box", (0.01, 0.33, 0.1), (x, -0.175, 0.0), color=_FRONT) for x in (-0.19, 0.19))
    sliding = Part(
        "drawer",
        (
            Primitive("box", (0.44, 0.02, 0.18), color=_FRONT),
            *sides,
            Primitive("box", (0.38, 0.33, 0.01), (0.0, -0.175, -0.045), color=_FRONT),
            Primitive("sphere", (0.015,), (0.0, 0.03, 0.0), color=_METAL),
        ),
        handle=(0.0, 0.03, 0.0),
    )
    return cabinet, sliding


def _object(
    name: str, unit: str, parts: tuple[Part, ...], modes: tuple[Mode, ...], edges: tuple[Edge, ...]
) -> HybridAutomaton:
    coordinate = Coordinate(name, unit)
    return HybridAutomaton(
        coordinates=(coordinate,),
        inputs=(coordinate,),
        links=(Link("base", name, 0),),
        parts=parts,
        modes=modes,
        edges=edges,
        noise=Noise((0.001,), (0.01 if unit == "rad" else 0.002,)),
    )
