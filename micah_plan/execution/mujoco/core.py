"""What both plants do alike: a world in MuJoCo that is stepped, latches that catch and open, and a tracker."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from micah_plan.execution.mujoco.library import check_stable
from micah_plan.execution.mujoco.parameters import PhysicalParameters
from micah_plan.execution.tracker import PoseTracker, TrackerNoise

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

LONGEST_STEP = 0.001
# So many steps in which nothing happened, and the engine leaps again: by so many steps first, then by twice as many.
_CALM, _SHORTEST_LEAP = 20, 32
_SCALAR_LAST = [1, 2, 3, 0]


@dataclass
class Latch:
    """A latch and its state: it catches when armed and near, and opens when pulled hard enough in a free direction.

    Attributes:
        equality: id of the constraint that locks the joint.
        qpos: address of the joint's position.
        position: where it latches; low, high: between which positions it catches [rad or m].
        release: pull on the joint that opens it [N m or N]; infinite: none does.
        free_down, free_up: whether the joint can move away downwards and upwards.
        armed: whether it would catch now.
    """

    equality: int
    qpos: int
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
        latches: of this trial.
    """

    def __init__(self, mujoco: ModuleType | Any, model: Any, parameters: PhysicalParameters, links: int) -> None:
        """Args: the compiled world; how many links the tracker sees."""
        self.mujoco, self.model, self.data = mujoco, model, mujoco.MjData(model)
        self.parameters = parameters
        self.latches: list[Latch] = []
        self._links = links
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

    def begin(self, rng: np.random.Generator) -> None:
        """A trial starts from the state that `data` has been given, with a new tracker."""
        self.mujoco.mj_forward(self.model, self.data)
        own = self.parameters
        noise = TrackerNoise(
            own.position_noise, own.rotation_noise, own.position_wander, own.rotation_wander, own.wander_time
        )
        self._tracker = PoseTracker(noise, self._links, rng)
        self._calm, self._reach = _CALM, _SHORTEST_LEAP

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
