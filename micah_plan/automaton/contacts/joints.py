"""Joints of a contact product: the one that it takes from a learned automaton, and those of the hand that it adds.

Three slides carry the hand, the held part may turn in it, and the object's own joint carries the moving part.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.automaton.contacts.values import Grip
from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Link, Pin
from micah_plan.automaton.joint import IDENTITY, Joint, JointKind, prismatic, revolute, rigid
from micah_plan.errors import InputError
from micah_plan.quantities import quantity

HAND = "hand"
_CARRIAGES = ("hand_x", "hand_y", HAND)
_HINGE = (0.0, 1.0, 0.0)


@dataclass(frozen=True)
class Latch:
    """A rigid mode that the joint reaches.

    Attributes:
        mode: its name.
        pin: of the joint.
        threshold: configuration at which it is reached [rad or m]; threshold_std: how well that is known.
        direction: +1 if it is reached from smaller values.
    """

    mode: str
    pin: Pin
    threshold: float
    threshold_std: float
    direction: int


@dataclass(frozen=True)
class LearnedJoint:
    """The joint of an automaton with one coordinate.

    Attributes:
        kind: revolute or prismatic.
        moving: name of the mode in which it moves.
        low, high: its range there [rad or m]; datum: where the shapes are given.
        latches: rigid modes.
        process_std, observation_std: of the coordinate.
    """

    kind: JointKind
    moving: str
    low: float
    high: float
    datum: float
    latches: tuple[Latch, ...]
    process_std: float
    observation_std: float

    @property
    def turns(self) -> bool:
        return self.kind == "revolute"


def learned_joint(automaton: HybridAutomaton, grip: Grip) -> LearnedJoint:
    """The joint of a learned automaton.

    Raises:
        InputError: unless it has one coordinate that one mode moves, by a revolute or prismatic joint, by one turn at
            most, and a datum.
    """
    moving = [mode for mode in automaton.modes if mode.B.any()]
    if automaton.n != 1 or len(automaton.links) != 1 or len(moving) != 1:
        problem = f"contacts need a model of one joint with one mode in which it moves. Got {automaton.n} coordinates"
        raise InputError(f"{problem} and {len(moving)} such modes", remedy="learn the held object's joint alone")
    mode = moving[0]
    kind = mode.joints[0].kind
    if kind not in ("revolute", "prismatic"):
        raise InputError(f"contacts need a revolute or prismatic joint. Got {kind}")
    latches = tuple(latch for edge in automaton.edges_from(mode.name) if (latch := _latch(automaton, edge)) is not None)
    above = [latch.threshold for latch in latches if latch.direction > 0]
    below = [latch.threshold for latch in latches if latch.direction < 0]
    high = mode.interval(0)[1]
    datum = [*above, high][0] if grip.datum is None else grip.datum
    if grip.datum is None and not math.isfinite(datum):
        remedy = "give the configuration at which the parts' shapes are described as `datum`"
        raise InputError("the model neither latches nor ends anywhere, so its shapes have no datum", remedy=remedy)
    low = max([datum - grip.travel, *below])
    high = min([max(datum, high if math.isfinite(high) else datum), *above])
    if kind == "revolute" and high - low > 2 * math.pi:
        problem = f"the contacts of a part that turns are those of one turn, {quantity(2 * math.pi, 'rad')}"
        raise InputError(f"{problem}. Got {quantity(high - low, 'rad')}", remedy="lower `travel`")
    return LearnedJoint(
        kind,
        mode.name,
        low,
        high,
        datum,
        latches,
        automaton.noise.process_std[0],
        automaton.noise.observation_std[0],
    )


def _latch(automaton: HybridAutomaton, edge: Edge) -> Latch | None:
    """The rigid mode that an edge leads to; None if it leads elsewhere."""
    pins = automaton.mode(edge.target).pins
    bound = edge.guard.half_spaces[0].bound if len(edge.guard.half_spaces) == 1 else None
    if not pins or bound is None:
        return None
    return Latch(edge.target, pins[0], bound.value, edge.threshold_std, 1 if bound.is_lower else -1)


def links_of(grip: Grip) -> tuple[Link, ...]:
    """Base to the hand by x, y and z; the hand to the held part, and that to the moving one, by the joint."""
    chain = (BASE, *_CARRIAGES)
    slides = [Link(chain[i], chain[i + 1], i) for i in range(3)]
    return (*slides, Link(HAND, grip.held.name, 3), Link(grip.held.name, grip.moving.name, 3))


def mode_joints(
    grip: Grip, joint: LearnedJoint, *, rigid_at: float | None = None, turned_from: float | None = None
) -> tuple[Joint, ...]:
    """The joints of a mode, one per link.

    Args:
        rigid_at: configuration of the object's joint where the mode pins it.
        turned_from: configuration from which on the held part turns in the hand by as much as the joint closes.
    """
    rotation = Rotation.from_rotvec(grip.rotation)
    position, quaternion = -rotation.apply(grip.point), rotation.as_quat()
    slides = [prismatic(axis, (0.0, 0.0, 0.0)) for axis in np.eye(3)]
    if turned_from is None:
        in_hand = rigid(position, quaternion, 0.0 if rigid_at is None else rigid_at)
    else:
        axis = rotation.apply(_HINGE)
        start = Rotation.from_rotvec(-turned_from * axis)
        in_hand = revolute(axis, (0.0, 0.0, 0.0), start.apply(position), (start * rotation).as_quat())
    offset = (0.0 if rigid_at is None else rigid_at) - joint.datum
    if joint.turns:
        place, at = np.zeros(3), Rotation.from_rotvec((0.0, -offset, 0.0)).as_quat()
        own = revolute((0.0, -1.0, 0.0), (0.0, 0.0, 0.0), place, at)
    else:
        place, at = np.array([0.0, 0.0, offset]), np.array(IDENTITY)
        own = prismatic((0.0, 0.0, 1.0), place)
    return (*slides, in_hand, own if rigid_at is None else rigid(place, at, rigid_at))
