"""Core of both MuJoCo plants: stepping a world, latches, and a tracker of the parts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import ModuleType
from typing import Any

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.errors import InputError
from micah_plan.execution.mujoco.parameters import PhysicalParameters
from micah_plan.execution.mujoco.world import Flags, LatchState, WorldJoint, latch_name, sensor_name
from micah_plan.execution.tracker import PoseTracker, TrackerNoise
from micah_plan.mujoco_library import import_mujoco
from micah_plan.quantities import quantity

LONGEST_STEP = 0.001
# After `_CALM` steps without an event the engine leaps again: by `_SHORTEST_LEAP` steps, then by twice as many.
_CALM, _SHORTEST_LEAP = 20, 32
_SCALAR_LAST = [1, 2, 3, 0]


def check_stable(mujoco: ModuleType | Any, data: Any) -> None:
    """Raise an error after a diverged step, at which MuJoCo resets its state.

    Raises:
        InputError: if positions, velocities or accelerations became huge.
    """
    kinds = mujoco.mjtWarning
    if any(data.warning[int(k)].number for k in (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC)):
        raise InputError(
            f"the physics became unstable {quantity(data.time, 's')} after its start",
            remedy="make the plant softer, heavier or better damped, or the model's parts larger",
        )


class PhysicalPlant:
    """A stepped world with latches and a tracker: the base of plants in MuJoCo.

    Most of the time there is no event that the engine does not handle, and it can take many steps alone: it leaps. The
    sensors of every step are checked afterwards, so nothing is missed. After an event it goes back, leaps up to there
    only, and takes single steps until there has been no event for a while. In both cases the engine takes the same
    steps: leaps change only the computing time.

    Attributes:
        automaton, parameters: the model, and the physics.
        mujoco, model, data: the library, and its model and state of this world.
        latches: of this world.
        shares: (steps,) share of the displacement that the hand's target has completed after each physics step of a
            control step.
    """

    def __init__(
        self,
        automaton: HybridAutomaton,
        parameters: PhysicalParameters,
        model: Any,
        joints: Sequence[WorldJoint] = (),
        prefix: str = "",
    ) -> None:
        """Args: model: the compiled world; joints: that show coordinates; prefix: of their names in the world."""
        self.automaton, self.parameters = automaton, parameters
        self.mujoco = import_mujoco()
        self.model, self.data = model, self.mujoco.MjData(model)
        self._shown = [(joint, int(model.joint(prefix + joint.name).qposadr[0])) for joint in joints]
        self.latches: list[LatchState] = []
        for joint, address in self._shown:
            for number, latch in enumerate(joint.latches):
                latch.equality = int(model.equality(prefix + latch_name(joint.name, number)).id)
                latch.sensor = int(model.sensor(prefix + sensor_name(joint.name)).adr[0])
                latch.joint, latch.coordinate = address, joint.coordinate
                self.latches.append(latch)
        self._tracker: PoseTracker | None = None
        self._positions, self._active = self.data.qpos, self.data.eq_active
        self._set_pace(LONGEST_STEP)

    def close(self) -> None:
        """Free the simulation."""
        self.model = self.data = None

    def _set_pace(self, longest_step: float) -> None:
        """Divide the control step into equal physics steps of at most `longest_step` [s]."""
        period = self.parameters.control_period
        steps = math.ceil(period / longest_step)
        self._moving_steps = max(1, round(steps * self.parameters.motion_share))
        self.shares = np.minimum(np.arange(1, steps + 1) / self._moving_steps, 1.0)
        self.model.opt.timestep = period / steps

    def _place(self, x: Floats) -> None:
        """Set the joints to a configuration (n,), at rest, with all latches open and armed."""
        self.mujoco.mj_resetData(self.model, self.data)
        for joint, address in self._shown:
            self.data.qpos[address] = joint.scale * x[joint.coordinate] + joint.zero
        for latch in self.latches:
            latch.armed = True

    def _begin(self, rng: np.random.Generator) -> None:
        """Start a trial from the state of `data`, with a new tracker."""
        self.mujoco.mj_forward(self.model, self.data)
        parameters = self.parameters
        noise = TrackerNoise(
            parameters.position_noise,
            parameters.rotation_noise,
            parameters.position_wander,
            parameters.rotation_wander,
            parameters.wander_time,
        )
        self._tracker = PoseTracker(noise, len(self.automaton.links), rng)
        self._calm, self._reach = _CALM, _SHORTEST_LEAP

    def _show(self, x: Floats) -> Flags:
        """Write the shown joints into a configuration (n,); returns (n,) whether a latch holds each coordinate."""
        latched = np.zeros(len(x), dtype=bool)
        for joint, address in self._shown:
            if joint.is_shown:
                x[joint.coordinate] = (self.data.qpos[address] - joint.zero) / joint.scale
        latched[[latch.coordinate for latch in self.latches if self._active[latch.equality]]] = True
        return latched

    def _poses(self, bodies: Sequence[int]) -> tuple[Floats, Floats]:
        """(k, 3) positions [m] and (k, 4) quaternions of bodies, scalar last and not negative."""
        quaternion = self.data.xquat[bodies][:, _SCALAR_LAST]
        return self.data.xpos[bodies].copy(), np.where(quaternion[:, 3:] < 0, -quaternion, quaternion)

    def _tracked(self, position: Floats, quaternion: Floats, elapsed: float) -> tuple[Floats, Floats]:
        """The tracker's measurement of true poses, (l, 3) [m] and (l, 4), `elapsed` [s] after its last one."""
        if self._tracker is None:  # `_begin` makes it before anything is measured
            raise RuntimeError("measure before reset")
        return self._tracker.measure(position, quaternion, elapsed)

    def _run(self, controls: Floats) -> None:
        """One control step under controls (steps, nu), one row per physics step.

        Raises:
            InputError: if the physics became unstable.
        """
        done = 0
        while done < len(controls):
            if self._calm >= _CALM:
                done = self._step_to_event(controls, done)
            else:
                self.data.ctrl[:] = controls[done]
                self._calm = 0 if self._step_with_events(done) else self._calm + 1
                done += 1
        check_stable(self.mujoco, self.data)

    def _step_to_event(self, controls: Floats, begin: int) -> int:
        """Step from number `begin` to the first event; returns its number."""
        mujoco, model, data = self.mujoco, self.model, self.data
        everything = int(mujoco.mjtState.mjSTATE_INTEGRATION)
        before = np.empty(mujoco.mj_stateSize(model, everything))
        mujoco.mj_getState(model, data, before, everything)
        steps = self._free_steps(controls[begin : begin + self._reach])
        happened = self._suspects(steps)
        for latch in self.latches:
            if self._active[latch.equality]:
                happened |= latch.opens(self._pull(latch, begin, steps))
            else:
                happened |= latch.is_near(steps[:, latch.sensor])
        length = int(np.argmax(np.append(happened, True)))
        self._reach = max(2 * length, _SHORTEST_LEAP)
        if length < len(happened):
            self._calm = 0
            mujoco.mj_setState(model, data, before, everything)
            if length:
                self._free_steps(controls[begin : begin + length])
        if length:
            for latch in self.latches:
                latch.armed = True
        return begin + length

    def _free_steps(self, controls: Floats) -> Floats:
        """Step under controls (k, nu), with all else constant; it may end early, after at least one step.

        Returns:
            (taken, sensors) of each step: places at its start, forces and contacts in it.

        Raises:
            InputError: if the physics became unstable.
        """
        mujoco, model, data, steps = self.mujoco, self.model, self.data, len(controls)
        begin = data.time
        check_stable(mujoco, data)  # what was counted so far is forgotten now
        kinds = mujoco.mjtState
        physics, forces = int(kinds.mjSTATE_FULLPHYSICS), int(kinds.mjSTATE_XFRC_APPLIED)
        state, measured = np.empty((1, mujoco.mj_stateSize(model, physics))), np.empty((1, steps, model.nsensordata))
        mujoco.mj_getState(model, data, state[0], physics)
        rest = np.concatenate([data.xfrc_applied.ravel(), data.eq_active])
        mujoco.rollout.rollout(
            [model],
            [data],
            state,
            np.hstack([controls, np.tile(rest, (steps, 1))])[None],
            control_spec=int(kinds.mjSTATE_CTRL) | forces | int(kinds.mjSTATE_EQ_ACTIVE),
            skip_checks=True,
            nstep=steps,
            initial_warmstart=data.qacc_warmstart[None].copy(),
            sensordata=measured,
        )
        check_stable(mujoco, data)
        taken = round((data.time - begin) / model.opt.timestep)  # not all if there was another warning
        return np.asarray(measured[0, :taken])

    def _step_with_events(self, number: int) -> bool:
        """Take step `number` of this control step with all events handled; returns whether there was one."""
        happened = self._follow()
        self.mujoco.mj_step1(self.model, self.data)
        happened |= self._limit_hands()
        for latch in self.latches:
            if self._active.item(latch.equality):
                if latch.release < math.inf and latch.opens(self._pull(latch, number, self.data.sensordata[None])[0]):
                    self._active[latch.equality] = latch.armed = False
                    happened = True
            elif latch.is_near(position := self._positions.item(latch.joint)):
                pull = self._pull(latch, number, self.data.sensordata[None])[0]
                self._active[latch.equality] = latch.catches(position, pull)
                happened = True
            else:
                latch.armed = True
        self.mujoco.mj_step2(self.model, self.data)
        return self._check_state() or happened

    def _suspects(self, measured: Floats) -> Flags:
        """(k,) whether sensors (k, sensors) of steps indicate an event that the engine does not handle."""
        return np.zeros(len(measured), dtype=bool)

    def _pull(self, _latch: LatchState, _begin: int, measured: Floats) -> Floats:
        """(k,) static pull of the hand on a latch's joint in the steps from `begin` [N m or N]."""
        return np.zeros(len(measured))

    def _follow(self) -> bool:
        """Update the world before a careful step; returns whether anything changed."""
        return False

    def _limit_hands(self) -> bool:
        """Limit the controls within a careful step; returns whether anything changed."""
        return False

    def _check_state(self) -> bool:
        """Check the state after a careful step; returns whether there was an event."""
        return False


