"""The true microwave, drawer, cabinet, stapler and box of the simulated demonstrations.

The base frame has x to the right, y out of the front and z up, in metres. `micah-plan learn` does not see these
mechanisms; it sees recordings. Shapes and handles are not learned: the true objects and the learned models take them
from `models/parts`, where they are given in each part's own frame, the one that the tracker reports.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

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
)
from micah_plan.automaton.joint import prismatic, revolute, rigid
from micah_plan.automaton.kinematics import forward
from micah_plan.automaton.region import Region, above, below, box, input_below
from micah_plan.documents.parts import load_parts

DOOR_OPEN = 1.2
"""Angle between the open door, where demonstrations start, and the shut one [rad]."""

DRAWER_TRAVEL = 0.32
"""From shut to the end stop [m]."""

CABINET_TRAVEL = 0.3
"""How far the cabinet's drawer comes out [m]."""

STAPLER_OPEN = 0.55
"""Angle between the open stapler and the latched one [rad]."""

LID_OPEN = 0.9
"""Angle between the open lid of the box and the latched one [rad]."""

_HINGE = (-0.24, 0.01, 0.0)
_TRACKED = 0.31
_CABINET_HINGE = (-0.2, 0.01, 0.0)
_CABINET_TRACKED = 0.2
_CABINET_DRAWER = (0.0, 0.0, 0.28)
_HANDLE_ON_DOOR = (0.15, 0.045, 0.05)
_STAPLER_HINGE = (-0.06, 0.0, 0.02)
_STAPLER_TRACKED = 0.1
_BOX_HINGE = (-0.08, 0.0, 0.03)
_LID_TRACKED = 0.12
_PARTS = Path(__file__).resolve().parent.parent / "models" / "parts"


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


def cabinet() -> HybridAutomaton:
    """A door as the microwave's, its handle, which is tracked too, and above it a drawer: three parts, two coordinates.

    The drawer runs out along y. The handle is fixed to the door and turned, as a marker glued to it would be.
    """
    direction = Rotation.from_rotvec([0.0, 0.0, DOOR_OPEN])
    tracked = np.array(_CABINET_HINGE) + direction.apply([_CABINET_TRACKED, 0.0, 0.0])
    swing = revolute((0.0, 0.0, -1.0), _CABINET_HINGE, tracked, direction.as_quat())
    slide = prismatic((0.0, 1.0, 0.0), _CABINET_DRAWER)
    handle = rigid(_HANDLE_ON_DOOR, Rotation.from_rotvec([0.0, 0.5, 0.0]).as_quat())
    pose = forward(swing, DOOR_OPEN)[0]
    shut = rigid(pose.translation, pose.rotation.as_quat(), DOOR_OPEN)
    names = ["door", "drawer"]
    free, held = ((1.0, 0.0), (0.0, 1.0)), ((0.0, 0.0), (0.0, 1.0))
    reach = box([0.0, 0.0], [DOOR_OPEN, CABINET_TRAVEL], 2, names)
    shut_and_any = Region((above(0, DOOR_OPEN, 2, 2), above(1, 0.0, 2, 2), below(1, CABINET_TRAVEL, 2, 2)))
    swinging = Mode("swinging", (swing, slide, handle), free, reach)
    fixed = replace(handle, fixed_at=DOOR_OPEN)
    latched = Mode("latched", (shut, slide, fixed), held, shut_and_any, pins=(Pin(0, DOOR_OPEN, 1e-3),))
    coordinates = (Coordinate("door", "rad"), Coordinate("drawer", "m"))
    return HybridAutomaton(
        coordinates=coordinates,
        inputs=coordinates,
        links=(Link("base", "door", 0), Link("base", "drawer", 1), Link("door", "handle", 0)),
        parts=cabinet_parts(),
        modes=(swinging, latched),
        edges=(
            Edge("swinging", "latched", Region((above(0, DOOR_OPEN, 2, 2, name="door"),))),
            Edge("latched", "swinging", Region((input_below(0, 0.0, 2, 2, strict=True, name="input door"),))),
        ),
        noise=Noise((0.001, 0.001), (0.01, 0.002)),
    )


def stapler() -> HybridAutomaton:
    """A desk stapler, one arm at rest, the other on a hinge at the back. It is 0 when open and latches at 0.55."""
    return _folding("arm", _STAPLER_HINGE, _STAPLER_TRACKED, STAPLER_OPEN, stapler_parts())


def lidded_box() -> HybridAutomaton:
    """A box with a lid on a hinge at the back. The lid is 0 when open and latches at 0.9."""
    return _folding("lid", _BOX_HINGE, _LID_TRACKED, LID_OPEN, box_parts())


def _folding(
    name: str, hinge: tuple[float, float, float], distance: float, opening: float, parts: tuple[Part, ...]
) -> HybridAutomaton:
    """A part that folds down about a hinge along y and latches where it is level."""
    direction = Rotation.from_rotvec([0.0, -opening, 0.0])
    tracked = np.array(hinge) + direction.apply([distance, 0.0, 0.0])
    swing = revolute((0.0, 1.0, 0.0), hinge, tracked, direction.as_quat())
    pose = forward(swing, opening)[0]
    shut = rigid(pose.translation, pose.rotation.as_quat(), opening)
    swinging = Mode("swinging", (swing,), ((1.0,),), box([0.0], [opening], 1, [name]))
    at_latch = Region((above(0, opening, 1, 1, name=name),))
    latched = Mode("latched", (shut,), ((0.0,),), at_latch, pins=(Pin(0, opening, 1e-3),))
    edges = (
        Edge("swinging", "latched", at_latch),
        Edge("latched", "swinging", Region((input_below(0, 0.0, 1, 1, strict=True, name=f"input {name}"),))),
    )
    return _object(name, "rad", parts, (swinging, latched), edges)


def microwave_parts() -> tuple[Part, ...]:
    """The oven and its door; the door's frame: x from the hinge along the door, y outwards, z up, origin 0.31 m out."""
    return load_parts(_PARTS / "microwave.yaml")


def drawer_parts() -> tuple[Part, ...]:
    """The cabinet and its drawer; the drawer's frame is parallel to the base, its origin in the middle of the front."""
    return load_parts(_PARTS / "drawer.yaml")


def cabinet_parts() -> tuple[Part, ...]:
    """The cabinet, its door, its drawer and the door's handle, each in its own frame."""
    return load_parts(_PARTS / "cabinet.yaml")


def stapler_parts() -> tuple[Part, ...]:
    """The lower arm, which is the base, and the upper arm; its frame: x from the hinge along it, z up, 0.1 m out."""
    return load_parts(_PARTS / "stapler.yaml")


def box_parts() -> tuple[Part, ...]:
    """The box and its lid; the lid's frame: x from the hinge along it, z up when it is shut, 0.12 m out."""
    return load_parts(_PARTS / "box.yaml")


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
