"""Small objects that the execution tests manipulate."""

import numpy as np

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
from micah_plan.automaton.joint import Joint, prismatic, revolute, rigid, screw
from micah_plan.automaton.kinematics import forward
from micah_plan.automaton.region import Region, above, below, box, input_below, input_box
from micah_plan.task.plan import Trajectory

SHUT = 1.2
RADIUS = 0.35


def door(tilt: float = 0.0, observation_std: float = 0.01, process_std: float = 0.005) -> HybridAutomaton:
    """A door of radius 0.35 m that swings from 0 to 1.2 rad and latches there; `tilt` is its axis off the vertical."""
    axis = (np.sin(tilt), 0.0, np.cos(tilt))
    swing = revolute(axis, (0.1, 0.2, 0.3), (0.1, 0.2 + RADIUS, 0.3), (0.0, 0.0, 0.0, 1.0))
    shut = forward(swing, SHUT)[0]
    held = rigid(tuple(shut.translation), tuple(shut.rotation.as_quat()), SHUT)
    inputs = input_box([-0.15], [0.15], 1, ["door"])
    moving = Mode("swinging", (swing,), ((1.0,),), box([0.0], [SHUT], 1, ["door"]), inputs)
    pinned = Mode("shut", (held,), ((0.0,),), Region((above(0, SHUT, 1, 1),)), inputs, (Pin(0, SHUT, 1e-3),))
    close = Edge("swinging", "shut", Region((above(0, SHUT, 1, 1),)))
    release = Edge("shut", "swinging", Region((input_below(0, 0.0, 1, 1, strict=True),)))
    clamp = Edge("swinging", "swinging", Region((below(0, 0.0, 1, 1),)))
    return HybridAutomaton(
        coordinates=(Coordinate("door", "rad"),),
        inputs=(Coordinate("door", "rad"),),
        links=(Link("base", "door", 0),),
        parts=(Part("base"), Part("door", handle=(0.0, 0.0, 0.05))),
        modes=(moving, pinned),
        edges=(close, release, clamp),
        noise=Noise((process_std,), (observation_std,)),
    )


def drawer(observation_std: float = 0.003, process_std: float = 0.001) -> HybridAutomaton:
    """A drawer that slides from 0 to 0.3 m along a direction that is not parallel to any axis of the base."""
    slide = prismatic((0.6, 0.0, 0.8), (0.3, -0.2, 0.1), (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)))
    return _single("drawer", "m", slide, 0.3, 0.05, Noise((process_std,), (observation_std,)))


def _single(name: str, unit: str, joint: Joint, longest: float, step: float, noise: Noise) -> HybridAutomaton:
    mode = Mode("sliding", (joint,), ((1.0,),), box([0.0], [longest], 1, [name]), input_box([-step], [step], 1, [name]))
    return HybridAutomaton(
        coordinates=(Coordinate(name, unit),),
        inputs=(Coordinate(name, unit),),
        links=(Link("base", name, 0),),
        parts=(),
        modes=(mode,),
        edges=(),
        noise=noise,
    )


def straight(modes: list[str], means: list[float], std: float, gain: float = -0.8) -> Trajectory:
    """A plan along one coordinate with a constant gain; a change of mode is a transition, which takes no time."""
    steps = len(modes) - 1
    x = np.array(means, dtype=float).reshape(-1, 1)
    is_transition = np.array([modes[k] != modes[k + 1] for k in range(steps)], dtype=bool)
    still = is_transition[:, None]
    inputs = np.where(still, 0.0, np.diff(x, axis=0))
    gains = np.where(still[:, :, None], 0.0, np.full((steps, 1, 1), gain))
    return Trajectory(tuple(modes), x, np.full((len(modes), 1, 1), std), inputs, gains, is_transition)


def closing() -> Trajectory:
    """The door from open to latched."""
    return straight(["swinging"] * 10 + ["shut"], [*np.linspace(0.0, 1.22, 10), SHUT], 0.02)


def opening() -> Trajectory:
    """The door from latched to 0.4 rad."""
    return straight(["shut"] + ["swinging"] * 9, [SHUT, *np.linspace(SHUT, 0.4, 9)], 0.02)


def pulling() -> Trajectory:
    """The drawer from 0.02 to 0.25 m."""
    return straight(["sliding"] * 9, list(np.linspace(0.02, 0.25, 9)), 0.002)


def arm() -> HybridAutomaton:
    """A chain: a lever on a tilted hinge, and on it a slider."""
    lever = revolute((0.0, 0.6, 0.8), (0.1, 0.0, 0.2), (0.4, 0.1, 0.1), (0.1, 0.2, 0.3, 0.9))
    slider = prismatic((0.0, 0.6, -0.8), (0.05, 0.1, 0.0), (0.3, 0.0, 0.0, 0.95))
    names = ["lever", "slider"]
    coordinates = (Coordinate("lever", "rad"), Coordinate("slider", "m"))
    mode = Mode("moving", (lever, slider), ((1.0, 0.0), (0.0, 1.0)), box([-1.0, -0.2], [1.0, 0.2], 2, names))
    return HybridAutomaton(
        coordinates=coordinates,
        inputs=coordinates,
        links=(Link("base", "lever", 0), Link("lever", "slider", 1)),
        parts=(Part("slider", handle=(0.1, 0.0, 0.0)),),
        modes=(mode,),
        edges=(),
        noise=Noise((0.0, 0.0), (0.01, 0.003)),
    )


def worm() -> HybridAutomaton:
    """A screw that advances 0.05 m per radian."""
    joint = screw((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 0.05, (0.2, 0.0, 0.0))
    return _single("worm", "rad", joint, 3.0, 0.3, Noise((0.0,), (0.01,)))
