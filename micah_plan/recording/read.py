"""Reading and writing of recordings by file type."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

from micah_plan.errors import InputError, located_in, shown
from micah_plan.files import read_bytes, replace_file
from micah_plan.recording.conventions import Conventions
from micah_plan.recording.csv_file import csv_bytes, csv_columns, read_csv
from micah_plan.recording.mcap_writing import mcap_bytes
from micah_plan.recording.npz_file import npz_bytes, read_npz
from micah_plan.recording.parquet_file import parquet_columns, read_parquet
from micah_plan.recording.ros_bags import is_log
from micah_plan.recording.ros_log import joint_columns, read_ros_log
from micah_plan.recording.tum_file import read_tum, tum_bytes
from micah_plan.recording.value import Recording

_READERS = {".npz": read_npz, ".tum": read_tum}
_TABLES = {".csv": read_csv, ".parquet": read_parquet}
_CONTENTS = {".csv": csv_bytes, ".npz": npz_bytes, ".tum": tum_bytes, ".txt": tum_bytes, ".mcap": mcap_bytes}
_REMEDY = (
    "use .csv (recording), .tum or .txt (TUM trajectory), .npz (arrays), .parquet (table, LeRobot), .mcap, .db3 or "
    ".bag (ROS messages)"
)


def read_recording(path: str | Path, *, minimum_rows: int = 1, conventions: Conventions | None = None) -> Recording:
    """Read a recording from a .csv, .tum, .txt, .npz, .parquet, .mcap, .db3 or .bag file.

    A ``.txt`` file is read as CSV if its first line that is not a comment has commas, otherwise as TUM trajectory.
    Quaternions whose norm is within 1 % of one are normalised.

    Args:
        path: the file.
        minimum_rows: how many rows every run needs of each of its parts, e.g. for a fit.
        conventions: units, upward axis etc. of the file, if they are not those of a recording; names of columns only
            for tables, the rate for tables and trajectories, topics and frame for ROS logs.

    Raises:
        InputError: one line with file, place, what was expected and found, and a remedy.
        MissingDependencyError: for ROS messages without the extra ``ros``, for Parquet without ``parquet``.
    """
    meant, suffix = conventions or Conventions(), Path(path).suffix.lower()
    if suffix == ".txt":
        suffix = ".csv" if _has_commas(path) else ".tum"
    with located_in(path):
        if suffix not in _TABLES:
            meant.refuse_stated(("columns",), "only tables (.csv, .parquet) have columns to name")
            if suffix != ".tum":
                meant.refuse_stated(("rate",), "only tables (.csv, .parquet) and trajectories (.tum, .txt) count rows")
        if is_log(path):
            return read_ros_log(path, minimum_rows=minimum_rows, conventions=meant)
        meant.refuse_stated(("topics", "frame"), "only ROS logs (.mcap, .bag, .db3) have topics and frames")
        if suffix in _TABLES:
            return _TABLES[suffix](path, minimum_rows=minimum_rows, conventions=meant)
        if suffix not in _READERS:
            read_bytes(path)  # that it does not exist or is a directory is the better message
            raise _unknown(path, suffix)
        return _READERS[suffix](path, minimum_rows=minimum_rows, conventions=meant)


def read_columns(path: str | Path, topics: Collection[str] = ()) -> tuple[dict[str, Any], tuple[str, ...]]:
    """All columns of a table, or the joints of a ROS log: (n,) numbers or strings by name.

    Args:
        path: the file.
        topics: of a ROS log, those with measured joints; none: those whose names are not those of commands.

    Returns:
        The columns, and the assumptions, one line each.

    Raises:
        InputError: if the file has none.
    """
    suffix = Path(path).suffix.lower()
    if is_log(path):
        return joint_columns(path, topics)
    if suffix == ".parquet":
        return parquet_columns(path), ()
    if suffix in (".csv", ".txt"):
        return csv_columns(path), ()
    problem = f"a {shown(suffix)} file has no joints"
    raise InputError(problem, source=path, remedy="give a table (.csv, .parquet) or a ROS log (.mcap, .bag, .db3)")


def write_recording(recording: Recording, path: str | Path) -> None:
    """Write a recording in the format that the extension names: .csv, .tum, .txt (TUM trajectory), .npz or .mcap.

    Raises:
        InputError: if the file cannot be written or its format cannot hold all that the recording has.
    """
    replace_file(path, recording_bytes(recording, path))


def recording_bytes(recording: Recording, path: str | Path) -> bytes:
    """The bytes that `write_recording` writes to a path, for files that are replaced together.

    Raises:
        InputError: if its format cannot hold all that the recording has.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _CONTENTS:
        raise _unknown(path, suffix)
    return _CONTENTS[suffix](recording, path)


def _has_commas(path: str | Path) -> bool:
    lines = (line.strip() for line in read_bytes(path).splitlines())
    first = next((line for line in lines if line and not line.startswith(b"#")), b"")
    return b"," in first


def _unknown(path: str | Path, suffix: str) -> InputError:
    problem = f"the extension {shown(suffix)}" if suffix else "no extension"
    return InputError(f"expected a recording, found {problem}", source=path, remedy=_REMEDY)
