"""Where an automaton's parts are at a state."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from micah_plan.automaton.hybrid import HybridAutomaton, Mode
from micah_plan.automaton.kinematics import forward

Floats = NDArray[np.float64]


def part_poses(automaton: HybridAutomaton, mode: Mode, x: Floats) -> dict[str, RigidTransform]:
    """Pose of every linked part in the base frame at the state x (n,), by part name."""
    return {name: poses[0] for name, poses in poses_of_states(automaton, mode, x[None]).items()}


def poses_of_states(automaton: HybridAutomaton, mode: Mode, states: Floats) -> dict[str, RigidTransform]:
    """(k,) poses of every linked part in the base frame at states (k, n), by part name."""
    poses: dict[str, RigidTransform] = {}
    for link, joint in zip(automaton.links, mode.joints, strict=True):
        relative = forward(joint, states[:, link.coordinate])
        poses[link.child] = poses[link.parent] * relative if link.parent in poses else relative
    return poses
