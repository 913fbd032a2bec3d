"""The task of an exploration: open the held object, within limits."""

from __future__ import annotations

from dataclasses import dataclass

from micah_plan.arrays import Floats
from micah_plan.automaton.joint import Quaternion, Vector3
from micah_plan.errors import InputError, shown
from micah_plan.task.problem import Problem


@dataclass(frozen=True)
class Scene:
    """A hand that holds an unknown handle.

    Attributes:
        largest_force: that the hand may exert [N].
        largest_stiffness: of the hand, as set in its controller [N/m]; None: unknown, estimated from pushes.
        largest_step: largest displacement of one command [m].
        steps: commands allowed.
        opening: displacement of the handle that counts as open [m].
        position, quaternion: where the hand holds, base frame [m]; None: from the first measurement.
        low, high: corners of the workspace, base frame [m]; the handle is not led out of it. None: no limit.
        simulated: the problem whose object the plants of the package put into the hand; plants of your own ignore it.
    """

    largest_force: float = 45.0
    largest_stiffness: float | None = None
    largest_step: float = 0.05
    steps: int = 300
    opening: float = 0.2
    position: Vector3 | None = None
    quaternion: Quaternion | None = None
    low: Vector3 | None = None
    high: Vector3 | None = None
    simulated: Problem | None = None

    def __post_init__(self) -> None:
        for name in ("largest_force", "largest_stiffness", "largest_step", "opening"):
            if getattr(self, name) is not None and not 0.0 < getattr(self, name) < float("inf"):
                raise InputError(f"{name} must be a number > 0. Got {shown(getattr(self, name))}")
        if self.steps < 1:
            raise InputError(f"steps must be at least 1. Got {shown(self.steps)}")

    def is_outside(self, place: Floats) -> bool:
        """Whether a place (3,) is not in the workspace [m]."""
        low, high = self.low, self.high
        return bool((low is not None and (place < low).any()) or (high is not None and (place > high).any()))
