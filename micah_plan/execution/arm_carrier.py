"""An arm that carries the hand of a held object in MuJoCo, its joints under position control."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from micah_plan.execution.arm_model import PREFIX
from micah_plan.robot.arm import Arm
from micah_plan.robot.inverse_kinematics import Reached, next_pose
from micah_plan.scene.robot_description import Grasp

Floats = NDArray[np.float64]

# The tool counts as held back if it would end further than this from where it is told to be [m or rad].
_HELD_BACK = 0.002


class ArmCarrier:
    """An arm whose joints are driven to where continuous inverse kinematics puts the hand; it keeps its orientation."""

    def __init__(self, mujoco: Any, model: Any, data: Any, arm: Arm, grasp: Grasp, posture: Floats) -> None:
        """Args: posture: (n,) from which the start is sought."""
        self._mj, self._model, self._data, self._arm = mujoco, model, data, arm
        self._grasp, self._from_tool, self._posture = grasp.pose, grasp.pose.inv(), posture
        joints = [model.joint(PREFIX + name) for name in arm.joints]
        self._address = [int(joint.qposadr[0]) for joint in joints]
        self._dof = [int(joint.dofadr[0]) for joint in joints]
        self._motors = [model.actuator(PREFIX + name).id for name in arm.joints]
        self._locked = {int(model.joint(PREFIX + name).qposadr[0]): value for name, value in arm.locked}
        self._begin, self._end = posture, posture
        self.complaint = ""

    @property
    def joints(self) -> Floats:
        return np.array(self._data.qpos[self._address])

    def put(self, place: Floats) -> None:
        self.complaint = ""
        self._solve(place, self._posture, None)
        for address, value in self._locked.items():
            self._data.qpos[address] = value
        self._data.qpos[self._address] = self._end
        self._data.ctrl[self._motors] = self._end
        self._damp()

    def aim(self, displacement: Floats, posture: Floats | None, /) -> None:
        self._begin = self.joints
        tool = RigidTransform.from_matrix(self._arm.matrix(self._begin))
        self._solve((tool * self._from_tool).translation + displacement, self._begin, posture)

    def move(self, share: float) -> None:
        self._data.ctrl[self._motors] = self._begin + share * (self._end - self._begin)

    def _solve(self, place: Floats, q: Floats, posture: Floats | None) -> None:
        target = (RigidTransform.from_translation(place) * self._grasp).as_matrix()
        limits = self._arm.lower, self._arm.upper
        q = np.clip(q, *limits)
        wish = np.zeros(self._arm.n) if posture is None else posture - q
        reached = next_pose(self._arm, target, q, wish, limits)
        self._end = reached.q
        if np.abs(reached.error).max() > _HELD_BACK and not self.complaint:
            self.complaint = self._why(reached)

    def _why(self, reached: Reached) -> str:
        stopped = [name for name, at in zip(self._arm.joints, reached.stopped, strict=True) if at]
        limit = f": joint limit of {', '.join(stopped)}" if stopped else ""
        away = 1e3 * float(np.linalg.norm(reached.error[3:]))
        return f"the arm's tool could not come nearer than {away:.0f} mm to where it was told to be{limit}"

    def _damp(self) -> None:
        """Critical damping of every joint for the inertia that it has in this posture."""
        self._mj.mj_forward(self._model, self._data)
        for motor, dof in zip(self._motors, self._dof, strict=True):
            inertia = np.zeros(self._model.nv)
            self._mj.mj_mulM(self._model, self._data, inertia, np.eye(self._model.nv)[dof])
            stiffness = self._model.actuator_gainprm[motor, 0]
            self._model.actuator_biasprm[motor, 2] = -2 * np.sqrt(stiffness * inertia[dof])
