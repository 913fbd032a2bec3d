"""What physics needs to know of the model of a standing object: of each part its joint, range, latches and handle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.automaton.hybrid import HybridAutomaton, Primitive
from micah_plan.automaton.joint import Joint, Vector3
from micah_plan.automaton.kinematics import forward, jacobian
from micah_plan.errors import InputError
from micah_plan.scene.body import vector3

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
    parts = []
    for number, link in enumerate(automaton.links):
        joint, part = _only_moving_joint(automaton, number), automaton.part(link.child)
        intervals = [mode.interval(link.coordinate) for mode in automaton.modes]
        pins = {pin.value for mode in automaton.modes for pin in mode.pins if pin.coordinate == link.coordinate}
        handle = part.handle or (0.0, 0.0, 0.0)
        parts.append(
            StandingPart(
                name=link.child,
                parent=link.parent if link.parent in names else None,
                joint=joint,
                coordinate=link.coordinate,
                lower=min(low for low, _ in intervals),
                upper=max(high for _, high in intervals),
                latches=tuple(sorted(pins)),
                handle=handle,
                arm=_arm(link.child, joint, handle),
                shapes=part.shapes or (_default_box(joint),),
            )
        )
    return tuple(parts)


def _only_moving_joint(automaton: HybridAutomaton, link: int) -> Joint:
    """The joint that moves a link in all modes that do not hold it."""
    joint = automaton.moving_joint(link)
    places = forward(joint, [0.0, 0.5]).as_matrix()
    for other in (mode.joints[link] for mode in automaton.modes if mode.joints[link].kind != "rigid"):
        if other.kind != joint.kind or not np.allclose(
            places, forward(other, [0.0, 0.5]).as_matrix(), atol=_SAME_JOINT
        ):
            name = automaton.links[link].child
            raise InputError(
                f"part '{name}' moves by different joints in different modes, which physics cannot build",
                remedy="use the nominal plant for this model",
            )
    return joint


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
    if joint.kind in ("prismatic", "rigid"):
        return Primitive("box", (0.3, 0.3, 0.15))
    reach = np.array(joint.position) - np.array(joint.center)
    length = float(np.linalg.norm(reach))
    if length < _SHORTEST_ARM:
        return Primitive("box", (0.1, 0.1, _PANEL))
    along, axis = reach / length, np.array(joint.axis)
    to_part = forward(joint, 0.0)[0].rotation.inv()
    frame = to_part.as_matrix() @ np.column_stack([along, np.cross(axis, along), axis])
    x, y, z, w = Rotation.from_matrix(frame).as_quat(canonical=True).tolist()
    return Primitive("box", (length, _PANEL, length), vector3(to_part.apply(-reach / 2)), (x, y, z, w))
