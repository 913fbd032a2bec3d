"""Tables as recordings: columns by name, from files or programs, under conventions."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micah_plan.errors import InputError, choices, shown
from micah_plan.recording.checks import KNOWN, NUMERIC, check_header
from micah_plan.recording.commands import TARGETS, with_targets
from micah_plan.recording.conventions import (
    FIXED_ANGLES,
    ROTATION_VECTOR,
    TIMES,
    ColumnSource,
    Conventions,
    as_recorded,
    source_of,
    turns_of,
    without_gaps,
)
from micah_plan.recording.text import UnreadableValue, is_number, seconds
from micah_plan.recording.value import COLUMNS, Recording

Columns = Mapping[str, Any]
"""Columns by name: (n,) or (n, k) numbers, or (n,) texts."""


def recording_of_columns(columns: Columns, conventions: Conventions | None = None) -> Recording:
    """The recording of a table with the columns of a recording CSV, or with names given by conventions.

    Args:
        columns: (n,) numbers and texts; times may be ``datetime64``, which become seconds since 1970.
        conventions: None: those of a recording.

    Raises:
        InputError: if columns are missing, of other lengths, or hold no numbers; in whose rows is left to `checks`.
    """
    meant = conventions or Conventions()
    names, sources = columns_by_name(list(columns), meant)
    unit = TIMES[meant.time or "s"]
    table = {name: _plain(values, unit) for name, values in zip(names, columns.values(), strict=True)}
    times = table.get("t")
    if isinstance(times, tuple) and not any(map(is_number, times)):  # numbers as texts are a mistake of the table
        table["t"] = _times_of_texts(times, unit)
    lengths = {name: len(values) for name, values in table.items()}
    if len(set(lengths.values())) > 1:
        shortest, longest = min(lengths, key=lengths.__getitem__), max(lengths, key=lengths.__getitem__)
        problem = f"expected columns of one length, found {lengths[shortest]} rows of {shown(shortest)} and"
        raise InputError(f"{problem} {lengths[longest]} of {shown(longest)}", remedy="give every row of every column")
    if meant.rate is not None and "t" not in table:
        table = {"t": row_numbers(table, len(next(iter(table.values()), ()))), **table}
    check_header(list(table), where="")
    further = meant.columns.keys() & {*ROTATION_VECTOR, *FIXED_ANGLES, *TARGETS}
    for name in (*NUMERIC, *sorted(further), "run"):
        if name in table:
            _check_numbers(name, table[name], "iu" if name == "run" else "iuf")
    values = {name: np.asarray(table[name]) for name in (*NUMERIC, *further, "run") if name in table}
    values |= {name: sources[name].values(values[name]) for name in sources.keys() & values.keys()}
    columns_of_values = recording_from(
        values, {name: column for name, column in table.items() if name not in values}, meant
    )
    return without_gaps(as_recorded(columns_of_values, meant))[0]


def recording_from(values: Mapping[str, NDArray[Any]], others: Columns, meant: Conventions) -> Recording:
    """The recording of some columns.

    Args:
        values: (n,) numbers of those with numbers, of targets, and of ``run``.
        others: ``part``, and columns without a meaning.
        meant: where an orientation is no quaternion, the unit of its angles.
    """
    arrays: dict[str, Any] = {
        field: np.stack([values[name] for name in names], axis=-1) if len(names) > 1 else values[names[0]]
        for field, names in COLUMNS.items()
        if names[0] in values
    }
    if "run" in values:
        arrays["run"] = values["run"]
    turned = turns_of(values, meant.angle)
    if turned is not None:
        arrays["quaternion"] = turned
    recording = Recording(
        **arrays,
        part=tuple(others["part"]) if "part" in others else (),
        has_run="run" in values,
        has_part="part" in others,
        extra=as_texts({name: column for name, column in others.items() if name != "part"}),
    )
    if TARGETS[0] not in values:
        return recording
    return with_targets(recording, np.stack([np.asarray(values[name], dtype=float) for name in TARGETS], axis=-1))


def columns_by_name(
    raw: Sequence[str], meant: Conventions, where: str = ""
) -> tuple[list[str], dict[str, ColumnSource]]:
    """(recording names of columns, sources of their numbers); other columns keep their names.

    Args:
        raw: names in the order of the columns.
        meant: the file's conventions, with their names.
        where: place of the names, for messages.

    Raises:
        InputError: for a name that is not there, and for a column that is named twice.
    """
    stripped = [name.strip() for name in raw]
    ours: dict[str, str] = {}
    sources: dict[str, ColumnSource] = {}
    for wanted, text in meant.columns.items():
        sources[wanted] = source_of(text, stripped)
        name = sources[wanted].name
        if name not in stripped:
            problem = f"there is no column {shown(name)} to read as {wanted}"
            raise InputError(problem, where=where, remedy=choices(name, stripped))
        if name in ours:
            problem = f"column {shown(name)} is read as {ours[name]} and as {wanted}"
            raise InputError(problem, where=where, remedy="name each column once")
        ours[name] = wanted
    # Of a known name blanks do not count; further columns keep theirs.
    plain = [name if name in KNOWN else text for name, text in zip(stripped, raw, strict=True)]
    pairs = zip(stripped, plain, strict=True)
    names = [ours.get(name, f"{name} of the file" if name in meant.columns else text) for name, text in pairs]
    return names, sources


def row_numbers(columns: Columns, rows: int) -> NDArray[np.float64]:
    """(n,) index of each row within its run and part, from 0."""
    numbers: Counter[tuple[Any, ...]] = Counter()
    values = np.empty(rows)
    for i, group in enumerate(zip(*(columns.get(name, ("",) * rows) for name in ("run", "part")), strict=True)):
        values[i] = numbers[group]
        numbers[group] += 1
    return values


def as_texts(columns: Columns) -> dict[str, tuple[str, ...]]:
    """Further columns as strings; empty for NaN; each entry of a vector is a column."""
    plain = {name: part for key, values in columns.items() for name, part in entry_columns(key, values).items()}
    return {
        name: values if isinstance(values, tuple) else tuple("" if math.isnan(v) else repr(v) for v in values.tolist())
        for name, values in plain.items()
    }


def entry_columns(key: str, values: Any) -> dict[str, Any]:
    """A vector column as scalar columns, numbered where entries have no names."""
    if isinstance(values, tuple) or values.ndim == 1:
        return {key: values}
    return {f"{key}.{i}": entry for i, entry in enumerate(values.T)}


def _plain(values: Any, unit: float) -> NDArray[Any] | tuple[str, ...]:
    """Numbers as an array, times and durations in units of `unit` seconds, other columns as strings."""
    if isinstance(values, tuple) and all(isinstance(value, str) for value in values):
        return values
    array = np.atleast_1d(np.asarray(values))
    if array.dtype.kind == "M":
        return array.astype("datetime64[ns]").astype(np.int64) / 1e9 / unit
    if array.dtype.kind == "m":
        return array.astype("timedelta64[ns]").astype(np.int64) / 1e9 / unit
    if array.dtype.kind in "iuf":
        return array
    if array.dtype.kind == "b":
        return array.astype(int)
    return tuple("" if value is None else str(value) for value in array.ravel().tolist())


def _times_of_texts(texts: Sequence[str], unit: float) -> NDArray[np.float64]:
    """Times in units of `unit` seconds from strings such as ISO 8601 (see `text.seconds`)."""
    try:
        return seconds(texts, unit)
    except UnreadableValue as error:
        raise InputError(error.problem, where=f"row {error.row + 1}, column 't'", remedy=error.remedy) from None


def _check_numbers(name: str, values: Any, kinds: str) -> None:
    if isinstance(values, tuple) or values.ndim != 1 or values.dtype.kind not in kinds:
        expected = "integers" if name == "run" else "numbers"
        raise InputError(f"expected {expected} in the column {shown(name)}", remedy="convert it before saving")
    if name == "run" and values.size and int(values.max()) > np.iinfo(np.int64).max:
        raise InputError("expected run numbers of at most 63 bits", remedy="number the runs 0, 1, 2 and so on")
