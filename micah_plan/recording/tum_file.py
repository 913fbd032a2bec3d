"""TUM trajectory text: ``t x y z qx qy qz qw`` per line, separated by blanks, ``#`` starting a comment.

Source: Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012. It holds the poses of one run
of one part and nothing else. What the part is called, and the number of the run, stand in comments: ``# part: door``.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from micah_plan.errors import InputError, located_in, shown
from micah_plan.recording.checks import POSITION, QUATERNION, checked_recording
from micah_plan.recording.conventions import Conventions, as_recorded
from micah_plan.recording.text import UnreadableValue, floats, read_lines
from micah_plan.recording.value import Recording

_SAID = re.compile(r"# (part|run): (.+)")
_COLUMNS = ("t", *POSITION, *QUATERNION)


def read_tum(path: str | Path, *, minimum_rows: int = 1, conventions: Conventions | None = None) -> Recording:
    """`read_recording` of a TUM trajectory, by conventions on its units, axes and quaternions.

    Raises:
        InputError: with file, line, column and remedy, for whatever is not as the format says.
    """
    with located_in(path):
        return _parsed(read_lines(path), minimum_rows, conventions or Conventions())


def tum_bytes(recording: Recording, path: str | Path) -> bytes:
    """The content of a TUM trajectory with the poses.

    Raises:
        InputError: if the recording has what the format cannot hold: several runs or
            parts, actions, forces, further columns, or no orientation. Nothing is left out silently.
    """
    with located_in(path):
        recording = checked_recording(recording)
        surplus = {
            "several runs": len(recording.runs) > 1,
            "several parts": len(recording.parts) > 1,
            "actions": recording.has_actions,
            "forces": recording.force is not None,
            f"columns {shown(','.join(recording.extra))}": recording.extra,
        }
        if any(surplus.values()):
            names = ", ".join(name for name, there in surplus.items() if there)
            problem = f"a TUM file holds the poses of one run and part only, found {names}"
            raise InputError(problem, remedy="write a .csv or .npz file")
        if recording.quaternion is None:
            raise InputError("a TUM file needs orientations, found none", remedy="write a .csv or .npz file")
    table = np.column_stack([recording.time, recording.position, recording.quaternion])
    named = [f"# part: {recording.parts[0]}"] if recording.has_part else []
    numbered = [f"# run: {recording.runs[0]}"] if recording.has_run or recording.run.any() else []
    rows = (" ".join(map(repr, row)) for row in table.tolist())
    lines = [f"# {' '.join(_COLUMNS)}", *named, *numbered, *rows]
    return ("\n".join(lines) + "\n").encode()


def _parsed(lines: list[str], minimum_rows: int, meant: Conventions) -> Recording:
    numbers = [i for i, line in enumerate(lines, start=1) if line.strip() and not line.lstrip().startswith("#")]
    rows = [lines[number - 1].split() for number in numbers]

    def place(row: int, column: str) -> str:
        return f"line {numbers[row]}, column '{column}'"

    for number, row in zip(numbers, rows, strict=True):
        if len(row) != len(_COLUMNS):
            problem = f"expected the {len(_COLUMNS)} numbers {' '.join(_COLUMNS)}, found {len(row)} fields"
            remedy = "separate them by blanks; give files with commas and a header the extension .csv"
            raise InputError(problem, where=f"line {number}", remedy=remedy)
    if not rows:
        problem = "the file has no poses, only comments"
        raise InputError(problem, where=f"line {len(lines)}", remedy="record at least one pose")
    try:
        values = floats([text for row in rows for text in row]).reshape(-1, len(_COLUMNS))
    except UnreadableValue as error:
        row_index, column = divmod(error.row, len(_COLUMNS))
        raise InputError(error.problem, where=place(row_index, _COLUMNS[column]), remedy=error.remedy) from None
    said = {match[1]: match[2] for line in lines if (match := _SAID.fullmatch(line.strip()))}
    number = int(said["run"]) if re.fullmatch(r"-?\d{1,18}", said.get("run", "")) else 0
    recording = Recording(
        time=values[:, 0],
        position=values[:, 1:4],
        quaternion=values[:, 4:],
        run=np.full(len(values), number),
        part=(said["part"],) * len(values) if "part" in said else (),
        has_run=number != 0 or said.get("run") == "0",
        has_part="part" in said,
    )
    recording = as_recorded(recording, meant) if meant.stated() else recording
    return checked_recording(recording, minimum_rows=minimum_rows, place=place)
