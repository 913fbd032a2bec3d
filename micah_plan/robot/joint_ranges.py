"""Calibrated ranges of a robot's motors, in percent of which LeRobot logs joints.

LeRobot's ``calibration.json`` has for each motor the counts of its encoder at both ends (``range_min``, ``range_max``;
4096 counts are a turn) and whether it is mounted the other way round (``drive_mode``). A joint is logged as -100 to 100
from end to end, a gripper as 0 to 100 (`lerobot.motors.motors_bus`, ``MotorNormMode``). The zero of an angle is the
middle of the range, as that of LeRobot's own degrees; of a gripper it is the end at 0.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.errors import InputError, shown
from micah_plan.files import read_bytes

GRIPPER = "gripper"
_COUNTS_PER_TURN = 4096
_LARGEST_BYTES, _LARGEST_COUNT = 1_000_000, 2**31
_REMEDY = "give the calibration.json that LeRobot wrote for this arm"
# Percent: a motor that stands a little beyond an end of its range is logged as at the end.
_LARGEST = 101.0


@dataclass(frozen=True)
class JointRange:
    """The range of one motor.

    Attributes:
        low, high: counts of its encoder at the ends.
        is_reversed: whether its counts grow against the joint.
        is_one_sided: whether it is logged as 0 to 100 and not as -100 to 100.
    """

    low: int
    high: int
    is_reversed: bool = False
    is_one_sided: bool = False

    def angles(self, percent: Floats) -> Floats:
        """Angles [rad] of logged values.

        Raises:
            InputError: if values lie beyond 100 percent.
        """
        beyond = np.abs(percent)[np.isfinite(percent)].max(initial=0.0)
        if beyond > _LARGEST:
            raise InputError(
                f"expected percent of a calibrated range, found {beyond:.4g}",
                remedy="if these are degrees, give --units deg in place of --joint-ranges",
            )
        radians = (self.high - self.low) * 2.0 * np.pi / _COUNTS_PER_TURN
        if self.is_one_sided:
            return np.asarray((100.0 - percent if self.is_reversed else percent) / 100.0 * radians)
        return np.asarray((-percent if self.is_reversed else percent) / 200.0 * radians)


def load_joint_ranges(path: str | Path) -> Mapping[str, JointRange]:
    """Joint ranges of a file, by the names of motors, which equal those of joints.

    Raises:
        InputError: if it is no such file.
    """
    try:
        data: Any = json.loads(read_bytes(path, _LARGEST_BYTES))
    except (ValueError, RecursionError):
        raise InputError("expected JSON", source=path, remedy=_REMEDY) from None
    if not isinstance(data, Mapping) or not data:
        raise InputError("expected the ranges of motors by their names", source=path, remedy=_REMEDY)
    return {str(name): _range(str(name), entry, path) for name, entry in data.items()}


def _range(name: str, entry: Any, path: str | Path) -> JointRange:
    low, high = _count(name, entry, "range_min", path), _count(name, entry, "range_max", path)
    is_reversed = bool(_count(name, entry, "drive_mode", path, missing=0))
    if not low < high:
        problem = f"expected a range_max above range_min {low}, found {high}"
        raise InputError(problem, source=path, where=f"key '{name}.range_max'", remedy="calibrate the arm again")
    return JointRange(low, high, is_reversed, name == GRIPPER)


def _count(name: str, entry: Any, key: str, path: str | Path, missing: int | None = None) -> int:
    """A whole number of a motor's entry."""
    value = entry.get(key, missing) if isinstance(entry, Mapping) else None
    if not isinstance(value, int) or abs(value) > _LARGEST_COUNT:
        problem = f"expected a whole number, found {'nothing' if value is None else shown(str(value))}"
        raise InputError(problem, source=path, where=f"key '{name}.{key}'", remedy=_REMEDY)
    return value
