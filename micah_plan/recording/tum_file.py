"""TUM trajectory text: ``t x y z qx qy qz qw`` per line, separated by blanks, ``#`` starting a comment.

Source: Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012. It holds the poses of one run
of one part and nothing else. The name of the part, and the number of the run, are in comments: ``# part: door``.

Lines of 12 numbers are KITTI's: the upper three rows of the homogeneous matrix, without times, which `rate` gives.
Source: Geiger, Lenz and Urtasun, "Are we ready for autonomous driving? The KITTI vision benchmark suite", CVPR 2012.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.errors import InputError, located_in, shown
from micah_plan.recording.checks import POSITION, QUATERNION, checked_recording
from micah_plan.recording.conventions import Conventions, as_recorded
from micah_plan.recording.text import UnreadableValue, floats, read_lines
from micah_plan.recording.value import Recording

_STATED = re.compile(r"# (part|run): (.+)")
_COLUMNS = ("t", *POSITION, *QUATERNION)
# Numbers of a matrix (3, 4), and by how much its rotation may be none, written with four digits.
_OF_A_MATRIX, _NOT_A_TURN = 12, 1e-2


def read_tum(path: str | Path, *, minimum_rows: int = 1, conventions: Conventions | None = None) -> Recording:
    """`read_recording` of a TUM trajectory, by conventions on its units, axes and quaternions.

    Raises:
        InputError: with file, line, column and remedy, for any violation of the format.
    """
    with located_in(path):
        return _parsed(read_lines(path), minimum_rows, conventions or Conventions())


def tum_bytes(recording: Recording, path: str | Path) -> bytes:
    """The content of a TUM trajectory with the poses.

    Raises:
        InputError: if the recording has data that the format cannot represent: several runs or parts, actions, forces,
            further columns, or no orientation. Nothing is left out silently.
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

    if rows and all(len(row) == _OF_A_MATRIX for row in rows):
        return checked_recording(_of_matrices(rows, numbers, meant), minimum_rows=minimum_rows, place=place)
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
    stated = {match[1]: match[2] for line in lines if (match := _STATED.fullmatch(line.strip()))}
    number = int(stated["run"]) if re.fullmatch(r"-?\d{1,18}", stated.get("run", "")) else 0
    if meant.rate is not None:  # times count frames
        values[:, 0], meant = values[:, 0] / meant.rate, replace(meant, rate=None)
    recording = Recording(
        time=values[:, 0],
        position=values[:, 1:4],
        quaternion=values[:, 4:],
        run=np.full(len(values), number),
        part=(stated["part"],) * len(values) if "part" in stated else (),
        has_run=number != 0 or stated.get("run") == "0",
        has_part="part" in stated,
    )
    recording = as_recorded(recording, meant) if meant.stated() else recording
    return checked_recording(recording, minimum_rows=minimum_rows, place=place)


def _of_matrices(rows: list[list[str]], numbers: list[int], meant: Conventions) -> Recording:
    """A recording from matrices (3, 4), a row of the file each."""
    if meant.rate is None:
        problem = f"{_OF_A_MATRIX} numbers per line are the matrices of KITTI, which have no times"
        raise InputError(problem, where=f"line {numbers[0]}", remedy="give their number per second: --rate 10")
    try:
        matrices = floats([text for row in rows for text in row]).reshape(-1, 3, 4)
    except UnreadableValue as error:
        row, column = divmod(error.row, _OF_A_MATRIX)
        where = f"line {numbers[row]}, number {column + 1}"
        raise InputError(error.problem, where=where, remedy=error.remedy) from None
    turns = matrices[:, :, :3]
    off = np.abs(turns @ turns.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2))
    wrong = np.flatnonzero(~((off < _NOT_A_TURN) & (np.linalg.det(turns) > 0)))
    if len(wrong):
        where = f"line {numbers[int(wrong[0])]}"
        raise InputError("expected a rotation in the first three columns", where=where, remedy="correct the matrix")
    turn = Rotation.from_matrix(turns).as_quat()
    recording = Recording(np.arange(len(matrices)) / meant.rate, matrices[:, :, 3], turn)
    return as_recorded(recording, replace(meant, rate=None))
