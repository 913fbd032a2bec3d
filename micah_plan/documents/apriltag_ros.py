"""Tag files of apriltag_ros, converted to our tag layout.

ROS 1 (AprilRobotics): ``standalone_tags`` and ``tag_bundles``; the family stands in a file of its own there.
ROS 2 (christianrauch): parameters of a node with ``family``, ``size`` and ``tag: {ids, frames, sizes}``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from micah_plan.errors import InputError

_IDENTITY = {"qx": 0.0, "qy": 0.0, "qz": 0.0, "qw": 1.0}
_FAMILIES = {"36h11": "tag36h11", "25h9": "tag25h9", "16h5": "tag16h5"}


def layout_of_apriltag_ros(data: Any) -> dict[str, Any] | None:
    """The equivalent tag layout; None if the data has another format.

    Raises:
        InputError: if it is of one, but lacks something.
    """
    if not isinstance(data, Mapping):
        return None
    if "standalone_tags" in data or "tag_bundles" in data:
        return _document(_of_ros_1(data), str(data.get("tag_family", "tag36h11")))
    parameters = _parameters(data)
    if parameters is None or not isinstance(parameters.get("tag"), Mapping):
        return None
    return _document(_of_ros_2(parameters), str(parameters.get("family", "36h11")))


def _document(tags: dict[str, Any], family: str) -> dict[str, Any]:
    return {"format": "micah-plan/tags/1", "family": _FAMILIES.get(family, family), "tags": tags}


def _of_ros_1(data: Mapping[str, Any]) -> dict[str, Any]:
    tags: list[tuple[str, dict[str, Any]]] = []
    for entry in _entries(data, "standalone_tags"):
        number = str(_value(entry, "id", "standalone_tags"))
        size = _value(entry, "size", "standalone_tags")
        tags.append((number, {"part": str(entry.get("name", f"tag_{number}")), "size": size}))
    for bundle in _entries(data, "tag_bundles"):
        for entry in _entries(bundle, "layout"):
            tag = {"part": str(_value(bundle, "name", "tag_bundles")), "size": _value(entry, "size", "layout")}
            tag["position"] = [entry.get(key, 0.0) for key in ("x", "y", "z")]
            tag["quaternion"] = [entry.get(key, default) for key, default in _IDENTITY.items()]
            tags.append((str(_value(entry, "id", "layout")), tag))
    return _each_once(tags)


def _of_ros_2(parameters: Mapping[str, Any]) -> dict[str, Any]:
    own = parameters["tag"]
    numbers = _values(own, "ids")
    frames = _values(own, "frames") or [f"tag_{number}" for number in numbers]
    sizes = _values(own, "sizes") or [_value(parameters, "size", "ros__parameters")] * len(numbers)
    if not len(numbers) == len(frames) == len(sizes):
        problem = f"expected as many frames and sizes as ids, found {len(frames)} and {len(sizes)} for {len(numbers)}"
        raise InputError(problem, where="key 'tag'", remedy="name a frame and a size for each id")
    parts = ({"part": str(frame), "size": size} for frame, size in zip(frames, sizes, strict=True))
    return _each_once(list(zip(map(str, numbers), parts, strict=True)))


def _each_once(tags: Sequence[tuple[str, dict[str, Any]]]) -> dict[str, Any]:
    numbers = [number for number, _ in tags]
    twice = next((number for number in numbers if numbers.count(number) > 1), None)
    if twice is not None:
        raise InputError(f"tag {twice} is there twice", remedy="tags of one scene have different numbers")
    return dict(tags)


def _values(data: Mapping[str, Any], key: str) -> Sequence[Any]:
    values = data.get(key) or []
    if not isinstance(values, list):
        raise InputError(
            "expected a list", where=f"key 'tag.{key}'", remedy="write one entry for each tag, in brackets"
        )
    return values


def _parameters(data: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """The entry ``ros__parameters`` at any depth, under any node name."""
    for key, value in data.items():
        if key == "ros__parameters" and isinstance(value, Mapping):
            return value
        if isinstance(value, Mapping) and (found := _parameters(value)) is not None:
            return found
    return None


def _entries(data: Mapping[str, Any], key: str) -> Sequence[Mapping[str, Any]]:
    entries = data.get(key) or []
    if not isinstance(entries, Sequence) or not all(isinstance(entry, Mapping) for entry in entries):
        raise InputError(
            "expected a list of tags", where=f"key '{key}'", remedy="write one {id: 0, size: 0.06} per tag"
        )
    return entries


def _value(data: Mapping[str, Any], key: str, within: str) -> Any:
    if key not in data:
        raise InputError(f"missing key '{key}'", where=f"key '{within}'", remedy="add it")
    return data[key]
