"""The arm of a problem and what it holds, as values; `micah_plan.robot` makes a robot of them.

**Robots by name** come from the package example-robot-data (extra `robots`), which brings their files and meshes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import TYPE_CHECKING

from micah_plan.automaton.joint import IDENTITY, Quaternion, Vector3
from micah_plan.task.body import transform

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform


@dataclass(frozen=True)
class RobotDescription:
    """Which robot stands where, and with which frame it holds.

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
        folder: where the robot's file lies; its meshes must lie in it or in a package. Does not count in comparisons.
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
    """What the tool holds, and where.

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


_FOLDER = "cmeel.prefix/share/example-robot-data/robots"
_ENDINGS = (".urdf", ".xml", ".mjcf")


def is_name(path: str) -> bool:
    """Whether what should be the path of a file is the name of a robot: one word without an ending."""
    return "/" not in path and "\\" not in path and not path.lower().endswith(_ENDINGS)


def named_robots() -> dict[str, Path]:
    """The files of the robots that are installed, by name in alphabetical order; empty without the extra."""
    try:
        folder = Path(str(distribution("example-robot-data").locate_file(_FOLDER)))
    except PackageNotFoundError:
        return {}
    return {file.stem: file for file in sorted(folder.rglob("*.urdf"), key=lambda file: (file.stem, len(file.parts)))}
