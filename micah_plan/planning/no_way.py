"""The error of a planner without a solution; `attempt` converts it to a plan without a trajectory."""

from __future__ import annotations

from micah_plan.task.reason import Reason


class NoWayError(Exception):
    """A planner found no solution, with the reason."""

    def __init__(self, reason: Reason) -> None:
        self.reason = reason
        super().__init__(str(reason))
