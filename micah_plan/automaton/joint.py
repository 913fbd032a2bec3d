"""Joints: rigid, prismatic, revolute and screw, as one-parameter motions f(c) = exp(c ξ) ∘ origin.

All four are the same motion with another twist ξ, so one value and one set of functions serve them (Sturm et al.,
JAIR 2011, for the models; Murray, Li and Sastry, "A Mathematical Introduction to Robotic Manipulation", ch. 2 and 3,
for the product of exponentials).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

JointKind = Literal["rigid", "prismatic", "revolute", "screw"]
JOINT_KINDS: tuple[JointKind, ...] = ("rigid", "prismatic", "revolute", "screw")
Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


@dataclass(frozen=True)
class ParameterCovariance:
    """Covariance of a joint's parameters.

    Attributes:
        names: among ``axis_1, axis_2`` [rad] (tilts of the axis about the two directions of `axis_basis`),
            ``center_1, center_2`` [m] (shifts of the centre along them), ``pitch`` [m/rad],
            ``rotation_1..3`` [rad] and ``position_1..3`` [m] (of the origin pose, base frame).
        matrix: (k, k), symmetric positive semi-definite, in the units above.
    """

    names: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Joint:
    """A one-degree-of-freedom (or rigid) connection of a part to its base.

    Attributes:
        kind: rigid, prismatic, revolute or screw.
        position: origin of the part in the base frame at configuration 0 [m] (rigid: at all times).
        quaternion: orientation of the part at configuration 0, scalar last.
        axis: unit vector of motion or rotation in the base frame; (0, 0, 0) for rigid.
        center: point on the axis of rotation closest to `position` [m]; (0, 0, 0) for rigid and prismatic.
        pitch: translation along the axis per angle [m/rad]; 0 unless screw.
        held: configuration that a rigid joint stands for [rad or m]; 0 for others.
        covariance: of the parameters, if they were estimated.

    The configuration c is in rad for revolute and screw, in m for prismatic.
    """

    kind: JointKind
    position: Vector3
    quaternion: Quaternion = (0.0, 0.0, 0.0, 1.0)
    axis: Vector3 = (0.0, 0.0, 0.0)
    center: Vector3 = (0.0, 0.0, 0.0)
    pitch: float = 0.0
    held: float = 0.0
    covariance: ParameterCovariance | None = None
