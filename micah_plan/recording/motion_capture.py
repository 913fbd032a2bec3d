"""Tables that Motive and Vicon Nexus or Tracker export: several header rows, a group of columns for each rigid body.

Motive: one line of keys and values (rate, unit, kind of rotation), then lines `Type`, `Name`, `ID`, and two with the
names of the columns. Its y points upwards unless set otherwise, which the file does not state. Vicon: a line
`Segments`, `Objects` or `Trajectories`, one with the rate, one with the names of bodies, one with columns (`RX,RY,RZ`
is a rotation vector, with `RW` a quaternion) and one with units.

Sources: https://docs.optitrack.com/motive/data-export/data-export-csv and
https://docs.vicon.com/display/Nexus/ASCII+export.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from micah_plan.errors import InputError, shown
from micah_plan.recording import messages
from micah_plan.recording.conventions import ColumnSource, Conventions

_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_TURN = ("rx", "ry", "rz")
_MOTIVE = "Format Version"
_MOTIVE_UNITS = {"meters": "m", "centimeters": "cm", "millimeters": "mm"}
_VICON = ("Segments", "Objects", "Global Angles", "Trajectories")
_VICON_COLUMNS = {"TX": "x", "TY": "y", "TZ": "z", "X": "x", "Y": "y", "Z": "z"}
_LONGEST_HEADER = 12  # lines


@dataclass(frozen=True)
class CaptureTable:
    """A table with the columns of a recording.

    Attributes:
        columns: texts by name, in the order of the file, of each line of an export the bodies in their order.
        line_numbers: of each row, from 1.
        sources: where the numbers of a column come from, by name; the others are taken as they are.
        called: the file's names of columns that it names otherwise.
        numbers: names of further columns that hold numbers: orientations in place of a quaternion, targets.
        conventions: units and rate stated by the file.
        notes: assumptions, one line each.
    """

    columns: dict[str, tuple[str, ...]]
    line_numbers: list[int]
    sources: Mapping[str, ColumnSource] = field(default_factory=dict)
    called: Mapping[str, str] = field(default_factory=dict)
    numbers: frozenset[str] = frozenset()
    conventions: Conventions = field(default_factory=Conventions)
    notes: tuple[str, ...] = ()


def motion_capture_table(lines: Sequence[str], *, is_upright: bool = False) -> CaptureTable | None:
    """The bodies' poses in an export of Motive or Vicon; None for other files.

    Args:
        lines: of the file.
        is_upright: whether the upward axis was given, so that nothing is assumed.

    Raises:
        InputError: if it is one of these, and has no poses of bodies.
    """
    begin = next((i for i, line in enumerate(lines) if line.strip()), 0)
    first = next(csv.reader([lines[begin]]), [])
    if first and first[0].strip() == _MOTIVE:
        return _motive(lines, first, is_upright)
    if first and first[0].strip() in _VICON and not any(cell.strip() for cell in first[1:]):
        return _vicon(lines, begin)
    return None


def _motive(lines: Sequence[str], first: Sequence[str], is_upright: bool) -> CaptureTable:
    stated = dict(zip((cell.strip() for cell in first[::2]), (cell.strip() for cell in first[1::2]), strict=False))
    head = [next(csv.reader([line]), []) for line in lines[:_LONGEST_HEADER]]
    at = {row[1].strip(): i for i, row in enumerate(head) if len(row) > 1 and row[1].strip() in ("Type", "Name")}
    begin = next((i for i, row in enumerate(head) if row and row[0].strip() == "Frame"), None)
    if len(at) < 2 or begin is None:
        raise InputError("expected the header of a Motive export (Type, Name, Frame)", remedy="export it again as CSV")
    kinds, names, groups, axes = head[at["Type"]], head[at["Name"]], head[begin - 1], head[begin]
    bodies: dict[str, dict[str, int]] = {}
    for i in range(2, len(axes)):
        kind, group, axis = (row[i].strip() if i < len(row) else "" for row in (kinds, groups, axes))
        if kind == "Rigid Body" and group in ("Position", "Rotation") and axis.lower() in ("x", "y", "z", "w"):
            column = axis.lower() if group == "Position" else f"q{axis.lower()}"
            bodies.setdefault(names[i].strip(), {})[column] = i
    rotation = stated.get("Rotation Type", "Quaternion")
    if any("qx" in columns for columns in bodies.values()) and rotation.lower() != "quaternion":
        problem = f"rotations are exported as {shown(rotation)}"
        raise InputError(problem, where="line 1", remedy="export them as quaternions")
    unit = stated.get("Length Units", "Meters").lower()
    if unit not in _MOTIVE_UNITS:
        raise InputError(f"unknown length unit {shown(unit)}", where="line 1", remedy="export in metres or millimetres")
    conventions = Conventions(length=_MOTIVE_UNITS[unit], up="y")
    note = "" if is_upright else messages.y_upwards()
    return _stacked(lines, begin + 1, {"t": 1}, _complete(bodies, "rigid body"), conventions, note)


def _vicon(lines: Sequence[str], begin: int) -> CaptureTable:
    head = [next(csv.reader([line]), []) for line in lines[begin : begin + 5]]
    title, rated, named, called, united = head + [[] for _ in range(5 - len(head))]
    try:
        rate = float(rated[0])
    except (IndexError, ValueError):
        raise InputError("expected the rate [Hz]", where=f"line {begin + 2}", remedy="export it again") from None
    bodies: dict[str, dict[str, int]] = {}
    units: dict[str, str] = {}
    name = ""
    for i, cell in enumerate(called):
        name = named[i].strip() if i < len(named) and named[i].strip() else name
        axis = cell.strip().rstrip("'")
        column = _VICON_COLUMNS.get(axis) or (axis.lower() if axis in ("RX", "RY", "RZ", "RW") else "")
        if column:
            body = name.removeprefix("Global Angle ").rpartition(":")[2]
            bodies.setdefault(body, {})[column] = i
            units.setdefault(column, united[i].strip().lower() if i < len(united) else "")
    for columns in bodies.values():
        if "rw" in columns:
            for axis in "xyzw":
                columns[f"q{axis}"] = columns.pop(f"r{axis}")
    length, angle = units.get("x") or "mm", units.get("rx") or "rad"
    turned = any("rx" in columns for columns in bodies.values())
    conventions = Conventions(length=length, angle=angle if turned else None, rate=rate)
    kind = title[0].strip().lower().rstrip("s")
    return _stacked(lines, begin + 5, {"t": 0}, _complete(bodies, kind), conventions, "")


def _complete(bodies: Mapping[str, dict[str, int]], kind: str) -> dict[str, dict[str, int]]:
    """The bodies with three position columns."""
    complete = {name: columns for name, columns in bodies.items() if {"x", "y", "z"} <= columns.keys()}
    if not complete:
        raise InputError(f"expected positions of a {kind}, found none", remedy="export the bodies' positions")
    return complete


def _stacked(
    lines: Sequence[str],
    begin: int,
    always: Mapping[str, int],
    bodies: Mapping[str, Mapping[str, int]],
    conventions: Conventions,
    note: str,
) -> CaptureTable:
    """One row for each body of each line; columns that a body lacks stay empty."""
    used = [column for column in (*_POSE, *_TURN) if any(column in columns for columns in bodies.values())]
    rows: list[list[str]] = []
    numbers: list[int] = []
    for number, line in enumerate(lines[begin:], start=begin + 1):
        cells = next(csv.reader([line]), [])
        if not any(cell.strip() for cell in cells):
            continue
        for name, columns in bodies.items():
            filled = [
                cells[columns[key]].strip() if key in columns and columns[key] < len(cells) else "" for key in used
            ]
            rows.append([cells[always["t"]].strip(), name, *filled])
            numbers.append(number)
    if not rows:
        raise InputError("the header is followed by no rows", where=f"line {begin}", remedy="record at least one row")
    columns_of = dict(zip(("t", "part", *used), zip(*rows, strict=True), strict=True))
    turned = frozenset(used) & frozenset(_TURN)
    return CaptureTable(columns_of, numbers, numbers=turned, conventions=conventions, notes=(note,) if note else ())
