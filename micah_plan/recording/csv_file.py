"""The recording CSV: one header line, comma separated, UTF-8, SI units, rows in time order.

Columns, in any order: ``t,x,y,z`` and optionally ``run``, ``part``, ``qx,qy,qz,qw``, ``ax,ay,az`` (empty only in the
last row of a run) and ``fx,fy,fz``. All others are kept as the text they are. A row whose pose is empty is one in which
the tracker had lost the part. Tables of others are read by `conventions`.
"""

from __future__ import annotations

import csv
import math
import re
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from micah_plan.errors import InputError, located_in, shown
from micah_plan.files import replace_file
from micah_plan.recording.checks import (
    MAY_BE_EMPTY,
    NUMERIC,
    POSITION,
    QUATERNION,
    Place,
    check_header,
    checked_recording,
    numeric_columns,
)
from micah_plan.recording.columns import columns_by_name, recording_from, row_numbers
from micah_plan.recording.commands import TARGETS
from micah_plan.recording.conventions import (
    FIXED_ANGLES,
    ROTATION_VECTOR,
    TIMES,
    Conventions,
    as_recorded,
    without_gaps,
)
from micah_plan.recording.motion_capture import CaptureTable, motion_capture_table
from micah_plan.recording.text import UnreadableValue, floats, integers, is_number, read_lines, seconds
from micah_plan.recording.value import DEFAULT_PART, Recording

_SEPARATORS, _BLANKS = (",", ";", "\t"), " "
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")


def read_csv(path: str | Path, *, minimum_rows: int = 1, conventions: Conventions | None = None) -> Recording:
    """`read_recording` of a CSV file, also as Motive and Vicon write it.

    Raises:
        InputError: with file, line, column and remedy, for any violation of the format.
    """
    with located_in(path):
        lines, meant = read_lines(path), conventions or Conventions()
        exported = motion_capture_table(lines, is_upright=meant.up is not None)
        if exported is not None:
            meant.refuse_stated(("columns", "rate"), "an export of Motive or Vicon names its own columns and times")
        table = exported or _table(lines, meant)
        meant, line_numbers = meant.completed_by(table.conventions), table.line_numbers

        def place(row: int, column: str) -> str:
            return f"line {line_numbers[row]}, column {shown(table.called.get(column, column))}"

        read = replace(as_recorded(_recording(table, place, meant), meant), notes=table.notes)
        recording, kept = without_gaps(read)
        line_numbers = [line_numbers[i] for i in kept.tolist()]
        return checked_recording(recording, minimum_rows=minimum_rows, place=place)


def csv_columns(path: str | Path) -> dict[str, Any]:
    """All columns of a CSV file by name: (n,) numbers, NaN where empty, or strings.

    Raises:
        InputError: if it is none, or a name stands twice.
    """
    with located_in(path):
        names, rows, _ = _rows(read_lines(path))
        columns: dict[str, Any] = {}
        for name, texts in zip((name.strip() for name in names), zip(*rows, strict=True), strict=True):
            if name in columns:
                problem = f"column {shown(name)} appears twice"
                raise InputError(problem, where="line 1", remedy="rename or remove one of them")
            try:
                columns[name] = integers(texts) if name == "run" else floats(texts, may_be_empty=True)
            except UnreadableValue:
                columns[name] = texts
        return columns


def write_csv(recording: Recording, path: str | Path) -> None:
    """Write the output of `csv_bytes` atomically.

    Raises:
        InputError: also if the file cannot be written.
    """
    replace_file(path, csv_bytes(recording, path))


def csv_bytes(recording: Recording, path: str | Path) -> bytes:
    """The content of a recording CSV, so that reading it gives the same values to the last bit.

    Raises:
        InputError: if the recording is not one that could be read back.
    """
    with located_in(path):
        columns = _texts(checked_recording(recording))
    header = ",".join(_quoted(name) for name in columns)
    rows = (",".join(row) for row in zip(*columns.values(), strict=True))
    return ("\n".join((header, *rows)) + "\n").encode()


def _table(lines: list[str], meant: Conventions) -> CaptureTable:
    """The lines as columns and rows."""
    raw, rows, numbers = _rows(lines, are_numbered=bool(meant.columns))
    where = f"line {numbers[0]}"
    own, sources = columns_by_name(raw, meant, where)
    without_time = meant.rate is not None and "t" not in own
    check_header(["t", *own] if without_time else own, where=where)
    if not rows:
        raise InputError("the header is followed by no rows", where=where, remedy="record at least one row")
    columns = dict(zip(own, zip(*rows, strict=True), strict=True))
    if without_time:
        columns = {"t": tuple(map(repr, row_numbers(columns, len(rows)).tolist())), **columns}
    called = {ours: source.name for ours, source in sources.items()}
    further = meant.columns.keys() & {*ROTATION_VECTOR, *FIXED_ANGLES, *TARGETS}
    return CaptureTable(columns, numbers[1:], sources=sources, called=called, numbers=frozenset(further))


