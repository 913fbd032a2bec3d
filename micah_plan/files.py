"""Reading and writing of whole files: bounded reads, atomic writes, and containment of relative paths in a folder."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path, PurePosixPath, PureWindowsPath

from micah_plan.errors import InputError, shown

LARGEST_FILE_BYTES = 256 * 1024 * 1024
_PERMISSIONS = 0o777


def read_bytes(path: str | Path, limit: int = LARGEST_FILE_BYTES) -> bytes:
    """The content of a file of at most `limit` bytes.

    Raises:
        InputError: if the file is missing, a directory, a pipe or device, not readable or larger.
    """
    try:
        with open(path, "rb", opener=_open_without_waiting) as file:
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


def _open_without_waiting(path: str, flags: int) -> int:
    """Open a file without blocking on pipes."""
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
    """Refuse an output whose folder does not exist or cannot be written.

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
    """Replace a file atomically; permissions are kept.

    Raises:
        InputError: if the file cannot be written.
    """
    replace_files({Path(path): data})


def replace_files(contents: Mapping[Path, bytes]) -> None:
    """Replace related files: all are on disk before the first is replaced.

    Raises:
        InputError: if one cannot be written; then none is replaced, except for a failure between the replacements.
    """
    waiting: list[tuple[Path, Path]] = []
    path: str | Path = ""
    try:
        for path, data in contents.items():
            target = Path(os.path.realpath(path))  # a link keeps pointing to its file
            if target.exists() and not target.is_file() and not target.is_dir():
                _write_through(target, data)  # a pipe or device such as /dev/stdout must never be replaced
                continue
            temporary = target.with_name(f".{os.urandom(8).hex()}.tmp")
            waiting.append((temporary, target))
            _write(temporary, data, target)
        for temporary, target in waiting:
            path = target
            temporary.replace(target)
    except (OSError, ValueError) as error:
        remedy = "name a file in a directory that exists and may be written"
        raise InputError(f"cannot be written ({_reason(error)})", source=path, remedy=remedy) from None
    finally:
        for temporary, _ in waiting:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)


def _write(temporary: Path, data: bytes, target: Path) -> None:
    """Write a new file to disk with the permissions of the one it will replace."""
    mode = stat.S_IMODE(target.stat().st_mode) & _PERMISSIONS if target.is_file() else None
    with open(temporary, "xb", opener=None if mode is None else _open_private) as file:
        if mode is not None:
            os.fchmod(file.fileno(), mode)
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def _write_through(target: Path, data: bytes) -> None:
    """Write into a pipe or device; a pipe without a reader is an error instead of a deadlock."""
    try:
        descriptor = os.open(target, os.O_WRONLY | os.O_NONBLOCK)
    except OSError as error:
        raise OSError(error.errno, "nobody reads this pipe") if error.errno == errno.ENXIO else error from None
    os.set_blocking(descriptor, True)
    with open(descriptor, "wb") as file:
        file.write(data)


def _open_private(path: str, flags: int) -> int:
    """Open a file readable by its owner only, until it gets its final permissions."""
    return os.open(path, flags, 0o600)


def _reason(error: OSError | ValueError) -> str:
    """The system's reason, in lower case and without numbers and paths."""
    text = (error.strerror if isinstance(error, OSError) else None) or str(error)
    return text[:1].lower() + text[1:]
