"""Paths that a file names: resolved, and refused if they leave the folders that they may lead to."""

from __future__ import annotations

from pathlib import Path, PurePosixPath, PureWindowsPath

from micah_plan.errors import InputError, shown


def contained(name: str, folder: str | Path) -> Path:
    """The existing file that a relative path leads to, with links followed.

    Args:
        name: as the file says it, with ``/``.
        folder: the folder that it is relative to and may not leave.

    Raises:
        InputError: if the path is absolute, leaves the folder (also through a link) or leads to no file.
    """
    remedy = f"put the file into {folder} and name it relative to it"
    if not name or "\0" in name or PurePosixPath(name).is_absolute() or PureWindowsPath(name).drive or "\\" in name:
        raise InputError(f"expected a relative path, found {shown(name)}", remedy=remedy)
    root = Path(folder).resolve()
    try:
        target = (root / name).resolve()
    except (OSError, RuntimeError, ValueError):  # a loop of links
        raise InputError(f"the path {shown(name)} cannot be followed", remedy=remedy) from None
    if not target.is_relative_to(root):
        raise InputError(f"the path {shown(name)} leaves its folder", remedy=remedy)
    if not target.is_file():
        raise InputError(f"there is no file {shown(name)} in {folder}", remedy="check the path")
    return target
