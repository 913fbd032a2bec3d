"""What both plants do alike: a world in MuJoCo that is stepped, latches that catch and open, and a tracker.

MuJoCo is imported here alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from micah_plan.errors import InputError, MissingDependencyError
from micah_plan.execution.mujoco.parameters import PhysicalParameters
from micah_plan.execution.tracker import PoseTracker, TrackerNoise

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

LONGEST_STEP = 0.001
# So many steps in which nothing happened, and the engine leaps again: by so many steps first, then by twice as many.
_CALM, _SHORTEST_LEAP = 20, 32
_SCALAR_LAST = [1, 2, 3, 0]


def import_mujoco() -> ModuleType | Any:
    """The library. It is kept from writing its warnings to a file in the current folder: `check_stable` reads them.

    Raises:
        MissingDependencyError: if it is not installed.
    """
    try:
        import mujoco
        import mujoco.rollout
    except ImportError as error:
        raise MissingDependencyError(
            "the MuJoCo plant needs the package 'mujoco'; install it with: pip install 'micah-plan[sim]'"
        ) from error
    mujoco.set_mju_user_warning(lambda _: None)  # an exception from here would end the process
    return mujoco


def check_stable(mujoco: ModuleType | Any, data: Any) -> None:
    """Refuse to go on after a step that diverged: MuJoCo begins again from its initial state then.

    Raises:
        InputError: if positions, velocities or accelerations became huge.
    """
    kinds = mujoco.mjtWarning
    if any(data.warning[int(k)].number for k in (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC)):
        raise InputError(
            f"the physics became unstable {float(data.time):.3g} s after its start",
            remedy="make the plant softer, heavier or better damped, or the model's parts larger",
        )


def latch_name(joint: str, number: int) -> str:
    """Name of a joint's latch in the world's text."""
    return f"{joint}/latch/{number}"


def sensor_name(joint: str) -> str:
    """Name of the sensor of a joint's position in the world's text."""
    return f"{joint}/position"


@dataclass(frozen=True)
class ShownJoint:
    """A joint in MuJoCo that a coordinate of the model shows: position = scale * x[coordinate] + zero."""

    name: str
    coordinate: int
    scale: float = 1.0
    zero: float = 0.0


@dataclass
class Latch:
    """A latch and its state: it catches when armed and near, and opens when pulled hard enough in a free direction.

    Attributes:
        equality: id of the constraint that locks the joint.
        qpos: address of the joint's position.
        sensor: column of the joint's position among what the sensors show.
        position: where it latches; low, high: between which positions it catches [rad or m].
        release: pull on the joint that opens it [N m or N]; infinite: none does.
        free_down, free_up: whether the joint can move away downwards and upwards.
        armed: whether it would catch now.
    """

    equality: int
    qpos: int
    sensor: int
    position: float
    low: float
    high: float
    release: float = math.inf
    free_down: bool = False
    free_up: bool = False
    armed: bool = True

    def is_near(self, position: Floats | float) -> Flags | bool:
        """Whether it would catch the joint at a position [rad or m], (k,) or one, if it is armed."""
        return (self.low <= position) & (position <= self.high)

    def opens(self, pull: Floats | float) -> Flags | bool:
        """Whether a locked joint comes free under the hand's static pull on it [N m or N], (k,) or one."""
        return (self.free_up & (pull > self.release)) | (self.free_down & (pull < -self.release))

    def catches(self, position: float, pull: float) -> bool:
        """Whether a joint near the latch is locked from now on."""
        # Once opened it catches again only after the part has left, or has been pushed back the way it came.
        self.armed = self.armed or (position - self.position) * pull < 0
        return self.armed


class Stepper(Protocol):
    """What a plant does, and looks for, in the steps of one control step."""

    def needs_care(self, first: int, seen: Floats) -> Flags:
        """(k,) in which of the steps that the engine took alone something happened that it does not know of.

        Args:
            first: number of the first of them in this control step.
            seen: (k, sensors) what MuJoCo's sensors showed: places as a step began, forces and contacts in it.
        """
        ...

    def after_leap(self) -> None:
        """Called after steps in which nothing happened."""
        ...

    def careful_step(self, number: int) -> bool:
        """Take step `number` of this control step whatever happens in it; whether anything did."""
        ...


