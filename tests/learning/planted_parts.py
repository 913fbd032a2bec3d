"""Recordings of several parts on a planted tree, for the tests of learning trees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.automaton.graph import BASE
from micah_plan.automaton.joint import Joint, prismatic, revolute, rigid
from micah_plan.automaton.kinematics import forward
from micah_plan.recording.value import Recording

RATE = 18.0
DOOR = revolute((0, 0, 1), (-0.2, 0.0, 0.3), (0.15, 0.02, 0.3), (0.0, 0.0, 0.1, 1.0))
DRAWER = prismatic((0, 1, 0.05), (0.1, -0.1, 0.1))
KNOB = rigid((0.04, 0.05, -0.02), (0.5, 0.1, 0.0, 0.8))
CARRIAGE = prismatic((1, 0.2, 0), (0.0, 0.1, 0.4), (0.0, 0.3, 0.0, 1.0))
TRAY = prismatic((0, 0.6, 0.8), (0.05, 0.1, 0.02))
FOREARM = revolute((0, 0, 1), (0.05, 0.0, 0.0), (0.3, 0.02, 0.03))


@dataclass(frozen=True)
class PlantedPart:
    """A part on its joint with its (n,) configurations."""

    parent: str
    joint: Joint
    configurations: np.ndarray


def sweep(rows: int, begin: int, end: int, distance: float) -> np.ndarray:
    """(rows,) configurations: 0, then an uneven motion between two rows, then at rest at `distance`."""
    phase = np.clip((np.arange(rows) - begin) / (end - begin), 0, 1)
    return distance * (phase + 0.04 * np.sin(2 * np.pi * phase))


def true_poses(parts: Mapping[str, PlantedPart]) -> dict[str, RigidTransform]:
    """(n,) poses of every part in the base frame, parents first."""
    poses: dict[str, RigidTransform] = {}
    for name, part in parts.items():
        relative = forward(part.joint, part.configurations)
        poses[name] = relative if part.parent == BASE else poses[part.parent] * relative
    return poses


def recorded_parts(
    parts: Mapping[str, PlantedPart],
    seed: int,
    *,
    position: float | Mapping[str, float] = 0.0015,
    rotation: float = 0.008,
    actions: bool = False,
    late: float = 0.0,
    dropped: float = 0.0,
    order: Sequence[str] | None = None,
) -> Recording:
    """Measured poses, rows sorted by time.

    Args:
        position, rotation: white noise per axis [m, rad]; the first may differ by part.
        actions: the true displacement to the next row, as a perfect hand commands it.
        late: by how much the k-th part is measured after the one before it [s]; it is still where it was.
        dropped: share of rows that are missing.
    """
    rng = np.random.default_rng(seed)
    rows = []
    for number, (name, poses) in enumerate(true_poses(parts).items()):
        n = len(poses)
        std = position if isinstance(position, float) else position[name]
        where = poses.translation + std * rng.standard_normal((n, 3))
        turned = Rotation.from_rotvec(rotation * rng.standard_normal((n, 3))) * poses.rotation
        moved = np.vstack([np.diff(poses.translation, axis=0), np.full((1, 3), np.nan)])
        kept = np.flatnonzero(rng.random(n) >= dropped)
        place = number if order is None else order.index(name)
        rows += [
            (t / RATE + late * number, place, name, where[t], turned.as_quat()[t], moved[t]) for t in kept.tolist()
        ]
    rows.sort(key=lambda row: row[:2])
    return Recording(
        time=np.array([row[0] for row in rows]),
        position=np.array([row[3] for row in rows]),
        quaternion=np.array([row[4] for row in rows]),
        action=np.array([row[5] for row in rows]) if actions else None,
        part=tuple(row[2] for row in rows),
        has_part=True,
    )


def cabinet(knob: str = "knob") -> dict[str, PlantedPart]:
    """A door with a knob and a drawer that move one after the other."""
    return {
        "door": PlantedPart(BASE, DOOR, sweep(150, 5, 65, 1.2)),
        "drawer": PlantedPart(BASE, DRAWER, sweep(150, 85, 145, 0.3)),
        knob: PlantedPart("door", KNOB, np.zeros(150)),
    }


def carriage(together: bool) -> dict[str, PlantedPart]:
    """A tray that slides in a carriage that slides, at once or one after the other."""
    begin, end = (5, 130) if together else (75, 130)
    return {
        "carriage": PlantedPart(BASE, CARRIAGE, sweep(140, 5, 130 if together else 60, 0.4)),
        "tray": PlantedPart("carriage", TRAY, sweep(140, begin, end, 0.2) ** 2 / 0.2),
    }


def arm(together: bool) -> dict[str, PlantedPart]:
    """A door on a door: two parallel hinges."""
    turn = sweep(140, 5, 130, 0.9) if together else sweep(140, 75, 130, 0.9)
    return {
        "upper": PlantedPart(BASE, DOOR, sweep(140, 5, 130 if together else 65, 1.0)),
        "lower": PlantedPart("upper", FOREARM, turn**2 / 0.9 if together else turn),
    }