def _rows(lines: list[str], *, are_numbered: bool = False) -> tuple[list[str], list[list[str]], list[int]]:
    """(names, fields of each row, line numbers), skipping blank lines and leading comments."""
    filled = [number for number, line in enumerate(lines, start=1) if line and not line.isspace()]
    comments = list(takewhile(lambda number: lines[number - 1].lstrip().startswith("#"), filled))
    filled = filled[len(comments) :]
    if not filled:
        raise InputError("the file has only comments", where=f"line {comments[-1]}", remedy="record at least one row")
    header, numbers = filled[0], filled[1:]
    separator = _separator(lines[header - 1])

    def fields(number: int) -> list[str]:
        return _fields(lines[number - 1], number, separator)

    raw = fields(header)
    if comments and all(is_number(name) for name in raw):  # NumPy writes the names as a comment
        header, numbers = comments[-1], filled
        raw = _fields(lines[header - 1].lstrip(" \t#"), header, separator)
    if all(is_number(name) for name in raw) and are_numbered:
        numbers, raw = filled, [str(number) for number in range(1, len(raw) + 1)]
    elif all(is_number(name) for name in raw):
        problem = f"expected a header line, found {shown(','.join(raw))}"
        remedy = (
            "put the names of the columns first, such as t,x,y,z, or give them by number: --columns t=1,x=2,y=3,z=4"
        )
        raise InputError(problem, where=f"line {header}", remedy=remedy)
    rows = [fields(number) for number in numbers]
    for number, row in zip(numbers, rows, strict=True):
        if len(row) != len(raw):
            problem = f"expected {len(raw)} fields as in the header, found {len(row)}"
            remedy = "separate by commas, write numbers with a point, quote text that holds a comma"
            raise InputError(problem, where=f"line {number}", remedy=remedy)
    return raw, rows, [header, *numbers]


def _separator(header: str) -> str:
    """The separator of a header: the first usual one that occurs in it, else blanks."""
    blank = _BLANKS if len(header.split()) > 1 else ","
    return next((separator for separator in _SEPARATORS if separator in header), blank)


def _fields(line: str, number: int, separator: str) -> list[str]:
    """The fields of a line; decimal commas are accepted where commas are not the separator."""
    if separator != ",":
        texts = line.split() if separator == _BLANKS else line.split(separator)
        return [text.replace(",", ".") if _DECIMAL_COMMA.fullmatch(text.strip()) else text for text in texts]
    if '"' not in line:
        return line.split(",")
    try:
        return next(csv.reader([line], strict=True))
    except csv.Error as error:
        problem = f"a quoted field does not end on its line or is malformed ({error})"
        remedy = 'quote text as "a, b", double the quotes in it and keep it on one line'
        raise InputError(problem, where=f"line {number}", remedy=remedy) from None


def _recording(table: CaptureTable, place: Place, meant: Conventions) -> Recording:
    """The columns as values; of several unreadable ones the first in the file is reported."""
    columns, values = table.columns, dict[str, NDArray[Any]]()
    may_be_lost = {*POSITION, *QUATERNION, *table.numbers}
    unreadable: list[tuple[int, int, str, UnreadableValue]] = []
    for index, (name, texts) in enumerate(columns.items()):
        try:
            if name == "run":
                values[name] = integers(texts)
            elif name in may_be_lost:
                values[name] = floats(
                    ["" if text.strip().lower() == "nan" else text for text in texts], may_be_empty=True
                )
            elif name == "t":
                values[name] = seconds(texts, TIMES[meant.time or "s"])
            elif name in NUMERIC:
                values[name] = floats(texts, may_be_empty=name in MAY_BE_EMPTY)
            if name in table.sources and not table.sources[name].is_plain and name in values and name != "run":
                values[name] = table.sources[name].values(values[name])
        except UnreadableValue as error:
            unreadable.append((error.row, index, name, error))
    if unreadable:
        row, _, name, cell = min(unreadable, key=lambda item: item[:2])
        if columns[name][row].strip() == name:
            remedy = "keep one header line; join recordings by a column 'run'"
            raise InputError("a second header line", where=place(row, name), remedy=remedy)
        raise InputError(cell.problem, where=place(row, name), remedy=cell.remedy)

    return recording_from(values, {name: texts for name, texts in columns.items() if name not in values}, meant)


def _texts(recording: Recording) -> dict[str, list[str]]:
    """Fields of every column as strings for the file."""
    columns: dict[str, list[str]] = {}
    if recording.has_run or recording.run.any():
        columns["run"] = [str(run) for run in recording.run.tolist()]
    if recording.has_part or recording.parts != (DEFAULT_PART,):
        columns["part"] = [_quoted(name) for name in recording.part]
    for name, array in numeric_columns(recording):
        columns[name] = ["" if math.isnan(value) else repr(value) for value in array.tolist()]
    for name, texts in recording.extra.items():
        columns[name] = [_quoted(text) for text in texts]
    return columns


def _quoted(text: str) -> str:
    return '"' + text.replace('"', '""') + '"' if '"' in text or "," in text else text
