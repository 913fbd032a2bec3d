"""An object that stands, in MuJoCo: rigid bodies, friction, end stops, latches, and a hand that pulls at each part.

The plant reads the model's geometry, but none of its dynamics: what moves, sticks, latches or springs back is physics.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.execution.mujoco.core import LONGEST_STEP, Core, Flags, Latch, ShownJoint, import_mujoco
from micah_plan.execution.mujoco.parameters import PhysicalParameters
from micah_plan.execution.mujoco.standing_object import StandingPart, standing_parts
from micah_plan.execution.mujoco.world import lever_name, slide_name, standing_mjcf
from micah_plan.execution.plant import Command, Measurement, Truth
from micah_plan.task.start import Start, sample_start

Floats = NDArray[np.float64]

_STEPS_PER_RADIAN = 5.0


class StandingPlant:
    """Any automaton whose parts each have one moving joint, as a mechanism in MuJoCo.

    Each part's handle is pulled by a compliant hand (spring, critical damping, limited force) that is told
    displacements relative to where it is. Within a control step its target moves on a straight line and then rests.
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
        mujoco = import_mujoco()
        self.automaton, self.start = automaton, start
        self.parameters = parameters or PhysicalParameters()
        parts = standing_parts(automaton)
        model = mujoco.MjModel.from_xml_string(standing_mjcf(parts, automaton.part(BASE).shapes, self.parameters))
        self._bodies = [model.body(part.name).id for part in parts]
        self._moving = [part for part in parts if part.joint.kind != "rigid"]
        shown = [ShownJoint(part.name, part.coordinate) for part in self._moving]
        screws = [part for part in self._moving if part.joint.kind == "screw"]
        slides = [ShownJoint(slide_name(part.name), part.coordinate, part.joint.pitch) for part in screws]
        self._core = Core(model, self.parameters, len(parts), [*slides, *shown])
        self._hands = Hands(self._core, parts)
        self._latches = [self._latch(part, *latch) for part in self._moving for latch in enumerate(part.latches)]
        self._still: Floats = np.zeros(automaton.n)

    def reset(self, rng: np.random.Generator) -> Measurement:
        """A new trial: a start drawn from the belief, everything at rest, latched if the start mode pins it."""
        mode, x = sample_start(self.automaton, self.start, rng)
        self._still = x.copy()
        for part in self._moving:
            x[part.coordinate] = np.clip(x[part.coordinate], part.lower, part.upper)
        self._core.place(x)
        pinned = {pin.coordinate for pin in self.automaton.mode(mode).pins}
        for coordinate, latch in self._latches:
            closed = coordinate in pinned and abs(x[coordinate] - latch.position) < 1e-9
            latch.armed = closed or not latch.is_near(x[coordinate])
            self._core.data.eq_active[latch.equality] = closed
        self._hands.start()
        self._core.begin(rng)
        return self._measure(0.0, np.zeros((len(self._bodies), 3)))

    def apply(self, command: Command) -> Measurement:
        """One control step: every hand moves by the command's displacement from where its handle truly is."""
        self._hands.move(command.handle)
        return self._measure(self.parameters.control_period, self._hands.force)

    def truth(self) -> Truth:
        """The true configuration, poses and latches."""
        x = self._still.copy()
        latched = self._core.show(x)
        return Truth(None, x, *self._core.poses(self._bodies), latched)

    def close(self) -> None:
        """Free the simulation."""
        self._core.close()

    def _latch(self, part: StandingPart, number: int, position: float) -> tuple[int, Latch]:
        """A latch at a position of a part's joint, and the coordinate that it holds."""
        capture = self.parameters.latch_capture / part.arm
        latch = self._core.add_latch(
            part.name,
            number,
            position,
            position - capture,
            position + capture,
            release=self.parameters.latch_force * part.arm,
            free_down=position - part.lower > capture,
            free_up=part.upper - position > capture,
        )
        return part.coordinate, latch

    def _measure(self, elapsed: float, force: Floats) -> Measurement:
        seen = self._core.seen(*self._core.poses(self._bodies), elapsed)
        return Measurement(float(self._core.data.time), *seen, force)


