"""Layout of printed tags on parts, for reading a video."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

Family = Literal["tag36h11", "tag25h9", "tag16h5", "aruco_4x4", "aruco_5x5", "aruco_6x6", "aruco_original"]
"""Families of tags: three of AprilTag and four of ArUco (the first 100 markers of 4 x 4 to 6 x 6 cells)."""


Up = Literal["x", "-x", "y", "-y", "z", "-z"]
"""Axis of the base's first tag that points up: y on a wall, z on a table."""


@dataclass(frozen=True)
class PlacedTag:
    """One tag.

    Attributes:
        part: that it is on.
        size: length of an edge of the black square [m].
        position: of its middle in the frame of the part [m]; None: unknown.
        quaternion: tag to part, scalar last. Of a tag x points right, y up and z out of the paper.
    """

    part: str
    size: float
    position: tuple[float, float, float] | None = None
    quaternion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class TagLayout:
    """All tags of an object.

    Attributes:
        family: of all tags.
        tags: by number; every number is there once in a scene.
        up: axis of the base's frame, as its tags have it, that points up. Poses are in that frame turned, so that z
            points up (about its x where that can be).
    """

    family: Family
    tags: Mapping[int, PlacedTag]
    up: Up = "z"

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the parts, in the order of the file."""
        return tuple(dict.fromkeys(tag.part for tag in self.tags.values()))

    def of(self, part: str) -> dict[int, PlacedTag]:
        """The tags of a part by number; the first defines its frame unless it states a pose itself."""
        return {number: tag for number, tag in self.tags.items() if tag.part == part}
