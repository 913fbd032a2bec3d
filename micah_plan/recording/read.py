"""One way in and out for recordings: the reader and writer that fit a file, imported when a file needs them."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING

from micah_plan.errors import InputError, shown
from micah_plan.files import read_bytes

if TYPE_CHECKING:
    from micah_plan.recording.value import Recording

_REMEDY = "use .csv (recording), .tum or .txt (TUM trajectory), .npz (arrays) or .mcap (ROS 2 messages)"


def read_recording(path: str | Path, *, minimum_rows: int = 1, topics: Collection[str] = ()) -> Recording:
    """Read a recording from a .csv, .tum, .txt, .npz or .mcap file.

    A ``.txt`` file is read as what it looks like: as CSV if its first line that is no comment has commas, otherwise as
    TUM trajectory.

    Args:
        path: the file.
        minimum_rows: how many rows every run needs of each of its parts, e.g. for a fit.
        topics: of an .mcap file, which to read; empty: all.

    Raises:
        InputError: one line with file, place, what was expected and found, and a remedy.
        MissingDependencyError: for .mcap files without the extra ``ros``.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".mcap":
        from micah_plan.recording.mcap_file import read_mcap

        return read_mcap(path, minimum_rows=minimum_rows, topics=topics)
    if topics:
        raise InputError("only .mcap files have topics", source=path, remedy="leave out the topics")
    if suffix == ".npz":
        from micah_plan.recording.npz_file import read_npz

        return read_npz(path, minimum_rows=minimum_rows)
    if suffix == ".csv" or (suffix == ".txt" and _has_commas(path)):
        from micah_plan.recording.csv_file import read_csv

        return read_csv(path, minimum_rows=minimum_rows)
    if suffix in {".txt", ".tum"}:
        from micah_plan.recording.tum_file import read_tum

        return read_tum(path, minimum_rows=minimum_rows)
    read_bytes(path)  # that it does not exist or is a directory is the better message
    raise _unknown(path, suffix)


def write_recording(recording: Recording, path: str | Path) -> None:
    """Write a recording in the format that the extension names: .csv, .tum, .txt (TUM trajectory), .npz or .mcap.

    Raises:
        InputError: if the file cannot be written or its format cannot hold all that the recording has.
    """
    from micah_plan.recording.csv_file import write_csv
    from micah_plan.recording.mcap_file import write_mcap
    from micah_plan.recording.npz_file import write_npz
    from micah_plan.recording.tum_file import write_tum

    suffix = Path(path).suffix.lower()
    writer = {".csv": write_csv, ".npz": write_npz, ".tum": write_tum, ".txt": write_tum, ".mcap": write_mcap}.get(
        suffix
    )
    if writer is None:
        raise _unknown(path, suffix)
    writer(recording, path)


def _has_commas(path: str | Path) -> bool:
    lines = (line.strip() for line in read_bytes(path).splitlines())
    first = next((line for line in lines if line and not line.startswith(b"#")), b"")
    return b"," in first


def _unknown(path: str | Path, suffix: str) -> InputError:
    found = f"the extension {shown(suffix)}" if suffix else "no extension"
    return InputError(f"expected a recording, found {found}", source=path, remedy=_REMEDY)
