"""The columns of a recording: their names, their groups and the largest values that can be meant."""

from __future__ import annotations

from collections.abc import Collection

from micah_plan.errors import InputError, shown

POSITION = ("x", "y", "z")
QUATERNION = ("qx", "qy", "qz", "qw")
ACTION = ("ax", "ay", "az")
FORCE = ("fx", "fy", "fz")
REQUIRED = ("t", *POSITION)
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

_HEADER_REMEDY = "the first line names the columns: t,x,y,z and optionally run, part, qx..qw, ax..az, fx..fz"


def check_header(names: Collection[str], where: str) -> None:
    """Check that the columns are complete: no name twice, the required ones there, groups whole or absent.

    Args:
        names: as they stand in the file.
        where: the place of the header, for messages, e.g. ``"line 1"``.

    Raises:
        InputError: with the column that is at fault; the file is left to the caller.
    """
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise InputError(f"column {shown(name)} appears twice", where=where, remedy="rename or remove one of them")
        seen.add(name)
    for name in REQUIRED:
        if name not in seen:
            problem = f"column '{name}' is missing, found {shown(','.join(names))}"
            raise InputError(problem, where=where, remedy=_header_remedy(names))
    for group in OPTIONAL_GROUPS:
        missing = [name for name in group if name not in seen]
        if missing and len(missing) < len(group):
            present = next(name for name in group if name in seen)
            problem = f"column '{missing[0]}' is missing although '{present}' is there"
            raise InputError(problem, where=where, remedy=f"add it or remove all of {','.join(group)}")


def _header_remedy(names: Collection[str]) -> str:
    text = "".join(names)
    if len(names) == 1 and (";" in text or "\t" in text):
        return "separate the columns by commas"
    return _HEADER_REMEDY
