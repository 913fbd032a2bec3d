"""The journal of a sweep: one line per finished case, on the disk before the next is written, read again to go on.

The first line names the format; every other is a JSON object with the case's key and its run. A file that ends within a
line was cut by a kill: the rest of the line is dropped, and that case is done again.
"""

from __future__ import annotations

import fcntl
import json
import os
import stat
from dataclasses import asdict, fields
from math import isfinite
from pathlib import Path
from types import TracebackType
from typing import Any, get_args

from micah_plan.errors import InputError
from micah_plan.files import LARGEST_FILE_BYTES
from micah_plan.sweep.result import NUMBERS, CaseResult, CaseRun, Outcome

_HEADER = b'{"format": "micah-plan/sweep-journal/1"}'


def journal_path(output: Path) -> Path:
    """Path of the journal of a table, in the same folder."""
    return output.with_name(f"{output.name}.journal")


def read_journal(path: Path) -> dict[str, CaseRun]:
    """The finished cases of a journal by key; empty without a journal.

    Raises:
        InputError: if it is none, or a line of it is damaged.
    """
    if not path.exists():
        return {}
    with Journal(path, changes=False) as journal:
        return journal.finished


class Journal:
    """An open journal, locked against other writers.

    Attributes:
        finished: every run in it, by the case's key.

    Raises:
        InputError: if the file is no journal, damaged, in use by another sweep, or cannot be written.
    """

    def __init__(self, path: Path, *, changes: bool = True) -> None:
        """Args: the file, created if absent; and whether it is opened for writing."""
        self._path = path
        try:
            flags = os.O_RDWR | os.O_CREAT | os.O_APPEND if changes else os.O_RDONLY
            self._file = os.open(path, flags | os.O_CLOEXEC | os.O_NONBLOCK, 0o666)
        except OSError as error:
            raise self._error(f"cannot be opened ({error.strerror})", "write the results elsewhere") from None
        try:
            if changes:
                self._lock()
            whole, self.finished = self._read()
            if changes:
                self._begin(whole)
        except BaseException:
            os.close(self._file)
            raise

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        os.close(self._file)

    def append(self, key: str, run: CaseRun) -> None:
        """Append a finished case; it is on disk when this returns."""
        line = json.dumps({"key": key, **asdict(run)}, allow_nan=False)
        self._write(line.encode() + b"\n")
        self.finished[key] = run

    def _lock(self) -> None:
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            remedy = "wait for it, or write the results elsewhere"
            raise self._error("another sweep is writing to it", remedy) from None

    def _read(self) -> tuple[int, dict[str, CaseRun]]:
        """(number of bytes in whole lines, their entries)."""
        status = os.fstat(self._file)
        if not stat.S_ISREG(status.st_mode) or status.st_size > LARGEST_FILE_BYTES:
            raise self._error("is no journal of a sweep", "write the results elsewhere")
        with open(self._path, "rb") as file:
            content = file.read(LARGEST_FILE_BYTES + 1)
        whole = content.rfind(b"\n") + 1
        lines = content[:whole].split(b"\n")[:-1]
        if (lines and lines[0] != _HEADER) or (not lines and not _HEADER.startswith(content)):
            raise self._error("is no journal of a sweep", "write the results elsewhere")
        return whole, dict(self._entry(number, line) for number, line in enumerate(lines[1:], start=2))

    def _entry(self, number: int, line: bytes) -> tuple[str, CaseRun]:
        try:
            data: Any = json.loads(line)
            key = data.pop("key")
            if not isinstance(key, str):
                raise ValueError("expected a key")
            return key, run_of(data)
        except (ValueError, KeyError, AttributeError, TypeError, RecursionError):
            problem, remedy = "the line is damaged", "delete it; its case is then done again"
            raise InputError(problem, source=self._path, where=f"line {number}", remedy=remedy) from None

    def _begin(self, whole: int) -> None:
        """Truncate an incomplete last line, and make sure that the file is on disk."""
        os.ftruncate(self._file, whole)
        if whole == 0:
            self._write(_HEADER + b"\n")
        folder = os.open(self._path.parent, os.O_RDONLY | os.O_CLOEXEC)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def _write(self, line: bytes) -> None:
        try:
            while line:
                line = line[os.write(self._file, line) :]
            os.fsync(self._file)
        except OSError as error:
            remedy = "make room on the disk and give the same command again to go on"
            raise self._error(f"cannot be written ({error.strerror})", remedy) from None

    def _error(self, problem: str, remedy: str) -> InputError:
        return InputError(problem, source=self._path, remedy=remedy)


def run_of(data: Any) -> CaseRun:
    """The run from its `asdict` data, without loss.

    Raises:
        ValueError: if it describes none.
    """
    if not isinstance(data, dict) or set(data) != {item.name for item in fields(CaseRun)}:
        raise ValueError("expected a result, seconds and attempts")
    result, seconds, attempts = data["result"], data["seconds"], data["attempts"]
    if not isinstance(result, dict) or set(result) != {item.name for item in fields(CaseResult)}:
        raise ValueError("expected a result with all its columns")
    if result["outcome"] not in get_args(Outcome) or not isinstance(result["reason"], str):
        raise ValueError("expected an outcome and a reason")
    if not isinstance(result["modes"], list) or not all(isinstance(mode, str) for mode in result["modes"]):
        raise ValueError("expected a list of modes")
    if not all(result[name] is None or _is_number(result[name]) for name in NUMBERS):
        raise ValueError("expected finite numbers")
    if not isinstance(seconds, dict) or not all(map(_is_number, seconds.values())) or type(attempts) is not int:
        raise ValueError("expected seconds and a count")
    return CaseRun(CaseResult(**{**result, "modes": tuple(result["modes"])}), seconds, attempts)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)
