"""What physics needs to know of the model of a standing object: of each part its joint, range, latches and handle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import HybridAutomaton, Primitive
from micah_plan.automaton.joint import Joint, Quaternion, Vector3
from micah_plan.automaton.kinematics import forward, jacobian
from micah_plan.errors import InputError

Floats = NDArray[np.float64]

_SHORTEST_ARM = 0.005
_SAME_JOINT = 1e-6
_PANEL = 0.02


@dataclass(frozen=True)
class StandingPart:
    """One part as a body.

    Attributes:
        name, parent: of the part and of the one that it is attached to (None: the world).
        joint: its moving joint; rigid if no mode ever moves it.
        coordinate: which element of x it follows.
        lower, upper: end stops [rad or m], infinite where there are none.
        latches: configurations at which a rigid mode pins it [rad or m].
        handle: where the hand pulls at it, in the part's frame [m].
        arm: how far the handle moves per unit of configuration [m/rad], or 1 for a slide.
        shapes: of the part, or a default box.
    """

    name: str
    parent: str | None
    joint: Joint
    coordinate: int
    lower: float
    upper: float
    latches: tuple[float, ...]
    handle: Vector3
    arm: float
    shapes: tuple[Primitive, ...]

    @property
    def can_latch(self) -> bool:
        """Whether it moves, and latches somewhere."""
        return bool(self.latches) and self.joint.kind != "rigid"


def standing_parts(automaton: HybridAutomaton) -> tuple[StandingPart, ...]:
    """The links of an automaton as bodies, parents first.

    Raises:
        InputError: if the automaton cannot be a mechanism of one joint per part, or a hand could not turn a part.
    """
    if len({link.coordinate for link in automaton.links}) != automaton.n:
        raise InputError(
            "physics needs one link per coordinate of the model", remedy="use the nominal plant for this model"
        )
    names = {link.child for link in automaton.links}
    links = []
    for number, link in enumerate(automaton.links):
        joint = _only_moving_joint(automaton, number)
        lower, upper = _range(automaton, link.coordinate)
        pins = {pin.value for mode in automaton.modes for pin in mode.pins if pin.coordinate == link.coordinate}
        part = automaton.part(link.child)
        handle = part.handle or (0.0, 0.0, 0.0)
        links.append(
            StandingPart(
                name=link.child,
                parent=link.parent if link.parent in names else None,
                joint=joint,
                coordinate=link.coordinate,
                lower=lower,
                upper=upper,
                latches=tuple(sorted(pins)),
                handle=handle,
                arm=_arm(link.child, joint, handle),
                shapes=part.shapes or (_default_box(joint),),
            )
        )
    return tuple(links)


def moved_with(part: StandingPart, parts: Sequence[StandingPart]) -> list[int]:
    """Numbers of the parts that a part's joint moves: its own, and those that are attached to it."""
    names = {part.name}
    names.update(other.name for other in parts if other.parent in names)
    return [number for number, other in enumerate(parts) if other.name in names]


def base_shapes(automaton: HybridAutomaton) -> tuple[Primitive, ...]:
    """The shapes of what does not move: the base."""
    return automaton.part(BASE).shapes


def _only_moving_joint(automaton: HybridAutomaton, link: int) -> Joint:
    moving = [mode.joints[link] for mode in automaton.modes if mode.joints[link].kind != "rigid"]
    if not moving:
        return automaton.modes[0].joints[link]
    for other in moving[1:]:
        first, second = (forward(joint, [0.0, 0.5]).as_matrix() for joint in (moving[0], other))
        if other.kind != moving[0].kind or not np.allclose(first, second, atol=_SAME_JOINT):
            name = automaton.links[link].child
            raise InputError(
                f"part '{name}' moves by different joints in different modes, which physics cannot build",
                remedy="use the nominal plant for this model",
            )
    return moving[0]


def _range(automaton: HybridAutomaton, coordinate: int) -> tuple[float, float]:
    """From the least to the largest value that the modes' invariants and pins allow for one coordinate."""
    intervals = [mode.interval(coordinate) for mode in automaton.modes]
    return min(low for low, _ in intervals), max(high for _, high in intervals)


def _arm(name: str, joint: Joint, handle: Vector3) -> float:
    if joint.kind == "rigid":
        return 1.0
    rotation, translation = np.split(jacobian(joint, 0.0)[0], 2)
    offset = forward(joint, 0.0)[0].rotation.apply(handle)
    arm = float(np.linalg.norm(translation + np.cross(rotation, offset)))
    if arm < _SHORTEST_ARM:
        raise InputError(
            f"the handle of part '{name}' lies on its axis (distance {1000 * arm:.1f} mm), so no hand can turn it",
            remedy="give the part a handle away from the axis",
        )
    return arm


def _default_box(joint: Joint) -> Primitive:
    """In the part's frame: a panel between the axis and the part's origin (hinge), or a box around it (slide)."""
    pose = forward(joint, 0.0)[0]
    if joint.kind in ("prismatic", "rigid"):
        return Primitive("box", (0.3, 0.3, 0.15))
    reach = np.array(joint.position) - np.array(joint.center)
    length = float(np.linalg.norm(reach))
    if length < _SHORTEST_ARM:
        return Primitive("box", (0.1, 0.1, _PANEL))
    along, axis = reach / length, np.array(joint.axis)
    frame = np.column_stack([along, np.cross(axis, along), axis])
    turned = pose.rotation.inv().as_matrix() @ frame
    middle = pose.rotation.inv().apply(-reach / 2).tolist()
    quaternion = _quaternion(turned)
    return Primitive("box", (length, _PANEL, length), (middle[0], middle[1], middle[2]), quaternion)


def _quaternion(matrix: Floats) -> Quaternion:
    x, y, z, w = Rotation.from_matrix(matrix).as_quat(canonical=True)
    return (float(x), float(y), float(z), float(w))
