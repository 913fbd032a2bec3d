"""The arm's forward kinematics as a CasADi function, walked from its Pinocchio model."""

from __future__ import annotations

from typing import Any

import numpy as np

from micah_plan.robot.arm import Arm
from micah_plan.symbolic.chain_kinematics import ChainJoint, chain_forward


def symbolic_forward(arm: Arm) -> Any:
    """A CasADi function from q (n, 1) [rad or m] to the tool's pose T (4, 4) in the base frame [m].

    Pinocchio's own CasADi bindings are not in its wheels. The chain has one joint after the other, because all joints
    that do not move the tool are held still.
    """
    model = arm.model
    joints = [
        ChainJoint(np.array(model.jointPlacements[number].homogeneous), twist)
        for number, twist in enumerate(arm.twists(), start=1)
    ]
    return chain_forward(joints, np.array(model.frames[arm.tool].placement.homogeneous))
