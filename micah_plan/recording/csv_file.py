"""The recording CSV: one header line, comma separated, UTF-8, SI units, rows in time order.

Columns, in any order: ``t,x,y,z`` and optionally ``run``, ``part``, ``qx,qy,qz,qw``, ``ax,ay,az`` (empty only in the
last row of a run) and ``fx,fy,fz``. All others are kept as the text they are.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micah_plan.errors import InputError, located_in, shown
from micah_plan.files import replace_file
from micah_plan.recording.checks import (
    KNOWN,
    MAY_BE_EMPTY,
    NUMERIC,
    Place,
    check_header,
    checked,
    numeric_columns,
)
from micah_plan.recording.text import UnreadableValue, floats, integers, is_number, read_lines
from micah_plan.recording.value import COLUMNS, DEFAULT_PART, Recording


def read_csv(path: str | Path, *, minimum_rows: int = 1) -> Recording:
    """`read_recording` of a CSV file.

    Raises:
        InputError: with file, line, column and remedy, for whatever is not as the format says.
    """
    with located_in(path):
        names, rows, line_numbers = _table(read_lines(path))
        columns = dict(zip(names, zip(*rows, strict=True), strict=True))

        def place(row: int, column: str) -> str:
            return f"line {line_numbers[row]}, column {shown(column)}"

        return checked(_recording(columns, place), minimum_rows=minimum_rows, place=place)


def write_csv(recording: Recording, path: str | Path) -> None:
    """Write what `csv_bytes` makes, at once or not at all.

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
        columns = _texts(checked(recording))
    header = ",".join(_quoted(name) for name in columns)
    rows = (",".join(row) for row in zip(*columns.values(), strict=True))
    return ("\n".join((header, *rows)) + "\n").encode()


def _table(lines: list[str]) -> tuple[list[str], list[list[str]], list[int]]:
    """Column names, fields per row, and the line number of each row; blank lines are skipped."""
    filled = [number for number, line in enumerate(lines, start=1) if line and not line.isspace()]
    header, numbers = filled[0], filled[1:]
    raw = _fields(lines[header - 1], header)
    names = [name.strip() if name.strip() in KNOWN else name for name in raw]
    where = f"line {header}"
    if all(is_number(name) for name in names):
        problem = f"expected a header line, found {shown(','.join(raw))}"
        raise InputError(problem, where=where, remedy="put the names of the columns first, such as t,x,y,z")
    check_header(names, where=where)
    if not numbers:
        raise InputError("the header is followed by no rows", where=where, remedy="record at least one row")
    rows = [_fields(lines[number - 1], number) for number in numbers]
    for number, row in zip(numbers, rows, strict=True):
        if len(row) != len(names):
            problem = f"expected {len(names)} fields as in the header, found {len(row)}"
            remedy = "separate by commas, write numbers with a point, quote text that holds a comma"
            raise InputError(problem, where=f"line {number}", remedy=remedy)
    return names, rows, numbers


def _fields(line: str, number: int) -> list[str]:
    if '"' not in line:
        return line.split(",")
    try:
        return next(csv.reader([line], strict=True))
    except csv.Error as error:
        problem = f"a quoted field does not end on its line or is malformed ({error})"
        remedy = 'quote text as "a, b", double the quotes in it and keep it on one line'
        raise InputError(problem, where=f"line {number}", remedy=remedy) from None


def _recording(columns: Mapping[str, tuple[str, ...]], place: Place) -> Recording:
    """The columns as values; of several unreadable ones the first in the file is reported."""
    values: dict[str, NDArray[Any]] = {}
    unreadable: list[tuple[int, int, str, UnreadableValue]] = []
    for index, (name, texts) in enumerate(columns.items()):
        try:
            if name == "run":
                values[name] = integers(texts)
            elif name in NUMERIC:
                values[name] = floats(texts, may_be_empty=name in MAY_BE_EMPTY)
        except UnreadableValue as error:
            unreadable.append((error.row, index, name, error))
    if unreadable:
        row, _, name, found = min(unreadable, key=lambda item: item[:2])
        if columns[name][row].strip() == name:
            remedy = "keep one header line; join recordings by a column 'run'"
            raise InputError("a second header line", where=place(row, name), remedy=remedy)
        raise InputError(found.problem, where=place(row, name), remedy=found.remedy)

    given = {field: [values[name] for name in names] for field, names in COLUMNS.items() if names[0] in values}
    arrays = {field: np.stack(parts, axis=-1) if len(parts) > 1 else parts[0] for field, parts in given.items()}
    if "run" in columns:
        arrays["run"] = values["run"]
    return Recording(
        **arrays,
        part=columns.get("part", ()),
        has_run="run" in columns,
        has_part="part" in columns,
        extra={name: texts for name, texts in columns.items() if name not in KNOWN},
    )


def _texts(recording: Recording) -> dict[str, list[str]]:
    """The fields of every column, as the file holds them."""
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
