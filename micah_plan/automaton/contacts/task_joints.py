"""Links, parts and joints of a held object: three slides of the hand, a turn in it, and the object's own joint."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.automaton.contacts.task import Grip
from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import Link, Part
from micah_plan.automaton.joint import Joint, prismatic, revolute, rigid

AXES = ("x", "y", "z")
HAND = "hand"
_CARRIAGES = ("hand_x", "hand_y", HAND)
_HINGE = (0.0, 1.0, 0.0)


def links_of(grip: Grip) -> tuple[Link, ...]:
    """Base to the hand by x, y and z; the hand to the held part, and that to the moving one, by the joint."""
    chain = (BASE, *_CARRIAGES)
    slides = [Link(chain[i], chain[i + 1], i) for i in range(3)]
    return (*slides, Link(HAND, grip.held.name, 3), Link(grip.held.name, grip.moving.name, 3))


def parts_of(grip: Grip) -> tuple[Part, ...]:
    """The object's parts with their shapes; both part frames are the hinge frame (with the joint at the datum)."""
    return (Part(grip.held.name, grip.held.shapes), Part(grip.moving.name, grip.moving.shapes))


def mode_joints(
    grip: Grip, datum: float, turns: bool, *, held_at: float | None = None, turned_from: float | None = None
) -> tuple[Joint, ...]:
    """The joints of a mode, one per link.

    Args:
        held_at: configuration of the object's joint where the mode is rigid.
        turned_from: configuration from which on the held part turns in the hand by as much as the joint closes.
    """
    rotation = Rotation.from_rotvec(grip.rotation)
    position, quaternion = -rotation.apply(grip.point), rotation.as_quat()
    slides = [prismatic(axis, (0.0, 0.0, 0.0)) for axis in np.eye(3)]
    if turned_from is None:
        in_hand = rigid(position, quaternion, 0.0 if held_at is None else held_at)
    else:
        axis = rotation.apply(_HINGE)
        start = Rotation.from_rotvec(-turned_from * axis)
        in_hand = revolute(axis, (0.0, 0.0, 0.0), start.apply(position), (start * rotation).as_quat())
    offset = -datum if held_at is None else held_at - datum
    if turns:
        at = Rotation.from_rotvec((0.0, -offset, 0.0)).as_quat()
        place = np.zeros(3)
        own = revolute((0.0, -1.0, 0.0), (0.0, 0.0, 0.0), place, at)
    else:
        at, place = np.array([0.0, 0.0, 0.0, 1.0]), np.array([0.0, 0.0, offset])
        own = prismatic((0.0, 0.0, 1.0), place)
    return (*slides, in_hand, own if held_at is None else rigid(place, at, held_at))
