"""The bodies of a standing object, from its model: of each part its joint, end stops, latches, shapes and handle."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.automaton.hybrid import HybridAutomaton, Link, Primitive
from micah_plan.automaton.joint import Joint, Vector3
from micah_plan.automaton.kinematics import forward, jacobian
from micah_plan.errors import InputError
from micah_plan.execution.mujoco.parameters import PhysicalParameters
from micah_plan.execution.mujoco.world import STOPS, Latch, WorldBody, WorldJoint, pose
from micah_plan.quantities import quantity
from micah_plan.scene.body import vector3

_SHORTEST_ARM = 0.005
_SAME_JOINT = 1e-6
_PANEL = 0.02
_UNLIMITED = 1e3


def standing_bodies(automaton: HybridAutomaton, parameters: PhysicalParameters) -> tuple[WorldBody, ...]:
    """The children of an automaton's links as bodies. Positions of their joints are the configurations.

    Raises:
        InputError: if the automaton cannot be a mechanism of one joint per part, or a hand could not turn a part.
    """
    if len({link.coordinate for link in automaton.links}) != automaton.n:
        raise InputError(
            "physics needs one link per coordinate of the model", remedy="use the nominal plant for this model"
        )
    names = {link.child for link in automaton.links}
    bodies = []
    for number, link in enumerate(automaton.links):
        joint, part = _only_moving_joint(automaton, number), automaton.part(link.child)
        handle = part.handle or (0.0, 0.0, 0.0)
        arm = _arm(link.child, joint, handle)
        bodies.append(
            WorldBody(
                name=link.child,
                parent=link.parent if link.parent in names else None,
                attributes=pose(joint.position, joint.quaternion),
                joints=() if joint.kind == "rigid" else _joints(automaton, link, joint, arm, parameters),
                shapes=part.shapes or (_default_box(joint),),
                mass=parameters.mass,
                handle=handle,
                arm=arm,
            )
        )
    return tuple(bodies)


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


def _joints(
    automaton: HybridAutomaton, link: Link, joint: Joint, arm: float, parameters: PhysicalParameters
) -> list[WorldJoint]:
    """A slide, a hinge, or for a screw a hinge with a slide that follows it; latched where a mode pins it."""
    to_part = Rotation.from_quat(joint.quaternion).inv()
    axis = {"axis": to_part.apply(joint.axis)}
    intervals = [mode.interval(link.coordinate) for mode in automaton.modes]
    lower, upper = min(low for low, _ in intervals), max(high for _, high in intervals)
    attributes = {
        "type": "slide" if joint.kind == "prismatic" else "hinge",
        "pos": to_part.apply(np.subtract(joint.center, joint.position)),
        # A hinge's moment is the force at the handle times the arm; its damping relates moment to angular velocity.
        "damping": parameters.damping * arm**2,
        "frictionloss": parameters.friction * arm,
        "range": np.clip([lower, upper], -_UNLIMITED, _UNLIMITED),
    }
    pins = {pin.value for mode in automaton.modes for pin in mode.pins if pin.coordinate == link.coordinate}
    capture, release = parameters.latch_capture / arm, parameters.latch_force * arm
    latches = [
        Latch(pin, pin - capture, pin + capture, release, pin - lower > capture, upper - pin > capture)
        for pin in sorted(pins)
    ]
    joints = [WorldJoint(link.child, attributes | axis | STOPS, link.coordinate, latches=latches)]
    if joint.kind == "screw":
        slide = {"type": "slide", **axis}
        joints.append(WorldJoint(f"{link.child}/slide", slide, link.coordinate, joint.pitch, follows=link.child))
    return joints


def _arm(name: str, joint: Joint, handle: Vector3) -> float:
    if joint.kind == "rigid":
        return 1.0
    rotation, translation = np.split(jacobian(joint, 0.0)[0], 2)
    offset = forward(joint, 0.0)[0].rotation.apply(handle)
    arm = float(np.linalg.norm(translation + np.cross(rotation, offset)))
    if arm < _SHORTEST_ARM:
        raise InputError(
            f"the handle of part '{name}' lies on its axis (distance {quantity(arm, 'm')}), so no hand can turn it",
            remedy="give the part a handle away from the axis",
        )
    return arm


def _default_box(joint: Joint) -> Primitive:
    """A default shape: a panel between the axis and the part's origin (hinge), or a box around it (slide)."""
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
