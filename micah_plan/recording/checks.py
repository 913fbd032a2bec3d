"""Validation of recordings from any file: column names, finite values, time order, unit quaternions, actions."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import replace

import numpy as np

from micah_plan.arrays import TINY, Floats
from micah_plan.errors import InputError, shown
from micah_plan.recording.commands import command_meaning
from micah_plan.recording.value import COLUMNS, Recording

Place = Callable[[int, str], str]
"""How a message names row i (0-based) and column c, e.g. "line 7, column 'x'"."""

TIME, POSITION, QUATERNION, ACTION, FORCE = COLUMNS.values()
REQUIRED = (*TIME, *POSITION)
OPTIONAL_GROUPS = (QUATERNION, ACTION, FORCE)
NUMERIC = (*REQUIRED, *QUATERNION, *ACTION, *FORCE)
KNOWN = ("run", "part", *NUMERIC)
MAY_BE_EMPTY = frozenset((*ACTION, *FORCE))

# Beyond these a number is a mistake of units or of columns, not a measurement: 30 000 years, 1000 km, 1 GN.
LARGEST = {
    "t": 1e12,
    **dict.fromkeys((*POSITION, *QUATERNION, *ACTION), 1e6),
    **dict.fromkeys(FORCE, 1e9),
}

_HEADER_REMEDY = (
    "the first line names the columns t,x,y,z and optionally run, part, qx..qw, ax..az, fx..fz; "
    "give other names by --columns t=Time,x=TX,y=TY,z=TZ"
)

MOST_PARTS = 1000
NORM_TOLERANCE = 0.01 + 1e-12  # a norm of 0.99 is within 1 %, though 1 - 0.99 rounds to more than 0.01
# No file format here can hold these in a text: line breaks, NUL and halves of surrogate pairs.
_UNSTORABLE = re.compile(r"[\0\r\n\ud800-\udfff]")


def row_and_column(row: int, column: str) -> str:
    """A place in a recording that is no text file; rows count from 0 as in NumPy."""
    return f"row {row}, column {shown(column)}"


def checked_recording(recording: Recording, *, minimum_rows: int = 1, place: Place = row_and_column) -> Recording:
    """The recording with normalised quaternions, after validation of its rows.

    Args:
        recording: the rows as they were found.
        minimum_rows: rows that every run needs of each of its parts.
        place: how messages name a row and column.

    Raises:
        InputError: for the first value out of range, the first quaternion whose norm is off by more than 1 %, the first
            time that does not increase within a run and part, the first misplaced empty action and the first run that
            is too short. Where it is, is in the error; the file is left to the caller.
    """
    _check_texts(recording, place)
    command_meaning(recording)
    _check_values(recording, place)
    _check_rows(recording, minimum_rows, place)
    if recording.quaternion is None:
        return recording
    return replace(recording, quaternion=_normalised(recording.quaternion, place))


def check_header(names: Collection[str], where: str) -> None:
    """Refuse incomplete columns: repeated names, missing required ones, partial groups.

    Args:
        names: as they stand in the file.
        where: the place of the header, for messages, e.g. ``"line 1"``.

    Raises:
        InputError: with the column that is at fault; the file is left to the caller.
    """
    for name, times in Counter(names).items():
        if times > 1:
            raise InputError(f"column {shown(name)} appears twice", where=where, remedy="rename or remove one of them")
    for name in REQUIRED:
        if name not in names:
            problem = f"column '{name}' is missing, found {shown(','.join(names))}"
            raise InputError(problem, where=where, remedy=_HEADER_REMEDY)
    for group in OPTIONAL_GROUPS:
        missing = [name for name in group if name not in names]
        if missing and len(missing) < len(group):
            present = next(name for name in group if name in names)
            problem = f"column '{missing[0]}' is missing although '{present}' is there"
            raise InputError(problem, where=where, remedy=f"add it or remove all of {','.join(group)}")


def numeric_columns(recording: Recording) -> list[tuple[str, Floats]]:
    """The numeric columns that the recording has, in the order of the format: name and (n,) values."""
    arrays = ((names, getattr(recording, field)) for field, names in COLUMNS.items())
    return [pair for names, a in arrays if a is not None for pair in zip(names, np.atleast_2d(a.T), strict=True)]


def _check_texts(recording: Recording, place: Place) -> None:
    for name, texts in (("part", recording.part), *recording.extra.items()):
        if (name != "part" and name.strip() in KNOWN) or _UNSTORABLE.search(name):
            raise InputError(f"{shown(name)} is no name that an extra column can have", remedy="rename it")
        if _UNSTORABLE.search("".join(texts)):
            row = next(i for i, text in enumerate(texts) if _UNSTORABLE.search(text))
            problem = f"expected text on one line, found {shown(texts[row])}"
            raise InputError(problem, where=place(row, name), remedy="remove its line breaks and NUL characters")
    if len(recording.parts) > MOST_PARTS:
        problem = f"expected at most {MOST_PARTS} parts, found {len(recording.parts)}"
        raise InputError(problem, remedy="name the parts, not the rows")
    empty = next((i for i, part in enumerate(recording.part) if not part.strip()), None)
    if empty is not None:
        raise InputError("the name of the part is empty", where=place(empty, "part"), remedy="name the part")


def _check_values(recording: Recording, place: Place) -> None:
    for name, values in numeric_columns(recording):
        good = np.abs(values) <= LARGEST[name]  # false for NaN and infinity
        if name in MAY_BE_EMPTY:
            good |= np.isnan(values)
        if not good.all():
            row = int(np.argmin(good))
            if np.isnan(values[row]) and name in (*POSITION, *QUATERNION):
                problem = "expected a number, found none although the pose has others"
                remedy = "fill in the value, or empty the whole pose where the part was lost"
                raise InputError(problem, where=place(row, name), remedy=remedy)
            problem = f"expected a finite number of at most {LARGEST[name]:g} in size, found {values[row]:g}"
            raise InputError(problem, where=place(row, name), remedy="give measured values in SI units (s, m, N)")
    for names, array in ((ACTION, recording.action), (FORCE, recording.force)):
        if array is None:
            continue
        empty = np.isnan(array)
        partly = empty.any(axis=1) & ~empty.all(axis=1)
        if partly.any():
            row = int(np.argmax(partly))
            column = names[int(np.argmax(empty[row]))]
            cells = "some of them filled" if empty[row].sum() > 1 else f"'{column}' empty"
            problem = f"expected {','.join(names)} all filled or all empty, found only {cells}"
            raise InputError(problem, where=place(row, column), remedy="fill in the others or empty all three")


def _check_rows(recording: Recording, minimum_rows: int, place: Place) -> None:
    """Refuse invalid times, actions or numbers of rows within a run and part."""
    if not len(recording):
        raise InputError("expected rows of measurements, found none", remedy="record at least one row")
    numbers: dict[tuple[int, str], int] = {}
    keys = zip(recording.run.tolist(), recording.part, strict=True)
    group = np.array([numbers.setdefault(key, len(numbers)) for key in keys])
    order, sizes = np.argsort(group, kind="stable"), np.bincount(group)
    last = order[np.cumsum(sizes) - 1]
    step = np.diff(recording.time[order], prepend=0.0)
    step[np.cumsum(sizes) - sizes] = 1.0
    if (step <= 0.0).any():
        at = min(np.flatnonzero(step <= 0.0), key=lambda i: order[i])
        row, before = int(order[at]), int(order[at - 1])
        how = "stands still" if step[at] == 0.0 else "goes backwards"
        problem = f"time {how}: {float(recording.time[row])!r} s after {float(recording.time[before])!r} s"
        remedy = "sort the rows by time, drop repeated rows, or give each run its number in a column 'run'"
        raise InputError(problem + _of(recording, row), where=place(row, "t"), remedy=remedy)
    if recording.action is not None:
        empty = np.isnan(recording.action[:, 0])
        empty[last] = False
        if empty.any():
            row = int(np.argmax(empty))
            problem = "the action is empty, which is only allowed in the last row of a run" + _of(recording, row)
            remedy = "fill in the commanded displacement (0 without a command) or remove ax,ay,az"
            raise InputError(problem, where=place(row, ACTION[0]), remedy=remedy)
    if (sizes < minimum_rows).any():
        short = int(np.argmax(sizes < minimum_rows))
        row = int(last[short])
        problem = f"expected at least {minimum_rows} rows, found {sizes[short]}" + _of(recording, row)
        raise InputError(problem, where=place(row, "t"), remedy="record a longer motion or leave these rows out")


def _normalised(quaternion: Floats, place: Place) -> Floats:
    """(n, 4) unit quaternions; an InputError names the first that is not nearly one."""
    norm = np.linalg.norm(quaternion, axis=1)
    off = np.abs(norm - 1.0)
    if (off > NORM_TOLERANCE).any():
        row = int(np.argmax(off > NORM_TOLERANCE))
        problem = f"expected a unit quaternion, found the norm {norm[row]:.6g}"
        remedy = "give the measured orientation, scalar last, or remove qx,qy,qz,qw if it was not measured"
        raise InputError(problem, where=place(row, QUATERNION[0]), remedy=remedy)
    scale = np.where(off > TINY, norm, 1.0)
    return np.asarray(quaternion / scale[:, None])


def _of(recording: Recording, row: int) -> str:
    """The run and part of a row for messages, where the recording distinguishes them."""
    names = [f"run {recording.run[row]}"] if recording.has_run else []
    names += [f"part {shown(recording.part[row])}"] if recording.has_part else []
    return f" ({', '.join(names)})" if names else ""
