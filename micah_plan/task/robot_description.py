"""The arm and the grasp of a problem, as values for `micah_plan.robot`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from micah_plan.automaton.joint import IDENTITY, Quaternion, Vector3
from micah_plan.task.body import transform

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform


@dataclass(frozen=True)
class RobotDescription:
    """The robot, its placement, and its gripping frame.

    Attributes:
        path: of the robot's file, as messages name it.
        text: content of the file, URDF or MJCF.
        tool: name of the frame that grasps: a link, body or site.
        position, quaternion: pose of the robot's root in the base frame.
        locked: (joint, value [rad or m]) of joints that do not belong to the arm, such as fingers; others stand in the
            middle of their range.
        rest: (joint, value [rad or m]) of a posture to prefer; empty: the middle of the ranges.
        packages: (name, folder, relative to `root`) that ``package://name/`` in mesh paths stands for.
        srdf: content of a file with pairs of links that need no check (``disable_collisions``); empty: none.
        folder: of the robot's file; its meshes must be in it or in a package. Does not count in comparisons.
        root: folder that packages are relative to. Does not count in comparisons.
    """

    path: str
    text: str
    tool: str
    position: Vector3 = (0.0, 0.0, 0.0)
    quaternion: Quaternion = IDENTITY
    locked: tuple[tuple[str, float], ...] = ()
    rest: tuple[tuple[str, float], ...] = ()
    packages: tuple[tuple[str, str], ...] = ()
    srdf: str = ""
    folder: str = field(default="", compare=False)
    root: str = field(default="", compare=False)

    @property
    def pose(self) -> RigidTransform:
        """Pose of the robot's root in the base frame (single)."""
        return transform(self.position, self.quaternion)


@dataclass(frozen=True)
class Grasp:
    """The grasped part, and the tool's pose in it.

    Attributes:
        part: the part that moves with the tool.
        position, quaternion: pose of the tool's frame in the part's frame.
    """

    part: str
    position: Vector3 = (0.0, 0.0, 0.0)
    quaternion: Quaternion = IDENTITY

    @property
    def pose(self) -> RigidTransform:
        """Pose of the tool in the part's frame (single)."""
        return transform(self.position, self.quaternion)