class Core:
    """A world that is stepped, the latches in it, and the tracker that sees it.

    Most of the time nothing happens that the engine does not know of, and it can take many steps alone: it leaps. What
    its sensors showed in every one of them is looked at afterwards, so nothing is missed. Where something happened it
    goes back, leaps up to there only, and takes careful steps until nothing has happened for a while. Alone or with
    care, the engine takes the same steps: how far it leaps changes nothing but the time that it takes.

    Attributes:
        mujoco, model, data: the library, and its model and state of this world.
        steps: physics steps per control step.
        shares: (steps,) share of its way that the hand's target has gone at the end of each of them, 0 to 1.
        moving_steps: after how many it is there.
        latches: of this world.
    """

    def __init__(
        self, model: Any, parameters: PhysicalParameters, links: int, shown: Sequence[ShownJoint] = ()
    ) -> None:
        """Args: the compiled world; how many links the tracker sees; the joints that coordinates show, where several
        show the same one, the last decides on it."""
        self.mujoco = import_mujoco()
        self.model, self.data = model, self.mujoco.MjData(model)
        self.parameters = parameters
        self.latches: list[Latch] = []
        self._links = links
        self._shown = [(joint, int(model.joint(joint.name).qposadr[0])) for joint in shown]
        self._tracker: PoseTracker | None = None
        self._positions, self._active = self.data.qpos, self.data.eq_active
        self._calm, self._reach = _CALM, _SHORTEST_LEAP
        self.set_pace(LONGEST_STEP)

    def set_pace(self, longest_step: float) -> None:
        """Divide the control step into equal physics steps of at most this length [s]."""
        period = self.parameters.control_period
        self.steps = math.ceil(period / longest_step)
        self.moving_steps = max(1, round(self.steps * self.parameters.motion_share))
        self.shares = np.minimum(np.arange(1, self.steps + 1) / self.moving_steps, 1.0)
        self.model.opt.timestep = period / self.steps

    def add_latch(self, joint: str, number: int, position: float, low: float, high: float, **opening: Any) -> Latch:
        """A latch of a joint, of this number in the world's text; the rest as of `Latch`."""
        names = self.model.equality(latch_name(joint, number)).id, self.model.joint(joint).qposadr[0]
        column = self.model.sensor(sensor_name(joint)).adr[0]
        latch = Latch(int(names[0]), int(names[1]), int(column), position, low, high, **opening)
        self.latches.append(latch)
        return latch

    def place(self, x: Floats) -> None:
        """Set the joints to a configuration (n,), at rest, with all latches open and armed."""
        self.mujoco.mj_resetData(self.model, self.data)
        for joint, address in self._shown:
            self.data.qpos[address] = joint.scale * x[joint.coordinate] + joint.zero
        for latch in self.latches:
            latch.armed = True

    def begin(self, rng: np.random.Generator) -> None:
        """A trial starts from the state that `data` has been given, with a new tracker."""
        self.mujoco.mj_forward(self.model, self.data)
        own = self.parameters
        noise = TrackerNoise(
            own.position_noise, own.rotation_noise, own.position_wander, own.rotation_wander, own.wander_time
        )
        self._tracker = PoseTracker(noise, self._links, rng)
        self._calm, self._reach = _CALM, _SHORTEST_LEAP

    def show(self, x: Floats) -> Flags:
        """Set what joints show in a configuration (n,); (n,) whether a latch holds a coordinate."""
        held, locked = np.zeros(len(x), dtype=bool), {latch.qpos for latch in self.latches if self.is_locked(latch)}
        for joint, address in self._shown:
            x[joint.coordinate] = (self.data.qpos[address] - joint.zero) / joint.scale
            held[joint.coordinate] = address in locked
        return held

    def run(self, controls: Floats, stepper: Stepper) -> None:
        """One control step, under one row of controls (steps, nu) in each step.

        Raises:
            InputError: if the physics became unstable.
        """
        done = 0
        while done < len(controls):
            if self._calm >= _CALM:
                done = self._leap(controls, done, stepper)
            else:
                self.data.ctrl[:] = controls[done]
                self._calm = 0 if stepper.careful_step(done) else self._calm + 1
                done += 1
        check_stable(self.mujoco, self.data)

    def _leap(self, controls: Floats, begin: int, stepper: Stepper) -> int:
        """Take steps from number `begin` on, up to the first in which something happens; the number of that one."""
        mujoco, model, data = self.mujoco, self.model, self.data
        everything = int(mujoco.mjtState.mjSTATE_INTEGRATION)
        before = np.empty(mujoco.mj_stateSize(model, everything))
        mujoco.mj_getState(model, data, before, everything)
        happened = stepper.needs_care(begin, self.free_steps(controls[begin : begin + self._reach]))
        length = int(np.argmax(np.append(happened, True)))
        self._reach = max(2 * length, _SHORTEST_LEAP)
        if length < len(happened):
            self._calm = 0
            mujoco.mj_setState(model, data, before, everything)
            if length:
                self.free_steps(controls[begin : begin + length])
        if length:
            stepper.after_leap()
        return begin + length

    def free_steps(self, controls: Floats) -> Floats:
        """Take steps under controls (k, nu), all else staying as it is; it may end early, but takes one at least.

        Returns:
            (taken, sensors) what the sensors showed in each of them.

        Raises:
            InputError: if the physics became unstable.
        """
        mujoco, model, data, steps = self.mujoco, self.model, self.data, len(controls)
        begin = data.time
        check_stable(mujoco, data)  # what was counted so far is forgotten now
        kinds = mujoco.mjtState
        physics, forces = int(kinds.mjSTATE_FULLPHYSICS), int(kinds.mjSTATE_XFRC_APPLIED)
        state, seen = np.empty((1, mujoco.mj_stateSize(model, physics))), np.empty((1, steps, model.nsensordata))
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
            sensordata=seen,
        )
        check_stable(mujoco, data)
        taken = round((data.time - begin) / model.opt.timestep)  # not all if there was another warning
        return np.asarray(seen[0, :taken])

    def latches_decide(self, seen: Floats, pull: Callable[[Latch], Floats]) -> Flags:
        """(k,) in which steps a latch opened, or had to decide whether to catch.

        Args:
            seen: (k, sensors) what the sensors showed.
            pull: gives the hand's static pull on a latch's joint in each step, (k,) [N m or N].
        """
        decided = np.zeros(len(seen), dtype=bool)
        for latch in self.latches:
            decided |= latch.opens(pull(latch)) if self.is_locked(latch) else latch.is_near(seen[:, latch.sensor])
        return decided

    def switch_latches(self, pull: Callable[[Latch], float]) -> bool:
        """Let every latch catch or open, from the next step on.

        Args:
            pull: gives the hand's static pull on a latch's joint [N m or N]; asked only where it matters.

        Returns:
            Whether any latch opened, or had to decide whether to catch.
        """
        decided = False
        for latch in self.latches:
            if self._active.item(latch.equality):
                if latch.release < math.inf and latch.opens(pull(latch)):
                    self._active[latch.equality] = latch.armed = False
                    decided = True
            elif latch.is_near(position := self._positions.item(latch.qpos)):
                self._active[latch.equality] = latch.catches(position, pull(latch))
                decided = True
            else:
                latch.armed = True
        return decided

    def is_locked(self, latch: Latch) -> bool:
        """Whether a latch holds its joint now."""
        return bool(self._active[latch.equality])

    def poses(self, bodies: Sequence[int]) -> tuple[Floats, Floats]:
        """(k, 3) positions [m] and (k, 4) quaternions of bodies, scalar last and not negative."""
        quaternion = self.data.xquat[bodies][:, _SCALAR_LAST]
        return self.data.xpos[bodies].copy(), np.where(quaternion[:, 3:] < 0, -quaternion, quaternion)

    def seen(self, position: Floats, quaternion: Floats, elapsed: float) -> tuple[Floats, Floats]:
        """What the tracker makes of true poses, (l, 3) [m] and (l, 4), so long after it last looked [s]."""
        if self._tracker is None:  # `begin` makes it before anything is measured
            raise RuntimeError("measure before reset")
        return self._tracker.measure(position, quaternion, elapsed)

    def close(self) -> None:
        """Free the world."""
        self.model = self.data = None


