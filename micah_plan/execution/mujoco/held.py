"""An object in a hand among bodies, in MuJoCo: contact, friction, a joint that moves freely, latches, and a carrier.

The plant reads the problem's geometry and where the learned model latches, but none of the model's modes or contact
kinematics: what touches, slides, folds, catches and falls is physics.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Floats
from micah_plan.automaton.contacts.product import FREE
from micah_plan.automaton.contacts.values import AXES, COLLIDED, Grip
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.kinematics import forward
from micah_plan.errors import InputError
from micah_plan.execution.mujoco.core import Carrier, PhysicalPlant
from micah_plan.execution.mujoco.incidents import Watch, add_contact_sensors
from micah_plan.execution.mujoco.parameters import PhysicalParameters, parameters_of
from micah_plan.execution.mujoco.standing import StandingPlant
from micah_plan.execution.mujoco.world import (
    IN_HAND,
    MOVING,
    OBJECT,
    STOPS,
    Flags,
    Latch,
    World,
    WorldJoint,
    add_hand,
    pose,
    rubbing,
    scene_world,
)
from micah_plan.execution.plant import Command, Measurement, Truth
from micah_plan.execution.pose import input_effect
from micah_plan.task.problem import Problem
from micah_plan.task.start import sample_start

_HINGE = (0.0, 1.0, 0.0)
_SAME = 1e-6


class HeldPlant(PhysicalPlant):
    """The object of a problem with a block `hold`, as a mechanism in MuJoCo; the problem's robot carries it, if any."""

    def __init__(
        self, problem: Problem, parameters: PhysicalParameters | None = None, posture: Floats | None = None
    ) -> None:
        """Build the simulation.

        Args:
            parameters: of the physics; None: those of the problem.
            posture: (J,) joints of the arm near which it starts, as a plan has them; None: one is sought.

        Raises:
            MissingDependencyError: if MuJoCo is not installed.
            InputError: if the problem does not say how the object is held, or its model, scene or robot cannot be
                simulated.
        """
        if problem.hold is None:
            raise InputError("the problem does not say how the object is held", remedy="add the block 'hold'")
        automaton, grip, parameters = problem.automaton, problem.hold.grip, parameters or parameters_of(problem)
        has_arm = problem.robot is not None and problem.grasp is not None
        touchable = {body for body, _, _ in problem.hold.contacts}
        scene, carried = scene_world(problem.scene, parameters), World()
        hand = add_hand(carried, parameters, slides=not has_arm)
        self.problem, self._object = problem, HeldObject(automaton, grip, parameters)
        self._object.build(carried, hand)
        # Inputs displace the hand in every mode; contacts alone move the object's joint.
        inputs = input_effect(automaton, automaton.modes[0].name)[self._object.hand]
        self._displacement_per_input = self._object.axes.T @ inputs
        if has_arm:
            from micah_plan.execution.mujoco.arm import attach_arm  # Pinocchio is loaded only where there is an arm

            carry: Callable[[PhysicalPlant], Carrier] = attach_arm(scene, hand, problem, parameters, posture)
        else:
            scene.spec.worldbody.add_frame().attach_body(hand, OBJECT, "")
            carry = partial(Carrier, joints=[OBJECT + axis for axis in AXES])
        add_contact_sensors(scene, touchable, grip)
        super().__init__(automaton, parameters, scene.spec.compile(), carried.joints, OBJECT)
        self._carrier, self._watch, model = carry(self), Watch(self, touchable), self.model
        self._nominal = model.geom_friction.copy(), model.body_mass.copy(), model.body_inertia.copy()
        self._hand, *self._parts = [model.body(OBJECT + n).id for n in ("hand", grip.held.name, grip.moving.name)]

    def reset(self, rng: np.random.Generator) -> Measurement:
        """A new trial: a start drawn from the belief; the object's mass and all friction drawn anew."""
        model, data, parts, spread = self.model, self.data, self._parts, self.parameters.spread
        x = sample_start(self.automaton, self.problem.start, rng)[1]
        friction, mass, inertia = self._nominal
        heavier = rng.uniform(1 - spread, 1 + spread)
        model.geom_friction[:] = friction * rng.uniform(1 - spread, 1 + spread)
        model.body_mass[parts] = mass[parts] * heavier
        model.body_inertia[parts] = inertia[parts] * heavier
        self._place(x)
        self._carrier.put(self._object.places(x[self._object.hand])[-1])
        # As arms do, the hand bears the expected load; the difference to the trial's mass pulls it down.
        model.body_gravcomp[parts[0]] = 1 / heavier
        data.xfrc_applied[self._hand, 2] = mass[parts[1]] * -model.opt.gravity[2]
        self._begin(rng)
        self._watch.begin()
        return self._measure(0.0)

    def apply(self, command: Command) -> Measurement:
        """One control step: the hand's target moves as the input says from where the hand truly is, then rests."""
        self._run(self._carrier.orders(self._displacement_per_input @ command.input, command.posture))
        self.mujoco.mj_kinematics(self.model, self.data)  # poses of now; a step leaves those of its beginning
        self._watch.look_at_loose_bodies()
        return self._measure(self.parameters.control_period)

    def truth(self) -> Truth:
        """The true state; its mode says whether the object latched, or something happened that must not."""
        x, incident = np.zeros(self.automaton.n), self._watch.incident
        x[self._object.hand] = self._object.coordinates(self.data.xpos[self._hand])
        latched, latches = self._show(x), zip(self._object.modes, self.latches, strict=True)
        modes = [FREE, *(mode for mode, latch in latches if self.data.eq_active[latch.equality])]
        told = " and ".join(part for part in (incident, self._carrier.complaint) if part)
        return Truth(COLLIDED if incident else modes[-1], x, *self._link_poses(), latched, told)

    def _suspects(self, seen: Floats) -> Flags:
        return self._watch.suspects(seen)

    def _look(self) -> bool:
        return self._watch.look()

    def _link_poses(self) -> tuple[Floats, Floats]:
        """(l, 3) and (l, 4) poses of the links' children; the hand keeps its orientation."""
        position, quaternion = np.zeros((len(self.automaton.links), 3)), np.zeros((len(self.automaton.links), 4))
        position[self._object.parts], quaternion[self._object.parts] = self._poses(self._parts)
        return self._with_slides(self.data.xpos[self._hand], position, quaternion)

    def _with_slides(self, hand: Floats, position: Floats, quaternion: Floats) -> tuple[Floats, Floats]:
        """Poses with those of the slides as they are with the hand at a place (3,): they are no bodies of their own."""
        position[self._object.slides] = self._object.places(self._object.coordinates(hand))
        quaternion[self._object.slides] = [0.0, 0.0, 0.0, 1.0]
        return position, quaternion

    def _measure(self, elapsed: float) -> Measurement:
        position, quaternion = self._seen(*self._link_poses(), elapsed)
        seen = self._with_slides(position[self._object.slides[-1]].copy(), position, quaternion)
        return Measurement(float(self.data.time), *seen, None, self._carrier.joints)


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
        turned = [joint for joint in slides if not np.allclose(joint.quaternion, (0.0, 0.0, 0.0, 1.0), atol=_SAME)]
        if turned or any(joint.kind != "prismatic" for joint in slides):
            raise InputError("the hand of a held object must move on slides that do not turn it")
        self.axes = np.array([joint.axis for joint in slides])
        self._steps = np.array([joint.position for joint in slides])

    def build(self, world: World, hand: Any) -> None:
        """Add the two parts to a world, the first one carried by the body `hand`.

        Raises:
            InputError: if the part cannot turn in the hand as the model says, or if nothing says at which configuration
                the shapes are given.
        """
        grip, mass = self._grip, self._parameters.mass
        rotation, joint = Rotation.from_rotvec(grip.rotation), _joint(self._automaton, self.parts[1])
        place = pose(-rotation.apply(grip.point), rotation.as_quat())
        in_hand = hand.add_body(name=grip.held.name, gravcomp=1, **place)
        if grip.pivots:
            self._add_pivot(world, in_hand)
        world.solids(in_hand, grip.held.shapes, mass, rubbing(IN_HAND, self._parameters))
        fixed = pose(joint.position, joint.quaternion) if joint.kind == "rigid" else {}
        moving = in_hand.add_body(name=grip.moving.name, **fixed)
        if joint.kind != "rigid":
            self._add_joint(world, moving, joint)
        world.solids(moving, grip.moving.shapes, mass, rubbing(MOVING, self._parameters))

    def places(self, hand: Floats) -> Floats:
        """(s, 3) places of the slides' children [m] for the hand's coordinates (s,); the last is the hand's."""
        return np.cumsum(self._steps + hand[:, None] * self.axes, axis=0)

    def coordinates(self, place: Floats) -> Floats:
        """(s,) the hand's coordinates at a place (3,), the nearest ones if the slides do not lead there."""
        return np.asarray(np.linalg.pinv(self.axes.T) @ (place - self._steps.sum(axis=0)))

    def _add_pivot(self, world: World, body: Any) -> None:
        """The turn of the part in the hand against a spring; it shows in a coordinate if nothing else shows that."""
        automaton, grip, own = self._automaton, self._grip, self._parameters
        spring = {"stiffness": own.pivot_stiffness, "damping": own.pivot_damping}
        in_hand, moving = (automaton.links[number].coordinate for number in self.parts)
        world.joint(body, "hinge", "pivot", axis=_HINGE, pos=grip.point, **spring)
        if in_hand in self.hand or (in_hand == moving and _joint(automaton, self.parts[1]).kind != "rigid"):
            return
        nominal, joint = Rotation.from_rotvec(grip.rotation).inv(), _joint(automaton, self.parts[0])
        zero, one = (nominal * forward(joint, [0.0, 1.0]).rotation).as_rotvec()
        sign, off = float((one - zero) @ _HINGE), np.linalg.norm(np.cross(joint.center, joint.axis))
        if joint.kind != "revolute" or abs(abs(sign) - 1.0) > _SAME or off > _SAME:
            raise InputError("a held part can turn in the hand about its point and the hinge's direction only")
        world.show(WorldJoint("pivot", in_hand, round(sign), float(zero @ _HINGE)))

    def _add_joint(self, world: World, body: Any, joint: Joint) -> None:
        """The joint of the other part.

        Latches at its end stops catch it as it comes to them, and none ever opens.
        """
        automaton, grip, own = self._automaton, self._grip, self._parameters
        coordinate = automaton.links[self.parts[1]].coordinate
        pins = {mode.name: pin.value for mode in automaton.modes for pin in mode.pins if pin.coordinate == coordinate}
        datum = max(pins.values(), default=None) if grip.datum is None else grip.datum
        if datum is None:
            raise InputError("nothing says at which configuration the shapes are given", remedy="give 'hold.datum'")
        positions, capture = [value - datum for value in pins.values()], own.latch_capture
        lowest, highest = min([-grip.travel, *positions]), max([0.0, *positions])
        low = [-np.inf if position == lowest else position - capture for position in positions]
        high = [np.inf if position == highest else position + capture for position in positions]
        latches = [Latch(*place) for place in zip(positions, low, high, strict=True)]
        self.modes = tuple(pins)
        kind, axis = ("hinge", (0.0, -1.0, 0.0)) if joint.kind == "revolute" else ("slide", (0.0, 0.0, 1.0))
        # Soft constraints creep: dry friction holds the part up only if it is stiff.
        resistance = {"frictionloss": own.joint_friction, "damping": own.joint_damping}
        world.joint(body, kind, "joint", axis=axis, range=(lowest, highest), **STOPS, **resistance)
        world.show(WorldJoint("joint", coordinate, zero=-datum, latches=latches))


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


def _joint(automaton: HybridAutomaton, link: int) -> Joint:
    joint = automaton.moving_joint(link)
    if joint.kind == "screw":
        raise InputError("a held object cannot have a screw joint", remedy="use the nominal plant for this model")
    return joint


def in_mujoco(problem: Problem) -> PhysicalPlant:
    """The plant for a problem, with its parameters: its object on its joints, or in a hand among bodies of its scene.

    Raises:
        MissingDependencyError: if MuJoCo is not installed.
        InputError: if the problem cannot be simulated.
    """
    if problem.hold is None:
        return StandingPlant(problem.automaton, problem.start, parameters_of(problem))
    posture = problem.start.posture
    return HeldPlant(problem, posture=None if posture is None else np.array(posture))
