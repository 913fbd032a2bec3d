"""Conventions of a laboratory's recordings: a small YAML file next to a log."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from micah_plan.documents.layout import Document, doc
from micah_plan.documents.validation import validated
from micah_plan.documents.yaml_lines import read_yaml_file
from micah_plan.errors import located_in
from micah_plan.recording.commands import CommandKind
from micah_plan.recording.conventions import Axis, Conventions, Order
from micah_plan.task.named_robots import is_name

BESIDE = ".conventions.yaml"
"""Ending of the file that says how the recording of the same name beside it is meant."""


class ConventionsDocument(Document):
    """Conventions of a foreign recording."""

    makes = Conventions

    format: Literal["micah-plan/conventions/1"] = doc("Format and version of this file.")
    columns: dict[str, str] = doc(
        "What the file calls the columns of a recording, also rx, ry, rz and roll, pitch, yaw; -Y and 0.001*X are "
        "numbers times a factor.",
        dict,
    )
    length: Literal["m", "cm", "mm", "in"] | None = doc("Unit of positions and actions; default: m.", None)
    angle: Literal["rad", "deg"] | None = doc("Unit of rotation vectors and angles; default: rad.", None)
    time: Literal["s", "ms", "us", "ns"] | None = doc("Unit of times; default: s.", None)
    rate: Annotated[float, Field(gt=0.0)] | None = doc("Rows per second, where times are counted [Hz].", None)
    up: Axis | None = doc("The axis that points upwards; default: z.", None)
    quaternion: Order | None = doc("Order of the four columns of a quaternion; default: xyzw.", None)
    commands: CommandKind | None = doc(
        "Meaning of the actions: displacement, the displacement to a commanded position, or velocity [m/s]; default: "
        "not stated.",
        None,
    )
    positions_only: bool | None = doc(
        "Whether orientations are left out, as where a hand turns on what it holds; default: they are used.", None
    )
    name: str | None = doc("Name of the only part.", None)
    topics: list[str] = doc(
        "Of a ROS log, topics with poses or child frames of transforms, one part each; none: all of them.", list
    )
    robot: str | None = doc(
        "Whose joints the file has, in place of poses: a URDF or MJCF file, relative to this file, or the name of an "
        "installed robot.",
        None,
    )
    tool: str | None = doc("Frame of the robot that moves with the part.", None)
    joint_ranges: str | None = doc(
        "File of the calibrated ranges in percent of which the joints are logged, relative to this file: LeRobot's "
        "calibration.json.",
        None,
    )
    frame: str | None = doc("Of a ROS log, in which the poses are wanted; default: that in which they are given.", None)


def load_conventions(path: str | Path) -> Conventions:
    """The conventions that a file describes.

    Raises:
        InputError: if it cannot be used; one line with file, line, key, expected and found content, and the remedy.
    """
    located = read_yaml_file(path)
    meanings = validated(located, ConventionsDocument).meanings(located, {})
    with located_in(path):
        meant = Conventions(**meanings | {"topics": tuple(meanings["topics"])})
    beside = Path(path).parent
    if meant.joint_ranges is not None:
        meant = replace(meant, joint_ranges=str(beside / meant.joint_ranges))
    if meant.robot is None or is_name(meant.robot):
        return meant
    return replace(meant, robot=str(beside / meant.robot))


def conventions_beside(path: str | Path) -> Conventions | None:
    """The conventions in the file next to a recording, ``door.conventions.yaml`` for ``door.csv``; None if absent.

    Raises:
        InputError: if that file cannot be used.
    """
    beside = Path(path).with_suffix(BESIDE) if Path(path).name else Path()
    return load_conventions(beside) if beside.is_file() else None
