"""An object in a hand among bodies, in MuJoCo: contact, friction, a joint that moves freely, latches, and a carrier.

The plant reads the problem's geometry and where the learned model latches, but none of the model's modes or contact
kinematics: what touches, slides, folds, catches and falls is physics.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.contacts.product import FREE
from micah_plan.automaton.contacts.values import AXES, COLLIDED
from micah_plan.errors import InputError
from micah_plan.execution.mujoco.core import Carrier, Core, import_mujoco
from micah_plan.execution.mujoco.held_object import JOINT, OBJECT, held_object
from micah_plan.execution.mujoco.incidents import Watch, add_contact_sensors
from micah_plan.execution.mujoco.parameters import PhysicalParameters, parameters_of
from micah_plan.execution.mujoco.world import held_mjcf, scene_mjcf
from micah_plan.execution.plant import Command, Measurement, Truth
from micah_plan.execution.pose import input_effect
from micah_plan.task.problem import Hold, Problem
from micah_plan.task.start import sample_start

Floats = NDArray[np.float64]


class HeldPlant:
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
        self.problem, self.automaton = problem, problem.automaton
        self.parameters = parameters or parameters_of(problem)
        self._object = held_object(self.automaton, problem.hold.grip)
        # Inputs displace the hand in every mode; contacts alone move the object's joint.
        inputs = input_effect(self.automaton, self.automaton.modes[0].name)[self._object.hand]
        self._displacement_per_input = self._object.reach[-1] @ inputs
        self._core, self._carrier = self._built(problem.hold, posture)
        model, grip = self._core.model, problem.hold.grip
        self._nominal = model.geom_friction.copy(), model.body_mass.copy(), model.body_inertia.copy()
        self._hand, *self._parts = [model.body(OBJECT + n).id for n in ("hand", grip.held.name, grip.moving.name)]
        self._watch = Watch(self._core, {body for body, _, _ in problem.hold.contacts})
        capture, (lowest, highest) = self.parameters.latch_capture, self._object.stops
        for number, (_, position) in enumerate(self._object.latches):
            # Those at its end stops catch the joint as it comes to them, and none ever opens.
            low = -np.inf if position == lowest else position - capture
            high = np.inf if position == highest else position + capture
            self._core.add_latch(OBJECT + JOINT, number, position, low, high)

    def reset(self, rng: np.random.Generator) -> Measurement:
        """A new trial: a start drawn from the belief; the object's mass and all friction drawn anew."""
        core, model, data = self._core, self._core.model, self._core.data
        x = sample_start(self.automaton, self.problem.start, rng)[1]
        friction, mass, inertia = self._nominal
        in_hand, other = self._parts
        spread = self.parameters.spread
        heavier = rng.uniform(1 - spread, 1 + spread)
        model.geom_friction[:] = friction * rng.uniform(1 - spread, 1 + spread)
        model.body_mass[self._parts] = mass[self._parts] * heavier
        model.body_inertia[self._parts] = inertia[self._parts] * heavier
        core.place(x)
        self._carrier.put(self._object.places(x[self._object.hand])[-1])
        # As arms do, the hand bears the load that it expects; what the trial's mass differs by pulls it down.
        model.body_gravcomp[in_hand] = 1 / heavier
        data.xfrc_applied[self._hand, 2] = mass[other] * -model.opt.gravity[2]
        core.begin(rng)
        self._watch.begin()
        return self._measure(0.0)

    def apply(self, command: Command) -> Measurement:
        """One control step: the hand's target moves as the input says from where the hand truly is, then rests."""
        core = self._core
        displacement = self._displacement_per_input @ command.input
        core.run(self._carrier.orders(displacement, command.posture), self._watch)
        core.mujoco.mj_kinematics(core.model, core.data)  # poses of now; a step leaves those of its beginning
        self._watch.look_at_loose_bodies()
        return self._measure(self.parameters.control_period)

    def truth(self) -> Truth:
        """The true state; its mode says whether the object latched, or something happened that must not."""
        core, incident = self._core, self._watch.incident
        x = np.zeros(self.automaton.n)
        x[self._object.hand] = self._object.coordinates(core.data.xpos[self._hand])
        latched = core.show(x)
        closed = [
            mode for (mode, _), latch in zip(self._object.latches, core.latches, strict=True) if core.is_locked(latch)
        ]
        told = " and ".join(part for part in (incident, self._carrier.complaint) if part)
        return Truth(COLLIDED if incident else [FREE, *closed][-1], x, *self._poses(), latched, told)

    def close(self) -> None:
        """Free the simulation."""
        self._core.close()

    def _built(self, hold: Hold, posture: Floats | None) -> tuple[Core, Carrier]:
        """The world, and what carries the hand."""
        mujoco, problem, parameters = import_mujoco(), self.problem, self.parameters
        robot, grasp = problem.robot, problem.grasp
        world = mujoco.MjSpec.from_string(scene_mjcf(problem.scene, parameters))
        text = held_mjcf(self._object, hold.grip, parameters, slides=robot is None or grasp is None)
        hand = mujoco.MjSpec.from_string(text).body("hand")

        def compiled() -> Core:
            add_contact_sensors(mujoco, world, {body for body, _, _ in hold.contacts}, hold.grip)
            return Core(world.compile(), parameters, len(self.automaton.links), self._object.shown)

        if robot is None or grasp is None:
            world.worldbody.add_frame().attach_body(hand, OBJECT, "")
            return (core := compiled()), Carrier(core, [OBJECT + axis for axis in AXES])
        # Pinocchio is loaded only where there is an arm.
        from micah_plan.execution.mujoco.arm import ArmCarrier, attach_arm, fix_to_tool
        from micah_plan.robot.along_plan import start_posture
        from micah_plan.robot.load_arm import load_arm

        arm = load_arm(robot)
        attach_arm(mujoco, world, robot, arm, parameters)
        fix_to_tool(world, robot.tool, hand, grasp.pose.inv(), OBJECT)
        core = compiled()
        return core, ArmCarrier(core, arm, grasp, start_posture(problem) if posture is None else posture)

    def _poses(self) -> tuple[Floats, Floats]:
        """(l, 3) and (l, 4) poses of the links' children; the hand keeps its orientation."""
        position, quaternion = np.zeros((len(self.automaton.links), 3)), np.zeros((len(self.automaton.links), 4))
        parts = [self._object.in_hand, self._object.moving]
        position[parts], quaternion[parts] = self._core.poses(self._parts)
        return self._with_slides(self._core.data.xpos[self._hand], position, quaternion)

    def _with_slides(self, hand: Floats, position: Floats, quaternion: Floats) -> tuple[Floats, Floats]:
        """Poses with those of the slides as they are with the hand at a place (3,): they are no bodies of their own."""
        position[self._object.slides] = self._object.places(self._object.coordinates(hand))
        quaternion[self._object.slides] = [0.0, 0.0, 0.0, 1.0]
        return position, quaternion

    def _measure(self, elapsed: float) -> Measurement:
        position, quaternion = self._core.seen(*self._poses(), elapsed)
        hand = position[self._object.slides[-1]].copy()
        seen = self._with_slides(hand, position, quaternion)
        return Measurement(float(self._core.data.time), *seen, None, self._carrier.joints)
