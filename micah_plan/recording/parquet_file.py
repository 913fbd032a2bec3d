"""Recordings from Parquet files: tables with the columns of a recording CSV, and episodes of LeRobot data sets.

A LeRobot file (format 2.x or 3.0, ``data/chunk-000/*.parquet``) has an episode in ``episode_index``, its time in
``timestamp``, and vectors whose entries ``meta/info.json`` of the data set names. Entries of ``observation.*`` called
``x, y, z`` and ``qx, qy, qz, qw`` or ``wx, wy, wz`` (a rotation vector) are the pose of a part, those of ``action``
called ``x, y, z`` the commanded place, or, called ``delta_x, delta_y, delta_z``, the displacement. The text before the
last dot is the name of the part: ``ee.x`` is the x of the part ``ee``. All other numbers are further columns, images
are left out. Reads with pyarrow (extra ``parquet``).
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micah_plan.arrays import Floats
from micah_plan.errors import InputError, MissingDependencyError, located_in, shown
from micah_plan.files import LARGEST_FILE_BYTES, read_bytes
from micah_plan.recording.checks import POSITION, QUATERNION, checked_recording
from micah_plan.recording.columns import Columns, as_texts, entry_columns, recording_of_columns
from micah_plan.recording.conventions import Conventions, as_recorded
from micah_plan.recording.value import COLUMNS, DEFAULT_PART, Recording

_INFO = Path("meta", "info.json")
_ROTATION_VECTOR = ("wx", "wy", "wz")
_DISPLACEMENT = ("delta_x", "delta_y", "delta_z")
_COUNTED = ("timestamp", "episode_index", "frame_index", "index", "task_index")
_LARGEST_INFO_BYTES = 1024 * 1024


def read_parquet(path: str | Path, *, minimum_rows: int = 1, conventions: Conventions | None = None) -> Recording:
    """`read_recording` of a Parquet file.

    Raises:
        InputError: if it is no Parquet file, has neither the columns of a recording nor a pose with names, or more rows
            than a reader takes.
        MissingDependencyError: without the extra ``parquet``.
    """
    with located_in(path):
        table = _table(read_bytes(path))
        if "episode_index" not in table:
            return checked_recording(recording_of_columns(table, conventions), minimum_rows=minimum_rows)
        meant = conventions or Conventions()
        meant.refuse_stated(("columns", "rate"), "the episodes of LeRobot name their columns and times")
        return checked_recording(as_recorded(_episodes(table, _names(Path(path))), meant), minimum_rows=minimum_rows)


def parquet_columns(path: str | Path) -> dict[str, Any]:
    """All columns of a Parquet file by name, vectors by entry; LeRobot's with entry names, time ``t`` and ``run``.

    Raises:
        InputError: if it is no Parquet file.
        MissingDependencyError: without the extra ``parquet``.
    """
    with located_in(path):
        table, names = _table(read_bytes(path)), _names(Path(path))
    called = {"timestamp": "t", "episode_index": "run"} if "episode_index" in table else {}
    columns: dict[str, Any] = {}
    for key, values in table.items():
        shape_names = names.get(key, ())
        if not isinstance(values, tuple) and values.ndim == 2 and len(shape_names) == values.shape[1]:
            columns |= {f"{key}.{name}": entry for name, entry in zip(shape_names, values.T, strict=True)}
        else:
            columns |= entry_columns(called.get(key, key), values)
    return columns


def _table(data: bytes) -> Columns:
    """All columns of numbers, vectors of numbers and texts."""
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        raise MissingDependencyError.of("parquet", ".parquet files need a library that is not installed") from None
    try:
        file = parquet.ParquetFile(io.BytesIO(data))
        groups = [file.metadata.row_group(i) for i in range(file.metadata.num_row_groups)]
        columns = [group.column(i) for group in groups for i in range(group.num_columns)]
        size = sum(max(column.total_uncompressed_size, 8 * column.num_values) for column in columns)
        if size > LARGEST_FILE_BYTES:
            limit = LARGEST_FILE_BYTES // 1024 // 1024
            raise InputError(f"expected at most {limit} MiB of values, found {size} bytes", remedy="split the file")
        columns_read = {
            name: _column(pyarrow, file.read(columns=[name]).column(name)) for name in file.schema_arrow.names
        }
    except InputError:
        raise
    except Exception as error:  # damaged files raise nearly anything
        problem = f"expected a Parquet file, found one that cannot be read ({shown(str(error))})"
        raise InputError(problem, remedy="write it again") from None
    return {name: values for name, values in columns_read.items() if values is not None}


def _column(pyarrow: Any, column: Any) -> NDArray[Any] | tuple[str, ...] | None:
    """The values of a column; None unless numbers, equally long vectors, or strings."""
    kind = column.type
    if pyarrow.types.is_string(kind) or pyarrow.types.is_large_string(kind):
        return tuple("" if text is None else text for text in column.to_pylist())
    if pyarrow.types.is_integer(kind) and not column.null_count:
        return np.asarray(column.to_numpy())
    if pyarrow.types.is_integer(kind) or pyarrow.types.is_floating(kind):
        return np.asarray(column.to_numpy(), dtype=float)
    is_list = pyarrow.types.is_list(kind) or pyarrow.types.is_large_list(kind) or pyarrow.types.is_fixed_size_list(kind)
    if not is_list or not (pyarrow.types.is_floating(kind.value_type) or pyarrow.types.is_integer(kind.value_type)):
        return None
    rows = column.to_pylist()
    if any(row is None or len(row) != len(rows[0]) for row in rows):
        return None
    return np.array(rows, dtype=float).reshape(len(rows), -1)


def _names(path: Path) -> Mapping[str, Sequence[str]]:
    """Entry names of each vector, from the data set's description; empty without one."""
    root = next((folder for folder in path.absolute().parents[:4] if (folder / _INFO).is_file()), None)
    if root is None:
        return {}
    try:
        features = json.loads(read_bytes(root / _INFO, _LARGEST_INFO_BYTES))["features"]
        named = {key: value.get("names") for key, value in features.items()}
    except (ValueError, KeyError, AttributeError, TypeError, RecursionError):
        problem = "expected the description of a LeRobot data set with its features"
        raise InputError(problem, source=root / _INFO, remedy="correct the file") from None
    # Some have them in a dictionary of one list: {"motors": [...]}.
    lists = {
        key: next(iter(entries.values()), None) if isinstance(entries, dict) else entries
        for key, entries in named.items()
    }
    return {key: [str(name) for name in entries] for key, entries in lists.items() if isinstance(entries, list)}


