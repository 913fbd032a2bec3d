"""A held object as a mechanism in MuJoCo: slides of the hand, the part in it, and the other part on its joint."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.arrays import EQUAL, Floats
from micah_plan.automaton.contacts.values import HINGE, Grip
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.kinematics import forward
from micah_plan.errors import InputError
from micah_plan.execution.mujoco.parameters import PhysicalParameters
from micah_plan.execution.mujoco.world import (
    IN_HAND,
    MOVING,
    STOPS,
    LatchState,
    World,
    WorldJoint,
    contact_surface,
    pose,
)


class HeldObject:
    """A held object as a mechanism: slides of the hand, the part in the hand, and the other part on its joint.

    Attributes:
        slides: numbers of the links by which the hand moves, from the base on; the last one ends at the hand.
        hand: (s,) their coordinates.
        axes: (s, 3) their directions.
        parts: numbers of the links that end at the part in the hand and at the other part.
        modes: of the model, in which the object is latched, one per latch.
    """

    def __init__(self, automaton: HybridAutomaton, grip: Grip, parameters: PhysicalParameters) -> None:
        """The mechanism of a held object's model.

        Raises:
            InputError: unless the model is a hand on slides, the part in it, and the other part on at most one joint,
                revolute or prismatic.
        """
        self._automaton, self._grip, self._parameters = automaton, grip, parameters
        self.modes: tuple[str, ...] = ()
        self.slides, in_hand, moving = _links(automaton, grip)
        self.parts = [in_hand, moving]
        self.hand = [automaton.links[number].coordinate for number in self.slides]
        slides = [_joint(automaton, number) for number in self.slides]
        turned = [joint for joint in slides if not np.allclose(joint.quaternion, (0.0, 0.0, 0.0, 1.0), atol=EQUAL)]
        if turned or not all(joint.slides for joint in slides):
            raise InputError("the hand of a held object must move on slides that do not turn it")
        self.axes = np.array([joint.axis for joint in slides])
        self._steps = np.array([joint.position for joint in slides])

    def build(self, world: World, hand: Any, *, is_free: bool = False) -> None:
        """Add the two parts to a world, the first one carried by the body `hand`, or free.

        Raises:
            InputError: if the part cannot rotate in the hand as the model requires, or if the configuration at which
                the shapes are given is not defined.
        """
        grip, mass = self._grip, self._parameters.mass
        rotation, joint = Rotation.from_rotvec(grip.rotation), _joint(self._automaton, self.parts[1])
        place = pose(-rotation.apply(grip.point), rotation.as_quat())
        in_hand = hand.add_body(name=grip.held.name, gravcomp=0 if is_free else 1, **place)
        if is_free:
            in_hand.add_freejoint()
        elif grip.pivots:
            self._add_pivot(world, in_hand)
        world.solids(in_hand, grip.held.shapes, mass, contact_surface(MOVING if is_free else IN_HAND, self._parameters))
        fixed = {} if joint.moves else pose(joint.position, joint.quaternion)
        moving = in_hand.add_body(name=grip.moving.name, **fixed)
        if joint.moves:
            self._add_joint(world, moving, joint)
        world.solids(moving, grip.moving.shapes, mass, contact_surface(MOVING, self._parameters))

    def places(self, hand: Floats) -> Floats:
        """(s, 3) positions of the slides' children [m] for the hand's coordinates (s,); the last is the hand's."""
        return np.cumsum(self._steps + hand[:, None] * self.axes, axis=0)

    def coordinates(self, place: Floats) -> Floats:
        """(s,) the hand's coordinates at a position (3,), or the nearest ones."""
        return np.asarray(np.linalg.pinv(self.axes.T) @ (place - self._steps.sum(axis=0)))

    def _add_pivot(self, world: World, body: Any) -> None:
        """Add the pivot of the part in the hand with its spring; it shows a coordinate unless another joint does."""
        automaton, grip, parameters = self._automaton, self._grip, self._parameters
        spring = {"stiffness": parameters.pivot_stiffness, "damping": parameters.pivot_damping}
        in_hand, moving = (automaton.links[number].coordinate for number in self.parts)
        world.joint(body, "hinge", "pivot", axis=HINGE, pos=grip.point, **spring)
        if in_hand in self.hand or (in_hand == moving and _joint(automaton, self.parts[1]).moves):
            return
        nominal, joint = Rotation.from_rotvec(grip.rotation).inv(), _joint(automaton, self.parts[0])
        zero, unit = (nominal * forward(joint, [0.0, 1.0]).rotation).as_rotvec()
        sign, off = float((unit - zero) @ HINGE), np.linalg.norm(np.cross(joint.center, joint.axis))
        if not joint.turns or abs(abs(sign) - 1.0) > EQUAL or off > EQUAL:
            raise InputError("a held part can turn in the hand about its point and the hinge's direction only")
        world.show(WorldJoint("pivot", in_hand, round(sign), float(zero @ HINGE)))

    def _add_joint(self, world: World, body: Any, joint: Joint) -> None:
        """The joint of the other part.

        Latches at its end stops catch it as it arrives, and none ever opens.
        """
        automaton, grip, parameters = self._automaton, self._grip, self._parameters
        coordinate = automaton.links[self.parts[1]].coordinate
        pins = {mode.name: pin.value for mode in automaton.modes for pin in mode.pins if pin.coordinate == coordinate}
        datum = max(pins.values(), default=None) if grip.datum is None else grip.datum
        if datum is None:
            raise InputError(
                "the configuration at which the shapes are given is not defined", remedy="give 'hold.datum'"
            )
        positions, capture = [value - datum for value in pins.values()], parameters.latch_capture
        lowest, highest = min([-grip.travel, *positions]), max([0.0, *positions])
        low = [-np.inf if position == lowest else position - capture for position in positions]
        high = [np.inf if position == highest else position + capture for position in positions]
        latches = [LatchState(*place) for place in zip(positions, low, high, strict=True)]
        self.modes = tuple(pins)
        kind, axis = ("hinge", (0.0, -1.0, 0.0)) if joint.turns else ("slide", (0.0, 0.0, 1.0))
        # Soft constraints creep: dry friction holds the part up only if it is stiff.
        resistance = {"frictionloss": parameters.joint_friction, "damping": parameters.joint_damping}
        world.joint(body, kind, "joint", axis=axis, range=(lowest, highest), **STOPS, **resistance)
        world.show(WorldJoint("joint", coordinate, zero=-datum, latches=latches))


def _links(automaton: HybridAutomaton, grip: Grip) -> tuple[list[int], int, int]:
    """Indices of the hand's links, of the held part's link, and of the moving part's link."""
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


def _joint(automaton: HybridAutomaton, link: int) -> Joint:
    joint = automaton.moving_joint(link)
    if joint.climbs or (joint.moves and not joint.has_axis):
        problem = f"a held object can have hinges and slides, and no {joint.kind} joint"
        raise InputError(problem, remedy="use the nominal plant for this model")
    return joint
