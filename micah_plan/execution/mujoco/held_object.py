"""What physics needs to know of the model of a held object: which coordinates are the hand's, and which its joints'."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.automaton.contacts.values import Grip
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.kinematics import forward
from micah_plan.errors import InputError
from micah_plan.execution.mujoco.core import ShownJoint

Floats = NDArray[np.float64]

# Names of the joints in MuJoCo: of the part in the hand, and of the object itself; and what all names of the object
# begin with once it is in the world.
PIVOT, JOINT, OBJECT = "pivot", "joint", "object/"
_HINGE = (0.0, 1.0, 0.0)
_SAME = 1e-6


@dataclass(frozen=True, eq=False)
class HeldObject:
    """A held object as a mechanism: slides of the hand, the part in the hand, and the other part on its joint.

    Attributes:
        slides: numbers of the links by which the hand moves, from the base on; the last one ends at the hand.
        hand: (s,) their coordinates.
        origins: (s, 3) places of these links' children with the hand's coordinates at 0 [m].
        reach: (s, 3, s) how these places change per unit of the hand's coordinates.
        in_hand, moving: numbers of the links that end at the part in the hand and at the other part.
        joint: of the other part; rigid if no mode ever moves it.
        shown: what coordinates show beside the hand: the turn in the hand, if it has a coordinate, and the joint.
        stops: least and largest position of the joint in MuJoCo [rad or m].
        latches: (mode, position of the joint in MuJoCo [rad or m]) where the object latches.
    """

    slides: list[int]
    hand: list[int]
    origins: Floats
    reach: Floats
    in_hand: int
    moving: int
    joint: Joint
    shown: tuple[ShownJoint, ...]
    stops: tuple[float, float]
    latches: tuple[tuple[str, float], ...]

    @cached_property
    def _back(self) -> Floats:
        """(s, 3) how the hand's coordinates change with its place."""
        return np.asarray(np.linalg.pinv(self.reach[-1]))

    def places(self, hand: Floats) -> Floats:
        """(s, 3) places of the slides' children [m] for the hand's coordinates (s,); the last is the hand's."""
        return np.asarray(self.origins + self.reach @ hand)

    def coordinates(self, place: Floats) -> Floats:
        """(s,) the hand's coordinates at a place (3,), the nearest ones if the slides do not lead there."""
        return np.asarray(self._back @ (place - self.origins[-1]))


def held_object(automaton: HybridAutomaton, grip: Grip) -> HeldObject:
    """The mechanism of a held object's model.

    Raises:
        InputError: unless the model is a hand on slides, the part in it, and the other part on at most one joint,
            revolute or prismatic; or if nothing says at which configuration the shapes are given.
    """
    slides, in_hand, moving = _links(automaton, grip)
    hand = [automaton.links[number].coordinate for number in slides]
    of_hand = slides, hand, *_places(automaton, slides)
    joint, coordinate = _joint(automaton, moving), automaton.links[moving].coordinate
    is_fixed = joint.kind == "rigid"
    turns = grip.pivots and automaton.links[in_hand].coordinate not in (hand if is_fixed else [coordinate, *hand])
    shown = (_turn(automaton, grip, in_hand),) if turns else ()
    if is_fixed:
        return HeldObject(*of_hand, in_hand, moving, joint, shown, (0.0, 0.0), ())
    pins = {mode.name: pin.value for mode in automaton.modes for pin in mode.pins if pin.coordinate == coordinate}
    datum = max(pins.values(), default=None) if grip.datum is None else grip.datum
    if datum is None:
        raise InputError("nothing says at which configuration the shapes are given", remedy="give 'hold.datum'")
    latches = tuple((mode, value - datum) for mode, value in pins.items())
    positions = [position for _, position in latches]
    stops = min([-grip.travel, *positions]), max([0.0, *positions])
    shown = (*shown, ShownJoint(OBJECT + JOINT, coordinate, zero=-datum))
    return HeldObject(*of_hand, in_hand, moving, joint, shown, stops, latches)


def _links(automaton: HybridAutomaton, grip: Grip) -> tuple[list[int], int, int]:
    """Numbers of the links by which the hand moves, of the one to the part in it, and of the one to the other part."""
    numbers = {link.child: number for number, link in enumerate(automaton.links)}
    for part in (grip.held.name, grip.moving.name):
        if part not in numbers:
            raise InputError(f"no link of the model moves the part '{part}' that 'hold' names")
    in_hand, moving = numbers[grip.held.name], numbers[grip.moving.name]
    slides: list[int] = []
    parent = automaton.links[in_hand].parent
    while parent in numbers:
        slides.insert(0, numbers[parent])
        parent = automaton.links[numbers[parent]].parent
    is_chain = sorted((*slides, in_hand, moving)) == list(range(len(automaton.links)))
    if not slides or not is_chain or automaton.links[moving].parent != grip.held.name:
        raise InputError(
            "physics wants links from the base to the hand, from there to the held part, and on to the moving part",
            remedy="use the nominal plant for this model",
        )
    return slides, in_hand, moving


def _places(automaton: HybridAutomaton, slides: list[int]) -> tuple[Floats, Floats]:
    """Where the slides' children are at 0, and how they move with the hand's coordinates."""
    joints = [_joint(automaton, number) for number in slides]
    turned = [joint for joint in joints if not np.allclose(joint.quaternion, (0.0, 0.0, 0.0, 1.0), atol=_SAME)]
    if turned or any(joint.kind != "prismatic" for joint in joints):
        raise InputError("the hand of a held object must move on slides that do not turn it")
    origins = np.cumsum([joint.position for joint in joints], axis=0)
    reach = np.zeros((len(slides), 3, len(slides)))
    for number, joint in enumerate(joints):
        reach[number:, :, number] = joint.axis
    return origins, reach


def _joint(automaton: HybridAutomaton, link: int) -> Joint:
    joint = automaton.moving_joint(link)
    if joint.kind == "screw":
        raise InputError("a held object cannot have a screw joint", remedy="use the nominal plant for this model")
    return joint


def _turn(automaton: HybridAutomaton, grip: Grip, in_hand: int) -> ShownJoint:
    """How the turn of the part in the hand shows in a coordinate of its own."""
    nominal, joint = Rotation.from_rotvec(grip.rotation).inv(), _joint(automaton, in_hand)
    poses: RigidTransform = forward(joint, [0.0, 1.0])
    zero, one = (nominal * poses.rotation).as_rotvec()
    sign, off = float((one - zero) @ _HINGE), np.linalg.norm(np.cross(joint.center, joint.axis))
    if joint.kind != "revolute" or abs(abs(sign) - 1.0) > _SAME or off > _SAME:
        raise InputError("a held part can turn in the hand about its point and the hinge's direction only")
    return ShownJoint(OBJECT + PIVOT, automaton.links[in_hand].coordinate, round(sign), float(zero @ _HINGE))
