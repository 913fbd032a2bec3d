"""The arm: the chain of joints from a robot's root to its tool, as a Pinocchio model in the base frame.

Source for kinematics and Jacobians: Featherstone, "Rigid Body Dynamics Algorithms", ch. 4; for manipulability:
Yoshikawa, "Manipulability of robotic mechanisms", IJRR 1985.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from micah_plan.arrays import Floats
from micah_plan.errors import InputError


def middle(lower: Floats, upper: Floats) -> Floats:
    """(n,) middle of each range [lower, upper]; for unbounded ranges the point nearest to 0."""
    posture, bounded = np.clip(np.zeros(len(lower)), lower, upper), np.isfinite(lower) & np.isfinite(upper)
    posture[bounded] = (lower[bounded] + upper[bounded]) / 2
    return posture


@dataclass(frozen=True, eq=False)
class Arm:
    """A chain of n joints of one degree of freedom each; a configuration q is (n,) [rad or m].

    Attributes:
        name: of the robot's file, for messages.
        model: Pinocchio model with these joints only, its root placed in the base frame.
        geometry: Pinocchio collision geometry of all links, also those that do not move.
        tool: number of the tool's frame in the model.
        rest: (n,) posture to prefer.
        colors: ``"#rrggbb"`` by name of geometry.
        separate: pairs of links, sorted by name, that a file declares to need no check.
        locked: (joint, position [rad or m]) of the robot's joints that do not move.
    """

    name: str
    model: Any
    geometry: Any
    tool: int
    rest: Floats
    colors: dict[str, str]
    separate: frozenset[tuple[str, str]]
    locked: tuple[tuple[str, float], ...]
    data: Any

    @property
    def n(self) -> int:
        return int(self.model.nv)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, from the root to the tool."""
        return tuple(str(name) for name in list(self.model.names)[1:])

    @property
    def lower(self) -> Floats:
        """(n,) lower limits [rad or m]; -inf without one."""
        return np.array(self.model.lowerPositionLimit)

    @property
    def upper(self) -> Floats:
        """(n,) upper limits [rad or m]; inf without one."""
        return np.array(self.model.upperPositionLimit)

    @property
    def tool_joint(self) -> int:
        """Index of the joint in the model that carries the tool."""
        return int(self.model.frames[self.tool].parentJoint)

    def matrix(self, q: Floats) -> Floats:
        """(4, 4) pose of the tool in the base frame at q (n,) [m]."""
        pin.forwardKinematics(self.model, self.data, q)
        return np.array(pin.updateFramePlacement(self.model, self.data, self.tool).homogeneous)

    def joint_matrices(self, q: Floats) -> Floats:
        """(n + 1, 4, 4) poses of the base frame and of the joints' frames, which carry the links, at q (n,) [m]."""
        pin.forwardKinematics(self.model, self.data, q)
        return np.stack([np.array(placement.homogeneous) for placement in self.data.oMi])

    def poses(self, q: ArrayLike) -> RigidTransform:
        """(k,) poses of the tool in the base frame at the configurations q (k, n)."""
        return RigidTransform.from_matrix(np.stack([self.matrix(row) for row in self.checked(q)]))

    def jacobian(self, q: Floats) -> Floats:
        """(6, n) derivative [rotation, translation of the tool's origin] of the tool's pose by q (n,), base frame."""
        columns = pin.computeFrameJacobian(self.model, self.data, q, self.tool, pin.LOCAL_WORLD_ALIGNED)
        return np.asarray(np.vstack([columns[3:], columns[:3]]))

    def manipulability(self, q: ArrayLike) -> Floats:
        """(k,) Yoshikawa's sqrt(det(J J')) at q (k, n): product of the singular values, 0 at singularities.

        Rotations count in rad and translations in m, so it compares postures of one arm, not different arms.
        """
        jacobians = np.stack([self.jacobian(row) for row in self.checked(q)])
        return np.asarray(np.prod(np.linalg.svd(jacobians, compute_uv=False), axis=1))

    def checked(self, q: ArrayLike) -> Floats:
        """(k, n) configurations from (k, n) or (n,) numbers.

        Raises:
            InputError: if the shape is another or a number is not finite.
        """
        rows = np.atleast_2d(np.asarray(q, dtype=float))
        if rows.ndim != 2 or rows.shape[1] != self.n or not np.isfinite(rows).all():
            raise InputError(f"configurations of {self.name} must be finite, of shape (k, {self.n}). Got {np.shape(q)}")
        return rows

    def sample(self, generator: np.random.Generator, count: int) -> Floats:
        """(count, n) configurations, uniform between the limits; joints without limits within ± π or ± 1 m of 0."""
        kind = np.where(np.array(self.units) == "rad", np.pi, 1.0)
        lower = np.where(np.isfinite(self.lower), self.lower, -kind)
        upper = np.where(np.isfinite(self.upper), self.upper, kind)
        return generator.uniform(lower, upper, (count, self.n))

    @cached_property
    def units(self) -> tuple[str, ...]:
        """(n,) units of the joints: rad, or m for sliding ones."""
        return tuple("rad" if turning.any() else "m" for turning in self.twists()[:, 3:])

    def twists(self) -> Floats:
        """(n, 6) motion [translation, rotation] of each joint in its own frame per unit of its coordinate."""
        rows = []
        for joint in list(self.model.joints)[1:]:
            data = joint.createData()
            joint.calc(data, np.zeros(self.model.nq))
            rows.append(np.asarray(data.S, dtype=float).reshape(6))
        return np.stack(rows)


def symbolic_forward(arm: Arm) -> Any:
    """A CasADi function from q (n, 1) [rad or m] to the tool's pose T (4, 4) in the base frame [m].

    Pinocchio's own CasADi bindings are not in its wheels. The chain has one joint after the other, because all joints
    that do not move the tool are locked.
    """
    from micah_plan.symbolic.forward_kinematics import ChainJoint, chain_forward

    model = arm.model
    joints = [
        ChainJoint(np.array(model.jointPlacements[number].homogeneous), twist)
        for number, twist in enumerate(arm.twists(), start=1)
    ]
    return chain_forward(joints, np.array(model.frames[arm.tool].placement.homogeneous))