class Carrier:
    """Moves the hand by motors that bring joints to positions: three slides here, in `ArmCarrier` those of an arm.

    Attributes:
        complaint: why it could not go where it was told to since it was put; empty if it could.
    """

    def __init__(self, core: Core, joints: Sequence[str]) -> None:
        """Args: names of joints in the world, which are those of their motors too."""
        self._core, self.complaint = core, ""
        self._address = [int(core.model.joint(name).qposadr[0]) for name in joints]
        self._motors = [int(core.model.actuator(name).id) for name in joints]

    @property
    def joints(self) -> Floats | None:
        """(J,) what the encoders of an arm say now [rad or m]; None without one."""
        return None

    def put(self, place: Floats) -> None:
        """Stand at rest with the hand at a place (3,) [m]."""
        self.complaint = ""
        data, joints = self._core.data, self._reached(place, None, None)
        data.qpos[self._address] = joints
        data.ctrl[self._motors] = joints

    def orders(self, displacement: Floats, posture: Floats | None) -> Floats:
        """(steps, nu) controls that move the hand by a displacement (3,) [m] from where it is; an arm near a posture
        (J,) [rad or m]."""
        core, begin = self._core, self._core.data.qpos[self._address]
        end = self._reached(self._place(begin) + displacement, begin, posture)
        orders = np.tile(core.data.ctrl, (core.steps, 1))
        orders[:, self._motors] = begin + core.shares[:, None] * (end - begin)
        return orders

    def _place(self, joints: Floats) -> Floats:
        """(3,) where the hand is at some joints (J,)."""
        return joints

    def _reached(self, place: Floats, _near: Floats | None, _posture: Floats | None, /) -> Floats:
        """(J,) joints with the hand at a place: those near some others, with what freedom is left to a posture."""
        return place
