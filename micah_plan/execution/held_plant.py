"""A held object among bodies in MuJoCo: contact, friction, a swinging part, a latch, and a hand that an arm carries.

The plant reads the problem's geometry and where the learned model latches, but none of the model's modes or contact
kinematics: what touches, slides, folds, catches and falls is physics.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.contacts.product import FREE
from micah_plan.automaton.contacts.values import COLLIDED
from micah_plan.errors import InputError
from micah_plan.execution.carrier import Carrier, Slides
from micah_plan.execution.held_mjcf import OBJECT, object_mjcf, scene_mjcf
from micah_plan.execution.held_parameters import HeldParameters, held_parameters
from micah_plan.execution.incidents import Watch
from micah_plan.execution.physics_library import check_stable, import_mujoco
from micah_plan.execution.plant import Command, Measurement, Truth
from micah_plan.execution.tracker import PoseTracker, TrackerNoise
from micah_plan.task.problem import Hold, Problem
from micah_plan.task.start import sample_start

Floats = NDArray[np.float64]

_JOINT = 3


class HeldPlant:
    """The object of a problem with a block `hold`, as a mechanism in MuJoCo; the problem's robot carries it, if any."""

    def __init__(
        self, problem: Problem, parameters: HeldParameters | None = None, posture: Floats | None = None
    ) -> None:
        """Build the simulation.

        Args:
            posture: (n,) joints of the arm near which it starts, as a plan has them; None: one is sought.

        Raises:
            MissingDependencyError: if MuJoCo is not installed.
            InputError: if the problem does not say how the object is held, or its scene or robot cannot be simulated.
        """
        if problem.hold is None:
            raise InputError("the problem does not say how the object is held", remedy="add the block 'hold'")
        self._mj = import_mujoco()
        self.problem, self.automaton = problem, problem.automaton
        self.parameters = parameters or held_parameters(problem)
        grip = problem.hold.grip
        pins = [pin.value for mode in self.automaton.modes for pin in mode.pins if pin.coordinate == _JOINT]
        datum = grip.datum if grip.datum is not None else max(pins, default=None)
        if datum is None:
            raise InputError("nothing says at which configuration the shapes are given", remedy="give 'hold.datum'")
        self._datum, self._latched_at = float(datum), max(pins, default=None)
        self._model, self._data, self._carrier = self._built(problem.hold, bool(pins), posture)
        self._nominal = self._model.geom_friction.copy(), self._model.body_mass.copy(), self._model.body_inertia.copy()
        self._swing = int(self._model.joint(OBJECT + "swing").qposadr[0])
        self._hand, *self._parts = [self._model.body(OBJECT + n).id for n in ("hand", grip.held.name, grip.moving.name)]
        self._watch = Watch(self._mj, self._model, {body for body, _, _ in problem.hold.contacts})
        self._steps = round(self.parameters.control_period / self._model.opt.timestep)
        self._tracker: PoseTracker | None = None

    def reset(self, rng: np.random.Generator) -> Measurement:
        """A new trial: a start drawn from the belief; the object's masses and all friction drawn anew."""
        x = sample_start(self.automaton, self.problem.start, rng)[1]
        friction, mass, inertia = self._nominal
        spread = self.parameters.spread
        heavier = rng.uniform(1 - spread, 1 + spread)
        self._model.geom_friction[:] = friction * rng.uniform(1 - spread, 1 + spread)
        self._model.body_mass[self._parts] = mass[self._parts] * heavier
        self._model.body_inertia[self._parts] = inertia[self._parts] * heavier
        self._mj.mj_resetData(self._model, self._data)
        self._data.qpos[self._swing] = x[_JOINT] - self._datum
        self._carrier.put(x[:3])
        # As arms do, the hand carries the load that it expects; what the trial's mass differs by pulls it down.
        held, moving = self._parts
        self._model.body_gravcomp[held] = 1 / heavier
        self._data.xfrc_applied[self._hand, 2] = mass[moving] * -self._model.opt.gravity[2]
        self._mj.mj_forward(self._model, self._data)
        self._watch.begin(self._data)
        noise = TrackerNoise(self.parameters.position_noise, self.parameters.rotation_noise, 0.0, 0.0, 1.0)
        self._tracker = PoseTracker(noise, len(self.automaton.links), rng)
        return self._measure(0.0)

    def apply(self, command: Command) -> Measurement:
        """One control step: the hand's target moves by the input from where the hand truly is, then rests."""
        self._carrier.aim(command.input, command.posture)
        moving = max(1, round(self._steps * self.parameters.motion_share))
        for step in range(1, self._steps + 1):
            self._carrier.move(min(1.0, step / moving))
            self._mj.mj_step(self._model, self._data)
            self._catch()
            self._watch.touch(self._data)
        check_stable(self._mj, self._data)
        self._mj.mj_kinematics(self._model, self._data)  # poses of now; a step leaves those of its beginning
        self._watch.stand(self._data)
        return self._measure(self.parameters.control_period)

    def truth(self) -> Truth:
        """The true state; its mode says whether the object latched, or something happened that must not."""
        x = np.append(self._data.xpos[self._hand], self._data.qpos[self._swing] + self._datum)
        held = np.zeros(self.automaton.n, dtype=bool)
        held[_JOINT] = self._is_latched
        rigid = next((mode.name for mode in self.automaton.modes if mode.pins), FREE)
        incident = self._watch.incident
        mode = COLLIDED if incident else (rigid if self._is_latched else FREE)
        told = " and ".join(part for part in (incident, self._carrier.complaint) if part)
        return Truth(mode, x, *self._poses(), held, told)

    def close(self) -> None:
        """Free the simulation."""
        self._model = self._data = None

    def _built(self, hold: Hold, latches: bool, posture: Floats | None) -> tuple[Any, Any, Carrier]:
        """Model, data, and what carries the hand."""
        mj, problem, parameters = self._mj, self.problem, self.parameters
        world = mj.MjSpec.from_string(scene_mjcf(problem.scene, parameters))
        turns = self.automaton.coordinates[_JOINT].unit == "rad"
        robot, grasp = problem.robot, problem.grasp
        text = object_mjcf(hold.grip, turns, latches, parameters, slides=robot is None)
        hand = mj.MjSpec.from_string(text).body("hand")
        if robot is None or grasp is None:
            world.worldbody.add_frame().attach_body(hand, OBJECT, "")
            model = world.compile()
            data = mj.MjData(model)
            return model, data, Slides(model, data)
        # Pinocchio is loaded only where there is an arm.
        from micah_plan.execution.arm_carrier import ArmCarrier
        from micah_plan.execution.arm_model import attach_arm, fix_to_tool
        from micah_plan.robot.along_plan import start_posture
        from micah_plan.robot.load_arm import load_arm

        arm = load_arm(robot)
        attach_arm(mj, world, robot, arm, parameters)
        fix_to_tool(world, robot.tool, hand, grasp.pose.inv(), OBJECT)
        model = world.compile()
        data = mj.MjData(model)
        near = start_posture(problem) if posture is None else posture
        return model, data, ArmCarrier(mj, model, data, arm, grasp, near)

    @property
    def _is_latched(self) -> bool:
        return self._latched_at is not None and bool(self._data.eq_active[self._model.equality(OBJECT + "latch").id])

    def _catch(self) -> None:
        """The latch engages as the joint comes to it, and holds."""
        if self._latched_at is not None and not self._is_latched:
            caught = bool(self._data.qpos[self._swing] > -self.parameters.latch_capture)
            self._data.eq_active[self._model.equality(OBJECT + "latch").id] = caught

    def _poses(self) -> tuple[Floats, Floats]:
        """Poses of the links' children: the hand's slides, the hand, the two parts."""
        hand, held, moving = (self._data.xpos[i].copy() for i in (self._hand, *self._parts))
        position = np.array([[hand[0], 0.0, 0.0], [hand[0], hand[1], 0.0], hand, held, moving])
        quaternion = np.tile([0.0, 0.0, 0.0, 1.0], (5, 1))
        quaternion[3:] = self._data.xquat[self._parts][:, [1, 2, 3, 0]]
        return position, np.where(quaternion[:, 3:] < 0, -quaternion, quaternion)

    def _measure(self, elapsed: float) -> Measurement:
        if self._tracker is None:  # reset creates it before measuring
            raise RuntimeError("measure before reset")
        position, quaternion = self._tracker.measure(*self._poses(), elapsed)
        # The slides are no bodies of their own: what is seen of them is seen of the hand.
        position[0], position[1] = [position[2, 0], 0.0, 0.0], [*position[2, :2], 0.0]
        quaternion[:3] = [0.0, 0.0, 0.0, 1.0]
        return Measurement(float(self._data.time), position, quaternion, None, self._carrier.joints)