class Carrier:
    """Moves the hand by position-controlled joints: three slides here, those of an arm in `ArmCarrier`.

    Attributes:
        complaint: why it could not follow commands since it was placed; empty if it could.
    """

    def __init__(self, plant: PhysicalPlant, joints: Sequence[str]) -> None:
        """Args: names of joints in the world, which equal those of their motors."""
        self._plant, self.complaint = plant, ""
        self._address = [int(plant.model.joint(name).qposadr[0]) for name in joints]
        self._motors = [int(plant.model.actuator(name).id) for name in joints]

    @property
    def joints(self) -> Floats | None:
        """(J,) encoder readings of an arm [rad or m]; None without one."""
        return None

    def put(self, place: Floats) -> None:
        """Place the hand at rest at a position (3,) [m]."""
        self.complaint = ""
        data, joints = self._plant.data, self._reached(place, None, None)
        data.qpos[self._address] = joints
        data.ctrl[self._motors] = joints

    def put_like(self, carrier: Carrier) -> None:
        """Copy the state of the same carrier in another world, including its pressing force."""
        self.complaint = carrier.complaint
        self._plant.data.qpos[self._address] = carrier._plant.data.qpos[carrier._address]
        self._plant.data.ctrl[self._motors] = carrier._plant.data.ctrl[carrier._motors]

    def orders(self, displacement: Floats, posture: Floats | None) -> Floats:
        """(steps, nu) controls for a displacement (3,) [m] of the hand; an arm stays near a posture (J,) [rad or m]."""
        plant, begin = self._plant, self._plant.data.qpos[self._address]
        end = self._reached(self._place(begin) + displacement, begin, posture)
        orders = np.tile(plant.data.ctrl, (len(plant.shares), 1))
        orders[:, self._motors] = begin + plant.shares[:, None] * (end - begin)
        return orders

    def resting(self, order: Floats) -> Floats:
        """(nu,) controls that hold the hand in place, given the present ones (nu,)."""
        kept = order.copy()
        kept[self._motors] = self._plant.data.qpos[self._address]
        return kept

    def _place(self, joints: Floats) -> Floats:
        """(3,) position of the hand at joints (J,)."""
        return joints

    def _reached(self, place: Floats, _near: Floats | None, _posture: Floats | None, /) -> Floats:
        """(J,) joints that place the hand: close to given ones, with the null space used for a posture."""
        return place
