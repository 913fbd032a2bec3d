"""Text files as numbered lines, and strings as numbers."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from micah_plan.errors import InputError, shown
from micah_plan.files import read_bytes

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_INTEGER = re.compile(r"[+-]?\d{1,18}", re.ASCII)
_END_OF_LINE = re.compile(r"\r\n|\n|\r")


def read_lines(path: str | Path) -> list[str]:
    """The lines of a UTF-8 file, without their ends (LF, CRLF or CR) and without a byte order mark.

    Raises:
        InputError: if the file cannot be read, is empty, binary or not UTF-8, with the line where that shows.
    """
    data = read_bytes(path)
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError("expected UTF-8, found UTF-16", source=path, where="line 1", remedy="save the file as UTF-8")
    nul = data.find(b"\0")
    if nul >= 0:
        where = f"line {_line_of(data, nul)}"
        raise InputError("expected text, found a binary file", source=path, where=where, remedy="choose the text file")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        where = f"line {_line_of(error.object, error.start)}"
        problem = f"expected UTF-8 text, found the byte 0x{error.object[error.start]:02x}"
        raise InputError(problem, source=path, where=where, remedy="save the file as UTF-8") from None
    if not text.strip():
        raise InputError("the file is empty", source=path, where="line 1", remedy="write a recording into it")
    return _END_OF_LINE.split(text)  # not str.splitlines, which also splits at characters a name may hold


def _line_of(data: bytes, offset: int) -> int:
    """The number of the line, from 1, of a byte offset."""
    return len(re.findall(rb"\r\n|\n|\r", data[:offset])) + 1


@dataclass(eq=False)
class UnreadableValue(Exception):  # noqa: N818 - the value is at fault; it becomes an InputError once its place is known
    """A string that is not a number: its row in the column, the problem and the remedy."""

    row: int
    problem: str
    remedy: str


def floats(texts: Sequence[str], *, may_be_empty: bool = False) -> NDArray[np.float64]:
    """Numbers from decimal strings of a column; NaN for empty strings where allowed.

    Raises:
        UnreadableValue: for the first text that is not one finite number.
    """
    values = _plain_floats(texts, may_be_empty)
    if values is not None:
        return values
    return np.array([_float(row, text.strip(), may_be_empty) for row, text in enumerate(texts)])


def seconds(texts: Sequence[str], unit: float) -> NDArray[np.float64]:
    """Times in units of `unit` seconds: numbers, or ISO 8601 times since 1970 (UTC by default).

    Raises:
        UnreadableValue: for the first text that is neither.
    """
    try:
        return floats(texts)
    except UnreadableValue as unreadable:
        try:
            moments = [datetime.fromisoformat(text.strip()) for text in texts]
        except ValueError:
            raise unreadable from None
    return np.array([(each if each.tzinfo else each.replace(tzinfo=UTC)).timestamp() for each in moments]) / unit


def _plain_floats(texts: Sequence[str], may_be_empty: bool) -> NDArray[np.float64] | None:
    """Fast path of `floats` for valid columns; None otherwise."""
    try:
        values = np.array([np.nan if may_be_empty and not text else float(text) for text in texts])
    except ValueError:
        return None
    joined = "".join(texts)
    if "_" in joined or not joined.isascii():  # float() takes 1_000 and digits of other scripts
        return None
    empty = sum(not text for text in texts) if may_be_empty else 0
    return values if np.count_nonzero(~np.isfinite(values)) == empty else None


def _float(row: int, text: str, may_be_empty: bool) -> float:
    """The number of a cell, NaN if it may be and is empty."""
    if may_be_empty and not text:
        return float("nan")
    expected, remedy = "a number", "fill in the value or remove the row"
    if text.lower().lstrip("+-") in {"nan", "inf", "infinity"}:
        expected = "a finite number"
    elif text and not is_number(text):
        remedy = "write a decimal number such as 0.25"
    elif text:
        value = float(text)
        if np.isfinite(value):
            return value
        expected, remedy = "a number in range", "give measured values in SI units"
    raise UnreadableValue(row, f"expected {expected}, found {shown(text) if text else 'nothing'}", remedy)


def is_number(text: str) -> bool:
    """Whether the text spells a number in decimal."""
    return _NUMBER.fullmatch(text.strip()) is not None


def integers(texts: Sequence[str]) -> NDArray[np.int64]:
    """The integers that a column of texts spells in decimal.

    Raises:
        UnreadableValue: for the first text that is not an integer of at most 18 digits.
    """
    for row, text in enumerate(texts):
        if not _INTEGER.fullmatch(text.strip()):
            problem = f"expected an integer of at most 18 digits, found {shown(text)}"
            raise UnreadableValue(row, problem, "number the runs 0, 1, 2 and so on")
    return np.array([int(text) for text in texts], dtype=np.int64)
