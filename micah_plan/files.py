"""Whole files in and out: bounded reads with clear errors, writes that replace a file at once or not at all, and paths
that a file names, which must not lead out of its folder."""

from __future__ import annotations

import os
import stat
from pathlib import Path, PurePosixPath, PureWindowsPath

from micah_plan.errors import InputError, shown

LARGEST_FILE_BYTES = 256 * 1024 * 1024


def read_bytes(path: str | Path, limit: int = LARGEST_FILE_BYTES) -> bytes:
    """The content of a file of at most `limit` bytes.

    Raises:
        InputError: if the file is missing, a directory, a pipe or device, not readable or larger.
    """
    try:
        with open(path, "rb", opener=_open_at_once) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                problem = "expected a file, found a pipe or device"
                raise InputError(problem, source=path, remedy="write the content to a file")
            data = file.read(limit + 1)
    except FileNotFoundError:
        raise InputError("the file does not exist", source=path, remedy="check the path") from None
    except IsADirectoryError:
        raise InputError("expected a file, found a directory", source=path, remedy="name a file in it") from None
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL in it
        problem = f"cannot be read ({_reason(error)})"
        raise InputError(problem, source=path, remedy="check its path and permissions") from None
    if len(data) > limit:
        problem = f"expected at most {limit // 1024 // 1024} MiB, found a larger file"
        raise InputError(problem, source=path, remedy="split it into several files")
    return data


def _open_at_once(path: str, flags: int) -> int:
    """Open without waiting for somebody to write into a pipe."""
    return os.open(path, flags | os.O_NONBLOCK)


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


def require_directory(path: str | Path) -> None:
    """Check before long work that its result can be written there.

    Raises:
        InputError: if its directory does not exist, or the path is a directory.
    """
    target = Path(path)
    if target.is_dir():
        raise InputError("expected a file to write, found a directory", source=path, remedy="name a file in it")
    if not target.parent.is_dir():
        remedy = f"create the directory {target.parent} or write elsewhere"
        raise InputError("its directory does not exist", source=path, remedy=remedy)


def replace_file(path: str | Path, data: bytes) -> None:
    """Write a file so that a reader sees the old content or the new, never half of it.

    Raises:
        InputError: if the file cannot be written.
    """
    target = Path(os.path.realpath(path))  # a link keeps pointing to its file
    try:
        if target.exists() and not target.is_file() and not target.is_dir():
            target.write_bytes(data)  # a pipe or device such as /dev/stdout must never be replaced
            return
        temporary = target.with_name(f".{os.urandom(8).hex()}.tmp")
        try:
            with temporary.open("xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(target)
        finally:
            temporary.unlink(missing_ok=True)
    except (OSError, ValueError) as error:
        remedy = "name a file in a directory that exists and may be written"
        raise InputError(f"cannot be written ({_reason(error)})", source=path, remedy=remedy) from None


def _reason(error: OSError | ValueError) -> str:
    """The system's reason, in lower case and without numbers and paths."""
    text = (error.strerror if isinstance(error, OSError) else None) or str(error)
    return text[:1].lower() + text[1:]
