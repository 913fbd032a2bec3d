"""Recordings as NPZ: the arrays of the value under their own names, without any parsing of text.

Keys: ``time``, ``position`` and optionally ``quaternion``, ``action``, ``force``, ``run``, ``part``; further columns as
``extra_names`` (k,) and ``extra`` (k, n), both text. Shapes and units are those of `Recording`.
"""

from __future__ import annotations

import io
import math
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micah_plan.errors import InputError, located_in, shown
from micah_plan.files import LARGEST_FILE_BYTES, read_bytes, replace_file
from micah_plan.recording.checks import checked_recording
from micah_plan.recording.conventions import Conventions, as_recorded
from micah_plan.recording.value import DEFAULT_PART, Recording

_NUMBERS = {"time": 1, "position": 2, "quaternion": 2, "action": 2, "force": 2}
_TEXTS = {"part": 1, "extra_names": 1, "extra": 2}
_DIMENSIONS = {**_NUMBERS, "run": 1, **_TEXTS}
_REMEDY = "write it again with write_recording or numpy.savez"


def read_npz(path: str | Path, *, minimum_rows: int = 1, conventions: Conventions | None = None) -> Recording:
    """`read_recording` for NPZ archives; pickled objects and archives above 256 MiB unpacked are refused.

    Raises:
        InputError: with file, row (from 0), column and remedy, for any violation of the format.
    """
    data = read_bytes(path)
    if not data:
        raise InputError("the file is empty", source=path, remedy="write a recording into it")
    with located_in(path):
        try:
            recording = _recording(_arrays(data))
            if conventions is not None and conventions.stated():
                recording = as_recorded(recording, conventions)
            return checked_recording(recording, minimum_rows=minimum_rows)
        except InputError:
            raise
        except Exception as error:  # damaged archives make zipfile, its codecs and NumPy raise nearly anything
            message = shown(str(error) or type(error).__name__)
            problem = f"expected an NPZ archive of arrays, found one that cannot be read ({message})"
            raise InputError(problem, remedy=_REMEDY) from None


def write_npz(recording: Recording, path: str | Path) -> None:
    """Write the output of `npz_bytes` atomically.

    Raises:
        InputError: also if the file cannot be written.
    """
    replace_file(path, npz_bytes(recording, path))


def npz_bytes(recording: Recording, path: str | Path) -> bytes:
    """The content of a recording as NPZ.

    Raises:
        InputError: if the recording is not one that could be read back.
    """
    with located_in(path):
        recording = checked_recording(recording)
    given = {name: getattr(recording, name) for name in _NUMBERS}
    arrays: dict[str, NDArray[Any]] = {name: array for name, array in given.items() if array is not None}
    if recording.has_run or recording.run.any():
        arrays["run"] = recording.run
    if recording.has_part or recording.parts != (DEFAULT_PART,):
        arrays["part"] = np.array(recording.part)
    if recording.extra:
        arrays["extra_names"] = np.array(list(recording.extra))
        arrays["extra"] = np.array(list(recording.extra.values()))
    size = sum(array.nbytes for array in arrays.values())
    if size > LARGEST_FILE_BYTES:
        problem = f"the arrays take {size} bytes, more than a reader accepts"
        raise InputError(problem, source=path, remedy="write a .csv")
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def _arrays(data: bytes) -> dict[str, NDArray[Any]]:
    """The arrays of the archive, checked before and after unpacking."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive, warnings.catch_warnings():
        warnings.simplefilter("error")
        members = archive.infolist()
        size = sum(member.file_size for member in members)
        if size > LARGEST_FILE_BYTES:
            limit = LARGEST_FILE_BYTES // 1024 // 1024
            problem = f"expected at most {limit} MiB of arrays, found {size} bytes"
            raise InputError(problem, remedy="split the recording")
        arrays: dict[str, NDArray[Any]] = {}
        for member in members:
            name = member.filename.removesuffix(".npy")
            if name not in _DIMENSIONS or name in arrays:
                allowed = ", ".join(_DIMENSIONS)
                found = f"the array {shown(name)}" + (" twice" if name in arrays else "")
                raise InputError(f"expected arrays among {allowed}, found {found}", remedy="rename or remove it")
            arrays[name] = _array(archive.read(member), name)
    _check_arrays(arrays)
    return arrays


def _array(content: bytes, name: str) -> NDArray[Any]:
    """One array; its header is validated against the available bytes before memory is reserved."""
    file = io.BytesIO(content)
    version = np.lib.format.read_magic(file)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read_header(file)
    if dtype.hasobject:
        raise InputError(f"array '{name}' holds Python objects", remedy="store numbers and text only")
    if math.prod(shape, start=dtype.itemsize) != len(content) - file.tell():
        raise InputError(f"array '{name}' is cut off or has a wrong header", remedy=_REMEDY)
    return np.asarray(np.load(io.BytesIO(content), allow_pickle=False))


def _check_arrays(arrays: Mapping[str, NDArray[Any]]) -> None:
    for name in ("time", "position"):
        if name not in arrays:
            raise InputError(f"array '{name}' is missing", remedy="store time (n,) and position (n, 3)")
    if ("extra" in arrays) != ("extra_names" in arrays):
        raise InputError("expected extra and extra_names together, found one of them", remedy="add the other")
    for name, array in arrays.items():
        kinds, meant = ("U", "text") if name in _TEXTS else ("iu", "integers") if name == "run" else ("fiu", "numbers")
        if array.dtype.kind not in kinds or array.ndim != _DIMENSIONS[name]:
            problem = f"expected array '{name}' to hold {meant} in {_DIMENSIONS[name]} dimensions"
            raise InputError(f"{problem}, found {array.dtype} {array.shape}", remedy="convert it before saving")
    n = len(arrays["time"])
    for name, array in arrays.items():
        length = array.shape[-1 if name == "extra" else 0]
        if length != n and name != "extra_names":
            raise InputError(f"expected {n} rows in array '{name}' as in 'time', found {length}", remedy=_REMEDY)
    names = arrays["extra_names"].tolist() if "extra" in arrays else []
    if "extra" in arrays and len(set(names)) != len(arrays["extra"]):
        raise InputError("expected one name of its own for each row of 'extra'", remedy="rename the extra columns")
    if "run" in arrays and arrays["run"].size and int(arrays["run"].max()) > np.iinfo(np.int64).max:
        raise InputError("expected run numbers of at most 63 bits", remedy="number the runs 0, 1, 2 and so on")


def _recording(arrays: Mapping[str, NDArray[Any]]) -> Recording:
    texts = {name: arrays[name].tolist() if name in arrays else [] for name in _TEXTS}
    fields_given: dict[str, Any] = {name: arrays[name] for name in (*_NUMBERS, "run") if name in arrays}
    return Recording(
        **fields_given,
        part=tuple(texts["part"]),
        has_run="run" in arrays,
        has_part="part" in arrays,
        extra=dict(zip(texts["extra_names"], map(tuple, texts["extra"]), strict=True)),
    )
