"""A held object among bodies in MuJoCo: contact, friction, a swinging part, a latch, and a hand that presses.

The plant reads the problem's geometry and where the learned model latches, but none of the model's modes or contact
kinematics: what touches, slides, folds and catches is physics.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.contacts.product import COLLIDED, FREE
from micah_plan.errors import InputError
from micah_plan.execution.held_mjcf import held_mjcf
from micah_plan.execution.held_parameters import HeldParameters, held_parameters
from micah_plan.execution.mujoco_plant import import_mujoco
from micah_plan.execution.plant import Command, Measurement, Truth
from micah_plan.execution.tracker import PoseTracker, TrackerNoise
from micah_plan.planning.problem import Problem
from micah_plan.planning.start_state import sample_start

Floats = NDArray[np.float64]

# Deeper than this into a body [m] counts as a collision, and so does any push against a body that may not be touched.
LARGEST_PENETRATION = 0.002
_LARGEST_PUSH_N = 2.0
_JOINT = 3


class HeldPlant:
    """The object of a problem with a block `hold`, as a mechanism in MuJoCo."""

    def __init__(self, problem: Problem, parameters: HeldParameters | None = None) -> None:
        """Build the simulation.

        Raises:
            MissingDependencyError: if MuJoCo is not installed.
            InputError: if the problem does not say how the object is held, or its scene cannot be simulated.
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
        turns = self.automaton.coordinates[_JOINT].unit == "rad"
        text = held_mjcf(grip, problem.scene, grip.travel, turns, bool(pins), self.parameters)
        self._model = self._mj.MjModel.from_xml_string(text)
        self._data = self._mj.MjData(self._model)
        self._nominal = self._model.geom_friction.copy(), self._model.body_mass.copy(), self._model.body_inertia.copy()
        self._address = [int(self._model.joint(name).qposadr[0]) for name in ("x", "y", "z", "swing")]
        self._parts = [self._model.body(name).id for name in ("hand", grip.held.name, grip.moving.name)]
        allowed = {body for body, _, _ in problem.hold.contacts}
        names = [self._model.geom(i).name for i in range(self._model.ngeom)]
        self._forbidden = np.array([n.startswith("scene/") and n.split("/")[1] not in allowed for n in names])
        self._scene = np.array([name.startswith("scene/") for name in names])
        # As arms do, the hand carries the load that it expects; what the trial's mass differs by pulls it down.
        self._load = float(self._model.body_mass[self._parts[2]] * -self._model.opt.gravity[2])
        self._lift = int(self._model.joint("z").dofadr[0])
        self._steps = round(self.parameters.control_period / self._model.opt.timestep)
        self._collision = ""
        self._tracker: PoseTracker | None = None

    def reset(self, rng: np.random.Generator) -> Measurement:
        """A new trial: a start drawn from the belief; masses and friction drawn anew."""
        x = sample_start(self.automaton, self.problem.start, rng)[1]
        friction, mass, inertia = self._nominal
        spread = self.parameters.spread
        heavier = rng.uniform(1 - spread, 1 + spread)
        self._model.geom_friction[:] = friction * rng.uniform(1 - spread, 1 + spread)
        self._model.body_mass[:], self._model.body_inertia[:] = mass * heavier, inertia * heavier
        self._mj.mj_resetData(self._model, self._data)
        for address, value in zip(self._address, (*x[:3], x[_JOINT] - self._datum), strict=True):
            self._data.qpos[address] = value
        self._data.ctrl[:] = x[:3]
        self._data.qfrc_applied[self._lift] = self._load
        self._collision = ""
        self._mj.mj_forward(self._model, self._data)
        noise = TrackerNoise(self.parameters.position_noise, self.parameters.rotation_noise, 0.0, 0.0, 1.0)
        self._tracker = PoseTracker(noise, len(self.automaton.links), rng)
        return self._measure(0.0)

    def apply(self, command: Command) -> Measurement:
        """One control step: the hand's target moves by the input from where the hand truly is, then rests."""
        begin = self._data.qpos[self._address[:3]].copy()
        moving = max(1, round(self._steps * self.parameters.motion_share))
        for step in range(1, self._steps + 1):
            self._data.ctrl[:] = begin + command.input * min(1.0, step / moving)
            self._mj.mj_step(self._model, self._data)
            self._catch()
            self._watch()
        return self._measure(self.parameters.control_period)

    def truth(self) -> Truth:
        """The true state; its mode says whether the object latched, or hit what it must not."""
        x = self._data.qpos[self._address].copy()
        x[_JOINT] += self._datum
        held = np.zeros(self.automaton.n, dtype=bool)
        held[_JOINT] = self._is_latched
        rigid = next((mode.name for mode in self.automaton.modes if mode.pins), FREE)
        mode = COLLIDED if self._collision else (rigid if self._is_latched else FREE)
        return Truth(mode, x, *self._poses(), held, self._collision)

    def close(self) -> None:
        """Free the simulation."""
        self._model = self._data = None

    @property
    def _is_latched(self) -> bool:
        return self._latched_at is not None and bool(self._data.eq_active[0])

    def _catch(self) -> None:
        """The latch engages as the joint comes to it, and holds."""
        if self._latched_at is not None and not self._data.eq_active[0]:
            self._data.eq_active[0] = bool(self._data.qpos[self._address[_JOINT]] > -self.parameters.latch_capture)

    def _watch(self) -> None:
        """Remember the first contact that should not have been: too deep, or with a body that may not be touched."""
        for number in range(self._data.ncon if not self._collision else 0):
            contact = self._data.contact[number]
            geom = contact.geom1 if self._scene[contact.geom1] else contact.geom2
            push = np.zeros(6)
            self._mj.mj_contactForce(self._model, self._data, number, push)
            if contact.dist < -LARGEST_PENETRATION or (self._forbidden[geom] and push[0] > _LARGEST_PUSH_N):
                body = self._model.geom(geom).name.split("/")[1]
                depth = max(0.0, -1e3 * contact.dist)
                when = f"at {self._data.time:.1f} s"
                self._collision = f"it hit '{body}' {when} with {push[0]:.0f} N, {depth:.1f} mm deep"

    def _poses(self) -> tuple[Floats, Floats]:
        """Poses of the links' children: the hand's slides, the hand, the two parts."""
        hand, held, moving = (self._data.xpos[i].copy() for i in self._parts)
        position = np.array([[hand[0], 0.0, 0.0], [hand[0], hand[1], 0.0], hand, held, moving])
        quaternion = np.tile([0.0, 0.0, 0.0, 1.0], (5, 1))
        quaternion[3:] = self._data.xquat[self._parts[1:]][:, [1, 2, 3, 0]]
        return position, np.where(quaternion[:, 3:] < 0, -quaternion, quaternion)

    def _measure(self, elapsed: float) -> Measurement:
        if self._tracker is None:  # reset creates it before measuring
            raise RuntimeError("measure before reset")
        position, quaternion = self._tracker.measure(*self._poses(), elapsed)
        # The slides are no bodies of their own: what is seen of them is seen of the hand.
        position[0], position[1] = [position[2, 0], 0.0, 0.0], [*position[2, :2], 0.0]
        quaternion[:3] = [0.0, 0.0, 0.0, 1.0]
        return Measurement(float(self._data.time), position, quaternion, None)