def _episodes(table: Columns, names: Mapping[str, Sequence[str]]) -> Recording:
    """The recording of a LeRobot table."""
    for key in ("timestamp", "episode_index"):
        if key not in table or isinstance(table[key], tuple) or table[key].ndim != 1:
            raise InputError(f"expected numbers in the column {shown(key)}", remedy="give a file of a LeRobot data set")
    if int(table["episode_index"].max(initial=0)) > np.iinfo(np.int64).max:
        raise InputError("expected numbers of episodes of at most 63 bits", remedy="number them 0, 1, 2 and so on")
    states, commanded, rest = dict[str, dict[str, Floats]](), dict[str, dict[str, Floats]](), dict[str, Any]()
    for key, values in table.items():
        if key in _COUNTED:
            continue
        shape_names = names.get(key, ())
        if isinstance(values, tuple) or values.ndim == 1 or len(shape_names) != values.shape[1]:
            rest |= entry_columns(key, values)
            continue
        target = commanded if key == "action" else states if key.startswith("observation") else {}
        for name, entry in zip(shape_names, values.T, strict=True):
            part, _, axis = name.rpartition(".")
            target.setdefault(part, {})[axis] = entry
            if axis not in (*POSITION, *QUATERNION, *_ROTATION_VECTOR, *_DISPLACEMENT):
                rest[f"{key}.{name}"] = entry
    parts = [part for part, axes in states.items() if all(axis in axes for axis in POSITION)]
    if not parts:
        description = ", ".join(
            f"{key}: {' '.join(entries)}" for key, entries in names.items() if key.startswith("observation")
        )
        problem = "expected the pose of a part, as entries x, y, z of an observation"
        found = f"names {shown(description)}" if description else f"no names of entries in {_INFO} above the file"
        raise InputError(
            f"{problem}; found {found}",
            remedy="name them, or name the robot of these joints: --robot",
        )
    both = [_of_part(table, part, states[part], commanded.get(part, {}), rest) for part in parts]
    return both[0] if len(both) == 1 else _joined(both)


def _of_part(
    table: Columns, part: str, pose: Mapping[str, Floats], command: Mapping[str, Floats], rest: Columns
) -> Recording:
    position = np.column_stack([pose[axis] for axis in POSITION])
    quaternion, action = None, None
    if all(axis in pose for axis in QUATERNION):
        quaternion = np.column_stack([pose[axis] for axis in QUATERNION])
    elif all(axis in pose for axis in _ROTATION_VECTOR):
        half = np.column_stack([pose[axis] for axis in _ROTATION_VECTOR]) / 2.0
        angle = np.linalg.norm(half, axis=1, keepdims=True)
        quaternion = np.hstack([half * np.sinc(angle / np.pi), np.cos(angle)])
    if all(axis in command for axis in _DISPLACEMENT):
        action = np.column_stack([command[axis] for axis in _DISPLACEMENT])
    elif all(axis in command for axis in POSITION):
        action = np.column_stack([command[axis] for axis in POSITION]) - position
    return Recording(
        time=table["timestamp"],
        position=position,
        quaternion=quaternion,
        action=action,
        run=table["episode_index"],
        part=(part or DEFAULT_PART,) * len(position),
        has_run=True,
        has_part=bool(part),
        extra=as_texts(rest),
    )


def _joined(recordings: Sequence[Recording]) -> Recording:
    """The rows of several parts concatenated, with the columns that all have."""

    def all_of(name: str) -> NDArray[Any] | None:
        arrays = [getattr(recording, name) for recording in recordings]
        return None if any(array is None for array in arrays) else np.concatenate(arrays)

    extra = {name: sum((recording.extra[name] for recording in recordings), ()) for name in recordings[0].extra}
    arrays: dict[str, Any] = {name: all_of(name) for name in (*COLUMNS, "run")}
    part = sum((recording.part for recording in recordings), ())
    return Recording(**arrays, part=part, has_run=True, has_part=True, extra=extra)
