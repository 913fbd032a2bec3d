"""Motions that no single joint holds, and joints under trackers that wander: recordings with a known truth."""

from __future__ import annotations

import numpy as np
from fit_coverage import wandering
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation
from simulated_hand import slow

from micah_plan.automaton.joint import Joint, prismatic, revolute, screw
from micah_plan.automaton.kinematics import forward
from micah_plan.recording.value import Recording

RATE = 18.0  # Hz
POSITION_STD, ROTATION_STD = 0.001, 0.006  # m, rad; white, and of the wander in units of it
AXIS = np.array([0.36, 0.48, 0.8])
TURN = Rotation.from_rotvec([0.4, -0.3, 0.9])
JOINTS: dict[str, tuple[Joint, float]] = {
    "prismatic": (prismatic(AXIS, (0.5, 0.1, 0.3), TURN.as_quat()), 0.25),
    "revolute": (revolute(AXIS, (0.2, 0.3, 0.1), (0.5, 0.1, 0.3), TURN.as_quat()), 0.9),
    "screw": (screw(AXIS, (0.4, 0.2, 0.2), 0.12, (0.5, 0.1, 0.3), TURN.as_quat()), 1.2),
}
FREE = ("plane", "turning plane", "ball", "sliding door on a hinge", "deforming path", "free hand")


def measured(
    position: np.ndarray,
    rotation: Rotation,
    rng: np.random.Generator,
    wander: float,
    memory: float,
    orientation: bool,
    scale: float = 1.0,
) -> Recording:
    """Poses as a tracker sees them: white noise, and a wander of so many times its std with a memory in rows."""
    n = len(position)
    noise = scale * (rng.standard_normal((n, 6)) + (wander * wandering(n, memory, rng) if wander else 0.0))
    turned = Rotation.from_rotvec(ROTATION_STD * noise[:, :3]) * rotation
    return Recording(
        time=np.arange(n) / RATE,
        position=position + POSITION_STD * noise[:, 3:],
        quaternion=turned.as_quat() if orientation else None,
    )


def free_recording(motion: str, seed: int, orientation: bool, rows: int = 120) -> Recording:
    """A motion of `FREE`, in a random frame, by a hand that wanders smoothly over about 15 cm and 0.5 rad."""
    rng = np.random.default_rng([2, seed])
    base = Rotation.from_quat(rng.standard_normal(4))
    a, b, c, d, e, f = (gaussian_filter1d(slow(rng, rows + 60, 25), 4)[30:-30] for _ in range(6))
    zero = np.zeros(rows)
    about_z = np.stack([zero, zero, 0.6 * c], axis=1)
    turn = {
        "plane": np.zeros((rows, 3)),
        "turning plane": about_z,
        "ball": 0.5 * np.stack([a, b, c], axis=1),
        "sliding door on a hinge": about_z,
        "free hand": 0.5 * np.stack([d, e, f], axis=1),
    }
    if motion == "deforming path":
        angle = np.linspace(0.0, 1.5, rows)
        radius = 0.3 * (1 + 0.5 * np.sin(3 * angle))
        position = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0.06 * np.sin(5 * angle)], axis=1)
        rotation = Rotation.from_rotvec(np.outer(angle + 0.4 * np.sin(4 * angle), [0, 0, 1]))
    else:
        rotation = Rotation.from_rotvec(turn[motion])
        position = {
            "plane": 0.15 * np.stack([a, b, zero], axis=1),
            "turning plane": 0.15 * np.stack([a, b, zero], axis=1),
            "ball": rotation.apply([0.25, 0.05, 0.1]),
            "sliding door on a hinge": rotation.apply(np.stack([0.4 + 0.12 * a, zero, zero], axis=1)),
            "free hand": 0.15 * np.stack([a, b, c], axis=1),
        }[motion]
    return measured(base.apply(position), base * rotation, rng, 1.0, 10.0, orientation)


def joint_recording(
    kind: str,
    seed: int,
    wander: float,
    memory: float,
    stop: int = 70,
    held: int = 40,
    orientation: bool = True,
    noise: float = 1.0,
) -> Recording:
    """A joint moved at an uneven pace to where it is held from row `stop` on, without actions."""
    rng = np.random.default_rng([3, seed])
    joint, travel = JOINTS[kind]
    pace = np.exp(0.25 * slow(rng, stop, 8))
    c = np.concatenate([[0.0], travel * np.cumsum(pace) / pace.sum(), np.full(held, travel)])
    poses = forward(joint, c)
    return measured(poses.translation, poses.rotation, rng, wander, memory, orientation, noise)
