"""What carries the hand of a held object in MuJoCo: `Carrier`, and three slides of its own."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from micah_plan.execution.held_mjcf import OBJECT

Floats = NDArray[np.float64]


class Carrier(Protocol):
    """Takes the hand from place to place."""

    def put(self, place: Floats) -> None:
        """Stand at rest with the hand at a place (3,) [m]."""
        ...

    def aim(self, displacement: Floats, posture: Floats | None, /) -> None:
        """Choose where to go: from where the hand is now, by a displacement (3,) [m]; an arm near a posture (n,)."""
        ...

    def move(self, share: float) -> None:
        """Set the motors to a share (0 to 1) of the way."""
        ...

    @property
    def joints(self) -> Floats | None:
        """(n,) what the encoders of an arm say now [rad or m]; None without one."""
        ...

    @property
    def complaint(self) -> str:
        """Why it could not go where it was told to since it was put; empty if it could."""
        ...


class Slides:
    """Three slides along the axes of the base frame."""

    joints = None
    complaint = ""

    def __init__(self, model: Any, data: Any) -> None:
        self._data = data
        self._address = [int(model.joint(OBJECT + axis).qposadr[0]) for axis in "xyz"]
        self._begin, self._end = np.zeros(3), np.zeros(3)

    def put(self, place: Floats) -> None:
        self._data.qpos[self._address] = place
        self._data.ctrl[:] = place

    def aim(self, displacement: Floats, _posture: Floats | None, /) -> None:
        self._begin = self._data.qpos[self._address].copy()
        self._end = self._begin + displacement

    def move(self, share: float) -> None:
        self._data.ctrl[:] = self._begin + share * (self._end - self._begin)
