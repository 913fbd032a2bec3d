"""An object in MuJoCo: rigid bodies, friction, end stops, latches, and a hand that pulls. The only importer of MuJoCo.

The plant reads the model's geometry, but none of its dynamics: what moves, sticks, latches or springs back is physics.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.execution.mjcf import latch_name, mjcf
from micah_plan.execution.physical_object import PhysicalLink, fixed_shapes, physical_links
from micah_plan.execution.physical_parameters import PhysicalParameters
from micah_plan.execution.physics_library import check_stable, import_mujoco
from micah_plan.execution.plant import Command, Measurement, Truth
from micah_plan.execution.tracker import PoseTracker, TrackerNoise
from micah_plan.task.start import Start, sample_start

Floats = NDArray[np.float64]

_LONGEST_STEP = 0.001
_STEPS_PER_RADIAN = 5.0


@dataclass
class _Latch:
    """A latch and its state: it catches when armed and near, opens when pulled hard enough in a free direction."""

    equality: int
    link: int
    configuration: float
    capture: float
    release_moment: float
    free_down: bool
    free_up: bool
    armed: bool = True

    def next_active(self, active: bool, configuration: float, pull: float) -> bool:
        """Whether the latch holds from now on, given the hand's static pull [N m or N] on the joint."""
        if active:
            opens = (self.free_up and pull > self.release_moment) or (self.free_down and pull < -self.release_moment)
            self.armed = not opens
            return not opens
        # Once opened it catches again only after the part has left, or has been pushed back the way it came.
        away = configuration - self.configuration
        self.armed = self.armed or abs(away) > self.capture or away * pull < 0
        return self.armed and abs(away) <= self.capture


