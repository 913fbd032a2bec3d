"""Tag files: which printed tags are on which part of an object (`micah-plan track --tags`)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from micah_plan.documents.apriltag_ros import layout_of_apriltag_ros
from micah_plan.documents.fields import Distance, PartName, Quaternion, Vector3
from micah_plan.documents.layout import Document, Scope, doc
from micah_plan.documents.located import Located
from micah_plan.documents.validation import validated
from micah_plan.documents.yaml_lines import read_yaml_file
from micah_plan.errors import located_in
from micah_plan.recording.tag_layout import Family, PlacedTag, TagLayout, Up

# No printer makes a tag larger than this [m]; sizes in mm are.
_LARGEST = 3.0


class TagDocument(Document):
    makes = PlacedTag

    part: PartName = doc("Part that it is on.")
    size: Distance = doc("Length of an edge of the black square [m], measured on the paper.")
    position: Vector3 | None = doc(
        "Of its middle in the frame of the part [m]; absent: the first tag of a part is where its frame is, "
        "the others are found from frames that show both.",
        None,
    )
    quaternion: Quaternion = doc(
        "Tag to part, scalar last; of a tag x points right, y up and z out of the paper.", (0.0, 0.0, 0.0, 1.0)
    )


class TagsDocument(Document):
    """Printed tags on the parts of an object."""

    makes = TagLayout

    format: Literal["micah-plan/tags/1"] = doc("Format and version of this file.")
    family: Family = doc("Family of all tags.", "tag36h11")
    up: Up = doc(
        "Axis of the base's first tag that points up: y on a wall, z on a table. The base's frame is turned about x "
        "(for `x` about y), so that its z points up.",
        "z",
    )
    tags: Annotated[dict[str, TagDocument], Field(min_length=1, max_length=200)] = doc("Every tag, by its number.")

    def check(self, at: Located) -> None:
        for key, tag in self.tags.items():
            if tag.size > _LARGEST:
                problem = f"expected the edge of a printed tag [m], found {tag.size:g}"
                raise at.at("tags", key, "size").error(problem, f"in mm it would be {tag.size / 1000.0:g}")
            if not key.isdecimal() or len(key) > 4:
                raise at.at("tags").error(f"expected the number of a tag, found {key[:40]!r}", "e.g. 0")
        numbers = [int(key) for key in self.tags]
        if len(set(numbers)) < len(numbers):
            raise at.at("tags").error("expected each number once", "tags of one scene have different numbers")

    def read(self, at: Located, scope: Scope) -> TagLayout:
        parts = tuple(dict.fromkeys(tag.part for tag in self.tags.values()))
        meant: dict[str, Any] = self.meanings(at, {**scope, "part": parts})
        return TagLayout(meant["family"], {int(key): tag for key, tag in meant["tags"].items()}, meant["up"])


def load_tags(path: str | Path) -> TagLayout:
    """The tags of a file: our format, or apriltag_ros for ROS 1 or 2.

    Raises:
        InputError: if it cannot be used; one line with file, line, key, expected and found content, and the remedy.
    """
    located = read_yaml_file(path)
    with located_in(path):
        document = layout_of_apriltag_ros(located.data)
    if document is not None:
        located = Located(document, located.source)
    return validated(located, TagsDocument).read(located, {})