class Hands:
    """The hands that pull at the handles, one per part: springs, critically damped, of limited force.

    Their targets move on straight lines and then rest. Their law is that of motors in the world, so that the engine can
    take steps on its own (`Core.run`) as long as no hand is too strong and no latch has anything to decide.
    """

    def __init__(self, core: Core, parts: Sequence[StandingPart]) -> None:
        """Args: the world of `standing_mjcf`, whose motors and pace are tuned for its masses, and its parts."""
        self._core = core
        self._limit, self._stiffness = core.parameters.max_force, core.parameters.stiffness
        self._motors = 3 * len(parts)
        self._damping = self._tuned(parts)
        self._targets = np.zeros((1, self._motors))
        # By the joint's address: its first sensor's column, whether it is a hinge, and which hands pull at it.
        self._levers = {
            int(core.model.joint(part.name).qposadr[0]): (
                int(core.model.sensor(lever_name(part.name)).adr[0]),
                part.joint.kind != "prismatic",
                _moved_with(part, parts),
            )
            for part in parts
            if part.can_latch
        }

    @property
    def force(self) -> Floats:
        """(l, 3) of the last step [N]."""
        return np.array(self._core.data.actuator_force).reshape(-1, 3)

    def start(self) -> None:
        """Take hold of the handles where they are, without a force."""
        core = self._core
        core.mujoco.mj_fwdPosition(core.model, core.data)
        self._targets = core.data.actuator_length[None].copy()
        core.data.ctrl[:] = self._stiffness * self._targets[0]

    def move(self, displacement: Floats) -> None:
        """One control step: the targets move to the handles' places displaced by (l, 3) [m].

        Raises:
            InputError: if the physics became unstable.
        """
        core = self._core
        begin, end = self._targets[-1], core.data.actuator_length + displacement.ravel()
        speed = (end - begin) / (core.moving_steps * core.model.opt.timestep)
        self._targets = begin + core.shares[:, None] * (end - begin)
        controls = self._stiffness * self._targets
        controls[: core.moving_steps] += self._damping * speed
        core.run(controls, self)
        core.mujoco.mj_fwdPosition(core.model, core.data)  # places of now; a step leaves those of its beginning

    def needs_care(self, first: int, seen: Floats) -> Flags:
        """Where a hand was too strong, or a latch had something to decide; see `core.Stepper`."""
        targets = self._targets[first : first + len(seen)]
        forces = seen[:, self._motors : 2 * self._motors].reshape(len(seen), -1, 3)
        too_strong = (self._limited(forces) != forces).any(axis=(1, 2))
        return np.asarray(too_strong | self._core.latches_decide(seen, lambda latch: self._pull(latch, targets, seen)))

    def after_leap(self) -> None:
        """No latch was near."""
        for latch in self._core.latches:
            latch.armed = True

    def careful_step(self, number: int) -> bool:
        """Limits forces and switches latches in the middle of a step."""
        core, data, target = self._core, self._core.data, self._targets[number : number + 1]
        core.mujoco.mj_step1(core.model, data)
        passive = self._stiffness * data.actuator_length + self._damping * data.actuator_velocity
        forces, too_strong = (data.ctrl - passive).tolist(), False
        for i in range(0, self._motors, 3):  # in plain floats, which is faster
            size = math.hypot(*forces[i : i + 3])
            if size > self._limit:
                data.ctrl[i : i + 3] += np.multiply(forces[i : i + 3], self._limit / size - 1.0)
                too_strong = True
        decided = core.switch_latches(lambda latch: float(self._pull(latch, target, data.sensordata[None])[0]))
        core.mujoco.mj_step2(core.model, data)
        return too_strong or decided

    def _limited(self, forces: Floats) -> Floats:
        """Forces (..., 3) with those cut that are more than a hand has [N]."""
        size = np.sqrt(np.square(forces).sum(axis=-1, keepdims=True))
        return np.asarray(forces * (self._limit / np.maximum(size, self._limit)))

    def _pull(self, latch: Latch, targets: Floats, seen: Floats) -> Floats:
        """(k,) pull of the hands' springs on a latch's joint [N m or N], for targets (k, 3 l) and sensors (k, ...).

        It has no damping: the damper's kick when a latch snaps shut is no pull that would open it.
        """
        column, turns, hands = self._levers[latch.qpos]
        places = seen[:, : self._motors].reshape(len(seen), -1, 3)[:, hands]
        pulls = self._limited(self._stiffness * (targets.reshape(len(seen), -1, 3)[:, hands] - places))
        if turns:
            pulls = np.cross(places - seen[:, None, column : column + 3], pulls)
        return np.asarray((seen[:, None, column + 3 : column + 6] * pulls).sum(axis=(1, 2)))

    def _tuned(self, parts: Sequence[StandingPart]) -> Floats:
        """(3 l,) the motors' critical damping [N s/m]; sets them and a pace that resolves their springs."""
        core, stiffness = self._core, self._stiffness
        dofs = {part.name: int(core.model.joint(part.name).dofadr[0]) for part in parts if part.joint.kind != "rigid"}
        inertia = [core.model.dof_M0[dofs[part.name]] if part.name in dofs else 0.0 for part in parts]
        masses = np.array(inertia) / np.square([part.arm for part in parts])
        if dofs:
            fastest = float(np.sqrt(stiffness / masses[masses > 0].min()))
            core.set_pace(min(LONGEST_STEP, 1 / (_STEPS_PER_RADIAN * fastest)))
        damping = np.repeat(2 * np.sqrt(stiffness * masses), 3)
        core.model.actuator_biasprm[:, 1], core.model.actuator_biasprm[:, 2] = -stiffness, -damping
        return np.asarray(damping)


def _moved_with(part: StandingPart, parts: Sequence[StandingPart]) -> list[int]:
    """Numbers of the parts that a part's joint moves: its own, and those that are attached to it."""
    names = {part.name}
    names.update(other.name for other in parts if other.parent in names)
    return [number for number, other in enumerate(parts) if other.name in names]
