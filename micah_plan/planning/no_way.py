"""What a planner raises where it finds nothing; `attempt` makes a plan without a trajectory of it."""

from __future__ import annotations


class NoWayError(Exception):
    """A planner found nothing; `reason` says why and ends with the remedy."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)
