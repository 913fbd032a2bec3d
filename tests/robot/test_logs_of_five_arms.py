"""Arms of five makers open a door with their first joint, log their joints, and the door is learned from the log.

Where the hand is, Pinocchio says here by itself; the log is made by these tests, in the units that each maker uses.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from extras import requires
from scipy.spatial.transform import Rotation

from micah_plan import learn, load
from micah_plan.task.named_robots import named_robots

pytestmark = [requires("robots")]

# Tool, and joints in the middle of the way [rad]; the first one turns the arm about the vertical.
ARMS: dict[str, tuple[str, list[float]]] = {
    "so101": ("gripper_frame_link", [0.1, -0.4, 0.5, 0.6, 0.2]),
    "panda": ("panda_hand", [0.0, 0.2, 0.1, -1.8, 0.0, 2.0, 0.7]),
    "ur5_robot": ("ee_link", [0.3, -1.2, 1.6, -0.8, -1.5, 0.2]),
    "kinova": ("j2s6s200_end_effector", [1.0, 2.6, 1.4, 0.5, 1.6, 0.3]),
    "xarm7": ("link_eef", [0.2, 0.3, 0.1, 1.2, 0.0, 0.9, 0.0]),
}
TURN, MOVING, PUSHING = 0.8, 60, 25


def log_of(name: str) -> tuple[list[str], np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Names of the joints, (n, j) joints and targets [rad], and (n, 3) and (n, 4) places of the hand by Pinocchio."""
    import pinocchio as pin

    tool, bent = ARMS[name]
    model = pin.buildModelFromUrdf(str(named_robots()[name]))
    data, frame = model.createData(), model.getFrameId(tool)
    joints = [joint for joint in model.names[1:] if joint in model.names][: len(bent)]
    rows = MOVING + PUSHING
    turned = np.concatenate([np.linspace(-0.5, 0.5, MOVING) * TURN, np.full(PUSHING, 0.5 * TURN)])
    ahead = np.full(rows, TURN / (MOVING - 1))
    noise = np.random.default_rng(0).normal(0.0, 5e-4, (rows, len(bent)))
    first = np.eye(len(bent))[0]
    q = np.array(bent) + np.outer(turned, first) + noise
    places = []
    for row in q:
        every = pin.neutral(model)
        for joint, angle in zip(joints, row, strict=True):
            at = model.joints[model.getJointId(joint)]
            every[at.idx_q : at.idx_q + at.nq] = [np.cos(angle), np.sin(angle)] if at.nq == 2 else [angle]
        pin.framesForwardKinematics(model, data, every)
        places.append(np.concatenate([data.oMf[frame].translation, pin.Quaternion(data.oMf[frame].rotation).coeffs()]))
    return joints, q, q + np.outer(ahead, first), np.array(places)[:, :3], np.array(places)[:, 3:]


def shoulder_of(name: str) -> np.ndarray:
    """(2,) where the first joint stands, from above [m]."""
    import pinocchio as pin

    return np.array(pin.buildModelFromUrdf(str(named_robots()[name])).jointPlacements[1].translation[:2])


def written(folder: Path, columns: dict[str, np.ndarray]) -> Path:
    file = folder / "log.csv"
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    file.write_text("\n".join([",".join(columns), *(",".join(map(repr, row)) for row in rows)]) + "\n")
    return file


def in_units_of_the_maker(name: str, folder: Path) -> tuple[Path, dict[str, Any], np.ndarray, np.ndarray]:
    """The log, how it is meant, and where the hand was."""
    joints, q, targets, position, quaternion = log_of(name)
    meant: dict[str, Any] = {"robot": name, "tool": ARMS[name][0], "rate": 30.0, "name": "door"}
    if name == "so101":  # LeRobot: percent of the calibrated range
        ranges = {joint: {"drive_mode": 0, "range_min": 900, "range_max": 3100} for joint in joints}
        (folder / "calibration.json").write_text(json.dumps(ranges))
        percent = 200.0 * 4096 / (2 * np.pi * 2200)
        columns = {f"observation.state.{joint}.pos": percent * q[:, i] for i, joint in enumerate(joints)}
        columns |= {f"action.{joint}.pos": percent * targets[:, i] for i, joint in enumerate(joints)}
        return (
            written(folder, columns),
            meant | {"joint_ranges": str(folder / "calibration.json")},
            position,
            quaternion,
        )
    factor = 180.0 / np.pi if name == "xarm7" else 1.0
    columns = {joint: factor * q[:, i] for i, joint in enumerate(joints)}
    columns |= {f"target {joint}": factor * targets[:, i] for i, joint in enumerate(joints)}
    return written(folder, columns), meant | ({"angle": "deg"} if name == "xarm7" else {}), position, quaternion


@pytest.mark.parametrize("name", ARMS)
def test_the_hand_is_where_pinocchio_has_it_and_the_door_is_learned(name: str, tmp_path: Path) -> None:
    log, meant, position, quaternion = in_units_of_the_maker(name, tmp_path)
    recording = load(log, **meant)
    np.testing.assert_allclose(recording.position, position, atol=1e-9)
    off = Rotation.from_quat(recording.quaternion) * Rotation.from_quat(quaternion).inv()
    assert off.magnitude().max() < 1e-7
    assert not [note for note in recording.notes if "limits" in note]
    (edge,) = learn(recording).graph.edges
    assert [segment.joint.kind for segment in edge.segments] == ["revolute", "rigid"]
    door = edge.segments[0].joint
    assert abs(door.axis[2]) > 0.999
    assert edge.segments[1].start == pytest.approx(MOVING, abs=3)
    np.testing.assert_allclose(door.center[:2], shoulder_of(name), atol=0.003)
