"""The error that a planner raises where it finds nothing; `attempt` makes a plan without a trajectory of it."""

from __future__ import annotations

from micah_plan.task.reason import Reason


class NoWayError(Exception):
    """A planner found nothing, for a reason."""

    def __init__(self, reason: Reason) -> None:
        self.reason = reason
        super().__init__(str(reason))