class MujocoPlant:
    """Any automaton whose parts each have one moving joint, as a mechanism in MuJoCo.

    Each part's handle is held by a compliant hand (spring, critical damping, limited force) that is told displacements
    relative to where it is. Within a control step its target moves on a straight line and then rests.
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
        self._mj = import_mujoco()
        self.automaton = automaton
        self.start = start
        self.parameters = parameters or PhysicalParameters()
        self._links = physical_links(automaton)
        text = mjcf(self._links, fixed_shapes(automaton), self.parameters)
        self._model = self._mj.MjModel.from_xml_string(text)
        self._data = self._mj.MjData(self._model)
        self._bodies = [self._model.body(link.name).id for link in self._links]
        self._sites = [self._model.site(link.name).id for link in self._links]
        joints = [None if link.joint.kind == "rigid" else self._model.joint(link.name) for link in self._links]
        self._qpos = [None if joint is None else int(joint.qposadr[0]) for joint in joints]
        self._dof = [None if joint is None else int(joint.dofadr[0]) for joint in joints]
        self._hand_damping, self._steps = self._tune_hand()
        self._latches: list[_Latch] = []
        self._target = np.zeros((len(self._links), 3))
        self._force = np.zeros((len(self._links), 3))
        self._pull = np.zeros(self._model.nv)
        self._no_torque = np.zeros(3)
        self._still: Floats = np.zeros(automaton.n)
        self._tracker: PoseTracker | None = None

    def reset(self, rng: np.random.Generator) -> Measurement:
        """A new trial: a start drawn from the belief, everything at rest, latched if the start mode holds it."""
        mode, x = sample_start(self.automaton, self.start, rng)
        pinned = set(np.flatnonzero(~self.automaton.mode(mode).free).tolist())
        self._mj.mj_resetData(self._model, self._data)
        self._still = x.copy()
        for link, address in zip(self._links, self._qpos, strict=True):
            if address is None:
                continue
            x[link.coordinate] = np.clip(x[link.coordinate], link.lower, link.upper)
            self._data.qpos[address] = x[link.coordinate]
            if link.joint.kind == "screw":
                self._data.qpos[address + 1] = link.joint.pitch * x[link.coordinate]
        self._latches = self._new_latches(x, pinned)
        self._mj.mj_forward(self._model, self._data)
        self._target = self._data.site_xpos[self._sites].copy()
        self._force[:] = 0.0
        noise = self.parameters
        tracker = TrackerNoise(
            noise.position_noise, noise.rotation_noise, noise.position_wander, noise.rotation_wander, noise.wander_time
        )
        self._tracker = PoseTracker(tracker, len(self._links), rng)
        return self._measure(0.0)

    def apply(self, command: Command) -> Measurement:
        """One control step: every hand moves by the command's displacement from where its handle truly is."""
        begin = self._target
        end = self._data.site_xpos[self._sites] + command.handle
        moving_steps = max(1, round(self._steps * self.parameters.motion_share))
        velocity = (end - begin) / (moving_steps * self._model.opt.timestep)
        for step in range(1, self._steps + 1):
            moving = step <= moving_steps
            target = begin + (end - begin) * (step / moving_steps) if moving else end
            self._physics_step(target, velocity if moving else np.zeros_like(velocity))
        check_stable(self._mj, self._data)
        self._mj.mj_forward(self._model, self._data)
        self._target = end
        return self._measure(self.parameters.control_period)

    def truth(self) -> Truth:
        """The true configuration, poses and latches."""
        x, held = self._still.copy(), np.zeros(self.automaton.n, dtype=bool)
        for link, address in zip(self._links, self._qpos, strict=True):
            if address is not None:
                x[link.coordinate] = self._data.qpos[address]
        for latch in self._latches:
            held[self._links[latch.link].coordinate] |= bool(self._data.eq_active[latch.equality])
        position, quaternion = self._poses()
        return Truth(None, x, position, quaternion, held)

    def close(self) -> None:
        """Free the simulation."""
        self._model = self._data = None

    def _tune_hand(self) -> tuple[Floats, int]:
        """The hand's critical damping per link [N s/m], and how many physics steps resolve a control step."""
        self._mj.mj_forward(self._model, self._data)
        inertia = [0.0 if dof is None else float(self._model.dof_M0[dof]) for dof in self._dof]
        mass = np.array([m / link.arm**2 for m, link in zip(inertia, self._links, strict=True)])
        damping = 2 * np.sqrt(self.parameters.stiffness * mass)
        moving = mass[mass > 0]
        fastest = float(np.sqrt(self.parameters.stiffness / moving.min())) if moving.size else 0.0
        longest = min(_LONGEST_STEP, 1 / (_STEPS_PER_RADIAN * fastest)) if fastest else _LONGEST_STEP
        steps = int(np.ceil(self.parameters.control_period / longest))
        self._model.opt.timestep = self.parameters.control_period / steps
        return damping, steps

    def _new_latches(self, x: Floats, pinned: set[int]) -> list[_Latch]:
        latches = []
        for number, link in enumerate(self._links):
            for index, configuration in enumerate(link.latches if self._dof[number] is not None else ()):
                latch = self._latch(number, link, index, configuration)
                away = abs(x[link.coordinate] - configuration)
                closed = link.coordinate in pinned and away < 1e-9
                latch.armed = closed or away > latch.capture
                self._data.eq_active[latch.equality] = closed
                latches.append(latch)
        return latches

    def _latch(self, number: int, link: PhysicalLink, index: int, configuration: float) -> _Latch:
        capture = self.parameters.latch_capture / link.arm
        return _Latch(
            equality=self._model.equality(latch_name(link.name, index)).id,
            link=number,
            configuration=configuration,
            capture=capture,
            release_moment=self.parameters.latch_force * link.arm,
            free_down=configuration - link.lower > capture,
            free_up=link.upper - configuration > capture,
        )

    def _physics_step(self, target: Floats, velocity: Floats) -> None:
        """One time step with the hands pulling towards their targets (l, 3) [m] that move at velocity (l, 3) [m/s]."""
        mj, model, data = self._mj, self._model, self._data
        mj.mj_step1(model, data)
        data.qfrc_applied[:] = 0.0
        self._pull[:] = 0.0
        twist = np.zeros(6)
        for number, (body, site) in enumerate(zip(self._bodies, self._sites, strict=True)):
            mj.mj_objectVelocity(model, data, mj.mjtObj.mjOBJ_SITE, site, twist, 0)
            handle = data.site_xpos[site]
            spring = self.parameters.stiffness * (target[number] - handle)
            damper = self._hand_damping[number] * (velocity[number] - twist[3:])
            force = self._saturated(spring + damper)
            mj.mj_applyFT(model, data, force, self._no_torque, handle, body, data.qfrc_applied)
            # The damper's kick when a latch snaps shut is no pull that would open it.
            mj.mj_applyFT(model, data, self._saturated(spring), self._no_torque, handle, body, self._pull)
            self._force[number] = force
        for latch in self._latches:
            configuration = float(data.qpos[self._qpos[latch.link]])
            pull = float(self._pull[self._dof[latch.link]])
            active = bool(data.eq_active[latch.equality])
            data.eq_active[latch.equality] = latch.next_active(active, configuration, pull)
        mj.mj_step2(model, data)

    def _saturated(self, force: Floats) -> Floats:
        return force * min(1.0, self.parameters.max_force / max(float(np.linalg.norm(force)), 1e-12))

    def _poses(self) -> tuple[Floats, Floats]:
        position = self._data.xpos[self._bodies].copy()
        quaternion = self._data.xquat[self._bodies][:, [1, 2, 3, 0]]
        return position, np.where(quaternion[:, 3:] < 0, -quaternion, quaternion)

    def _measure(self, elapsed: float) -> Measurement:
        if self._tracker is None:  # reset creates it before measuring
            raise RuntimeError("measure before reset")
        position, quaternion = self._tracker.measure(*self._poses(), elapsed)
        return Measurement(float(self._data.time), position, quaternion, self._force.copy())
