"""An object in a hand among bodies, in MuJoCo: contact, friction, a joint that moves freely, latches, and a carrier.

The plant uses the problem's geometry and where the learned model latches, but none of the model's modes or contact
kinematics: contacts, sliding, folding, latching and falling are physics.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.contacts.product import FREE
from micah_plan.automaton.contacts.values import AXES, COLLIDED
from micah_plan.errors import InputError
from micah_plan.execution.mujoco.core import Carrier, PhysicalPlant
from micah_plan.execution.mujoco.held_object import HeldObject
from micah_plan.execution.mujoco.incidents import IncidentWatch, add_contact_sensors
from micah_plan.execution.mujoco.parameters import PhysicalParameters, parameters_of
from micah_plan.execution.mujoco.released import Handover, ReleasedPlant, Support, contact_force
from micah_plan.execution.mujoco.standing import StandingPlant
from micah_plan.execution.mujoco.world import (
    OBJECT,
    Flags,
    World,
    add_hand,
    scene_world,
)
from micah_plan.execution.plant import Command, Measurement, Truth
from micah_plan.execution.pose import input_effect
from micah_plan.task.problem import Problem
from micah_plan.task.start import sample_start

# After so many steps a hand that moves until contact checks the force.
_LOOKS = 5
# Time constant of what measures it [s]: the blow as two things meet is none that stops a hand.
_FORCE_LAG = 0.03


class HeldPlant(PhysicalPlant):
    """The object of a problem with a block `hold`, as a mechanism in MuJoCo; the problem's robot carries it, if any.

    Attributes:
        carrier: of the hand.
        support: on which the object is put down where the problem releases it.
        parts: numbers of the bodies of the part in the hand and of the other one.
    """

    def __init__(
        self, problem: Problem, parameters: PhysicalParameters | None = None, posture: Floats | None = None
    ) -> None:
        """Build the simulation.

        Args:
            parameters: of the physics; None: from the problem.
            posture: (J,) joints of the arm near which it starts, as a plan has them; None: one is sought.

        Raises:
            MissingDependencyError: if MuJoCo is not installed.
            InputError: if the problem does not define how the object is held, or its model, scene or robot cannot be
                simulated.
        """
        if problem.hold is None:
            raise InputError("the problem does not define how the object is held", remedy="add the block 'hold'")
        automaton, grip, parameters = problem.automaton, problem.hold.grip, parameters or parameters_of(problem)
        has_arm = problem.robot is not None and problem.grasp is not None
        touchable = {body for body, _, _ in problem.hold.contacts}
        touchable |= set() if problem.release is None else {problem.release.support}
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
        self.carrier, self._watch, model = carry(self), IncidentWatch(self, touchable), self.model
        self._nominal = model.geom_friction.copy(), model.body_mass.copy(), model.body_inertia.copy()
        self._released = None if problem.release is None else ReleasedPlant(problem, parameters, posture)
        self.support = Support(problem, model)
        self._hand, *self.parts = [model.body(OBJECT + n).id for n in ("hand", grip.held.name, grip.moving.name)]

    def reset(self, rng: np.random.Generator) -> Measurement:
        """Start a trial: a start sampled from the belief, with mass and friction sampled anew."""
        model, data, parts, spread = self.model, self.data, self.parts, self.parameters.spread
        x = sample_start(self.automaton, self.problem.start, rng)[1]
        friction, mass, inertia = self._nominal
        heavier = rng.uniform(1 - spread, 1 + spread)
        rougher = rng.uniform(1 - spread, 1 + spread)
        model.geom_friction[:] = friction * rougher
        model.body_mass[parts] = mass[parts] * heavier
        model.body_inertia[parts] = inertia[parts] * heavier
        self._place(x)
        self.carrier.put(self._object.places(x[self._object.hand])[-1])
        # As arms do, the hand bears the expected load; the difference to the trial's mass pulls it down.
        model.body_gravcomp[parts[0]] = 1 / heavier
        data.xfrc_applied[self._hand, 2] = mass[parts[1]] * -model.opt.gravity[2]
        self._draws, self._is_open, self._stopped_by = rng, False, 0.0
        self._factors = heavier, rougher
        if self._released is not None:
            self.support.draw(rng)
        self._begin(rng)
        self._watch.begin()
        return self._measure(0.0)

    def apply(self, command: Command) -> Measurement:
        """One control step: the hand's target moves by the input from the hand's true position, then rests.

        With a limit on the force, it stops when the limit is reached.
        """
        displacement = self._displacement_per_input @ command.input
        if self._released is not None and (self._is_open or command.opens):
            return self._apply_open(self._released, command, displacement)
        orders, self._stopped_by = self.carrier.orders(displacement, command.posture), 0.0
        if command.force_limit is None:
            self._run(orders)
        else:
            self._guarded(orders, command.force_limit)
        self.mujoco.mj_kinematics(self.model, self.data)  # poses of now; a step leaves those of its beginning
        self._watch.look_at_loose_bodies()
        return self._measure(self.parameters.control_period)

    def _guarded(self, orders: Floats, limit: float) -> None:
        """A control step that ends when the hand's force exceeds a limit [N]."""
        before = felt = self._push()[2]
        share = 1.0 - np.exp(-_LOOKS * self.model.opt.timestep / _FORCE_LAG)
        for begin in range(0, len(orders), _LOOKS):
            self._run(orders[begin : begin + _LOOKS])
            felt += share * (self._push()[2] - felt)
            if felt - before >= limit:
                self._stopped_by = felt - before
                orders[begin + _LOOKS :] = self.carrier.resting(orders[min(begin + _LOOKS, len(orders)) - 1])

    def _push(self) -> Floats:
        """(3,) contact force on the object except that of the hand [N]."""
        return contact_force(self, self.parts)

    def _apply_open(self, released: ReleasedPlant, command: Command, displacement: Floats) -> Measurement:
        """A step of a hand that has opened, or opens now."""
        if not self._is_open:
            self._is_open = True
            held, raised = self.parts[0], self.support.raised
            released.take_over(Handover(self, self.carrier, held, raised, *self._factors), self._draws)
            released.open()
        else:
            released.move(displacement, command.posture)
        return self._measure(self.parameters.control_period)

    def truth(self) -> Truth:
        """The true state; its mode is the latch, or a collision."""
        x, incident = np.zeros(self.automaton.n), self._watch.incident
        latched, latches = self._show(x), zip(self._object.modes, self.latches, strict=True)
        stands, complaint, place = False, self.carrier.complaint, self.data.xpos[self._hand]
        if self._is_open and self._released is not None:
            place, stands = self._released.place, self._released.stands
            incident, complaint = incident or self._released.incident, complaint or self._released.complaint
        x[self._object.hand] = self._object.coordinates(place)
        modes = [FREE, *(mode for mode, latch in latches if self.data.eq_active[latch.equality])]
        problem = " and ".join(part for part in (incident, complaint) if part)
        return Truth(COLLIDED if incident else modes[-1], x, *self._link_poses(), latched, problem, stands)

    def _suspects(self, measured: Floats) -> Flags:
        return self._watch.suspects(measured)

    def _check_state(self) -> bool:
        return self._watch.look()

    def _link_poses(self) -> tuple[Floats, Floats]:
        """(l, 3) and (l, 4) poses of the links' children; the hand keeps its orientation."""
        position, quaternion = np.zeros((len(self.automaton.links), 3)), np.zeros((len(self.automaton.links), 4))
        release_mode = self._released if self._is_open and self._released is not None else None
        poses, hand = (
            (self._poses(self.parts), self.data.xpos[self._hand])
            if release_mode is None
            else (release_mode.parts, release_mode.hand)
        )
        position[self._object.parts], quaternion[self._object.parts] = poses
        return self._with_slides(hand, position, quaternion)

    def _with_slides(self, hand: Floats, position: Floats, quaternion: Floats) -> tuple[Floats, Floats]:
        """Poses with those of the slides derived from the hand's position (3,): they are not bodies of the world."""
        position[self._object.slides] = self._object.places(self._object.coordinates(hand))
        quaternion[self._object.slides] = [0.0, 0.0, 0.0, 1.0]
        return position, quaternion

    def _measure(self, elapsed: float) -> Measurement:
        position, quaternion = self._tracked(*self._link_poses(), elapsed)
        measured = self._with_slides(position[self._object.slides[-1]].copy(), position, quaternion)
        released_mode = self._released
        if released_mode is None:
            return Measurement(float(self.data.time), *measured, None, self.carrier.joints)
        if self._is_open:
            return Measurement(released_mode.time, *measured, np.zeros((len(measured[0]), 3)), released_mode.joints)
        force = np.zeros((len(measured[0]), 3))
        felt = self._push() + self.parameters.force_noise * self._draws.standard_normal(3)
        felt[2] = max(felt[2], self._stopped_by)
        force[self._object.parts[0]] = -felt
        return Measurement(float(self.data.time), *measured, force, self.carrier.joints)


def in_mujoco(problem: Problem) -> PhysicalPlant:
    """The plant for a problem with its parameters: an object on its joints, or in a hand among bodies.

    Raises:
        MissingDependencyError: if MuJoCo is not installed.
        InputError: if the problem cannot be simulated.
    """
    if problem.hold is None:
        return StandingPlant(problem.automaton, problem.start, parameters_of(problem))
    posture = problem.start.posture
    return HeldPlant(problem, posture=None if posture is None else np.array(posture))
