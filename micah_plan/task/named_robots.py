"""Robots by name, from the package example-robot-data (extra `robots`), which brings their files and meshes."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    pass

_FOLDER = "cmeel.prefix/share/example-robot-data/robots"
_ENDINGS = (".urdf", ".xml", ".mjcf")


def is_name(path: str) -> bool:
    """Whether the entry for a path is a robot's name: one word without a suffix."""
    return "/" not in path and "\\" not in path and not path.lower().endswith(_ENDINGS)


def named_robots() -> dict[str, Path]:
    """Files of the installed robots by name, sorted; empty without the extra."""
    try:
        folder = Path(str(distribution("example-robot-data").locate_file(_FOLDER)))
    except PackageNotFoundError:
        return {}
    return {file.stem: file for file in sorted(folder.rglob("*.urdf"), key=lambda file: (file.stem, len(file.parts)))}
