"""Recordings as `.rrd` files of the viewer Rerun (extra `rerun`). The only importer of `rerun`.

Every part of every run is an entity ``run_R/PART`` with its pose over the time line ``time`` [s]; actions, forces and
columns of numbers are scalars below it. Its axes and the track ``run_R/tracks/PART`` are visible: of poses alone the
viewer draws nothing. Rerun stamps files with the time of writing, so bytes differ from run to run.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.errors import InputError, MissingDependencyError
from micah_plan.recording.value import Recording

_AXES = 0.2  # of the extent of the tracks
_SMALLEST_AXES = 0.01  # m
_RED_GREEN_BLUE = ((200, 40, 40), (40, 140, 40), (40, 80, 200))


def write_rrd(recording: Recording, path: str | Path) -> tuple[str, ...]:
    """Write a recording; returns the non-numeric columns, which are lost.

    Raises:
        InputError: if the file cannot be written.
        MissingDependencyError: without the extra ``rerun``.
    """
    try:
        import rerun as rr
    except ImportError:
        raise MissingDependencyError.of("rerun", ".rrd files need a library that is not installed") from None
    folder = Path(path).absolute().parent
    if not folder.is_dir():
        raise InputError("the folder does not exist", source=path, remedy="create it")
    stream = rr.RecordingStream("micah_plan", recording_id=recording.digest()[:32])
    stream.save(str(path))
    stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    length = max(_AXES * float(np.ptp(recording.position, axis=0).max()), _SMALLEST_AXES)
    axes = rr.Arrows3D(vectors=length * np.eye(3), colors=_RED_GREEN_BLUE)
    lost: dict[str, None] = {}
    for run in recording.runs:
        for part in recording.parts:
            of_part = (recording.run == run) & (np.array(recording.part) == part)
            if not of_part.any():
                continue
            rows = recording.rows(of_part)
            times, place = [rr.TimeColumn("time", duration=rows.time)], f"run_{run}/{part}"
            turned = {} if rows.quaternion is None else {"quaternion": rows.quaternion}
            moved = rr.Transform3D.columns(translation=rows.position, **turned)
            stream.send_columns(place, indexes=times, columns=moved)
            stream.log(f"{place}/axes", axes, static=True)
            stream.log(f"run_{run}/tracks/{part}", rr.LineStrips3D([rows.position]), static=True)
            for name, values in _scalars(rows, lost).items():
                stream.send_columns(f"{place}/{name}", indexes=times, columns=rr.Scalars.columns(scalars=values))
    stream.flush()
    stream.disconnect()
    return tuple(lost)


def _scalars(rows: Recording, lost: dict[str, None]) -> dict[str, Floats]:
    """Numeric columns by name, with NaN for empty entries; others are added to `lost`."""
    columns: dict[str, Floats] = {}
    for name, array in (("action", rows.action), ("force", rows.force)):
        if array is not None:
            columns |= {f"{name}/{axis}": array[:, i] for i, axis in enumerate("xyz")}
    for name, column in rows.extra.items():
        try:
            columns[name.replace(" ", "_")] = np.array([float(text) if text.strip() else np.nan for text in column])
        except ValueError:
            lost[name] = None
    return columns
