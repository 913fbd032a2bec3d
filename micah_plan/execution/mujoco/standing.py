"""An object that stands, in MuJoCo: rigid bodies, friction, end stops, latches, and a hand that pulls at each part.

The plant reads the model's geometry, but none of its dynamics: what moves, sticks, latches or springs back is physics.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.execution.mujoco.core import LONGEST_STEP, Flags, PhysicalPlant, import_mujoco
from micah_plan.execution.mujoco.parameters import PhysicalParameters
from micah_plan.execution.mujoco.standing_object import standing_bodies
from micah_plan.execution.mujoco.world import Latch, WorldBody, lever_name, standing_mjcf
from micah_plan.execution.plant import Command, Measurement, Truth
from micah_plan.task.start import Start, sample_start

_STEPS_PER_RADIAN = 5.0


class StandingPlant(PhysicalPlant):
    """Any automaton whose parts each have one moving joint, as a mechanism in MuJoCo.

    Each part's handle is pulled by a compliant hand (spring, critical damping, limited force) that is told
    displacements relative to where it is. Within a control step its target moves on a straight line and then rests. Its
    law is that of motors in the world, so that the engine can take steps alone as long as no hand is too strong.
    """

    def __init__(self, automaton: HybridAutomaton, start: Start, parameters: PhysicalParameters | None = None) -> None:
        """Build the simulation.

        Args:
            automaton: the object; its shapes if it has any, else boxes.
            start: the belief from which true starts are drawn.
            parameters: of the physics; None: the defaults.

        Raises:
            MissingDependencyError: if MuJoCo is not installed.
            InputError: if the automaton cannot be built as a mechanism.
        """
        mujoco, parameters = import_mujoco(), parameters or PhysicalParameters()
        bodies = standing_bodies(automaton, parameters)
        text = standing_mjcf(bodies, automaton.part(BASE).shapes, parameters.gravity)
        super().__init__(automaton, parameters, mujoco.MjModel.from_xml_string(text), bodies)
        self.start = start
        self._bodies = [self.model.body(body.name).id for body in bodies]
        self._still: Floats = np.zeros(automaton.n)
        self._motors = 3 * len(bodies)
        self._targets = np.zeros((1, self._motors))
        self._damping = self._tuned(bodies)
        # By a latching joint's address: its first sensor's column, whether it is a hinge, and which hands pull at it.
        self._levers = {
            int(self.model.joint(joint.name).qposadr[0]): (
                int(self.model.sensor(lever_name(joint.name)).adr[0]),
                joint.attributes["type"] == "hinge",
                _moved_with(body, bodies),
            )
            for body in bodies
            for joint in body.joints
            if joint.latches
        }

    def reset(self, rng: np.random.Generator) -> Measurement:
        """A new trial: a start drawn from the belief, everything at rest, latched if the start mode pins it."""
        mode, x = sample_start(self.automaton, self.start, rng)
        self._still = x.copy()
        for joint, _ in self._shown:
            if not joint.follows:
                x[joint.coordinate] = np.clip(x[joint.coordinate], *joint.attributes["range"])
        self._place(x)
        free = self.automaton.mode(mode).free
        for latch in self.latches:
            position = x[latch.coordinate]
            closed = not free[latch.coordinate] and abs(position - latch.position) < 1e-9
            latch.armed = closed or not latch.is_near(position)
            self.data.eq_active[latch.equality] = closed
        # The hands take hold of the handles where they are, without a force.
        self.mujoco.mj_fwdPosition(self.model, self.data)
        self._targets = self.data.actuator_length[None].copy()
        self.data.ctrl[:] = self.parameters.stiffness * self._targets[0]
        self._begin(rng)
        return self._measure(0.0, np.zeros((len(self._bodies), 3)))

    def apply(self, command: Command) -> Measurement:
        """One control step: every hand moves by the command's displacement from where its handle truly is."""
        begin, end = self._targets[-1], self.data.actuator_length + command.handle.ravel()
        speed = (end - begin) / (self._moving_steps * self.model.opt.timestep)
        self._targets = begin + self.shares[:, None] * (end - begin)
        controls = self.parameters.stiffness * self._targets
        controls[: self._moving_steps] += self._damping * speed
        self._run(controls)
        self.mujoco.mj_fwdPosition(self.model, self.data)  # places of now; a step leaves those of its beginning
        return self._measure(self.parameters.control_period, np.array(self.data.actuator_force).reshape(-1, 3))

    def truth(self) -> Truth:
        """The true configuration, poses and latches."""
        x = self._still.copy()
        latched = self._show(x)
        return Truth(None, x, *self._poses(self._bodies), latched)

    def _measure(self, elapsed: float, force: Floats) -> Measurement:
        return Measurement(float(self.data.time), *self._seen(*self._poses(self._bodies), elapsed), force)

    def _suspects(self, seen: Floats) -> Flags:
        """Where a hand was too strong."""
        forces = seen[:, self._motors : 2 * self._motors].reshape(len(seen), -1, 3)
        return np.asarray((self._limited(forces) != forces).any(axis=(1, 2)))

    def _limit_hands(self) -> bool:
        data, limit, stiffness = self.data, self.parameters.max_force, self.parameters.stiffness
        passive = stiffness * data.actuator_length + self._damping * data.actuator_velocity
        forces, too_strong = (data.ctrl - passive).tolist(), False
        for i in range(0, self._motors, 3):  # in plain floats, which is faster
            size = math.hypot(*forces[i : i + 3])
            if size > limit:
                data.ctrl[i : i + 3] += np.multiply(forces[i : i + 3], limit / size - 1.0)
                too_strong = True
        return too_strong

    def _limited(self, forces: Floats) -> Floats:
        """Forces (..., 3) with those cut that are more than a hand has [N]."""
        size = np.sqrt(np.square(forces).sum(axis=-1, keepdims=True))
        return np.asarray(forces * (self.parameters.max_force / np.maximum(size, self.parameters.max_force)))

    def _pull(self, latch: Latch, begin: int, seen: Floats) -> Floats:
        """Of the hands' springs; without damping: the damper's kick when a latch snaps shut is no pull that would open
        it."""
        column, turns, hands = self._levers[latch.joint]
        places = seen[:, : self._motors].reshape(len(seen), -1, 3)[:, hands]
        targets = self._targets[begin : begin + len(seen)].reshape(len(seen), -1, 3)[:, hands]
        pulls = self._limited(self.parameters.stiffness * (targets - places))
        if turns:
            pulls = np.cross(places - seen[:, None, column : column + 3], pulls)
        return np.asarray((seen[:, None, column + 3 : column + 6] * pulls).sum(axis=(1, 2)))

    def _tuned(self, bodies: Sequence[WorldBody]) -> Floats:
        """(3 l,) the motors' critical damping [N s/m]; sets them and a pace that resolves their springs."""
        model, stiffness = self.model, self.parameters.stiffness
        dofs = {body.name: int(model.joint(body.name).dofadr[0]) for body in bodies if body.joints}
        inertia = [model.dof_M0[dofs[body.name]] if body.joints else 0.0 for body in bodies]
        masses = np.array(inertia) / np.square([body.arm for body in bodies])
        if dofs:
            fastest = float(np.sqrt(stiffness / masses[masses > 0].min()))
            self._set_pace(min(LONGEST_STEP, 1 / (_STEPS_PER_RADIAN * fastest)))
        damping = np.repeat(2 * np.sqrt(stiffness * masses), 3)
        model.actuator_biasprm[:, 1], model.actuator_biasprm[:, 2] = -stiffness, -damping
        return np.asarray(damping)


def _moved_with(body: WorldBody, bodies: Sequence[WorldBody]) -> list[int]:
    """Numbers of the bodies that a body's joint moves: its own, and those that are attached to it."""
    names = {body.name}
    names.update(other.name for other in bodies if other.parent in names)
    return [number for number, other in enumerate(bodies) if other.name in names]
