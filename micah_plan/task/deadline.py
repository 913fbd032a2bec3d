"""When planning must end: every stage asks now and then, and none goes on for long after."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from time import perf_counter

# What a solver is given at least, so that it can say that the time is over [s].
_SHORTEST_S = 1e-3


class TimeLimitError(Exception):
    """The time is over; `reason` says in which stage, how far that was, and what to do."""

    def __init__(self, limit_s: float, stage: str, state: str, remedy: str) -> None:
        self.reason = (
            f"the time limit of {limit_s:g} s (solve_time_limit_s) was reached in the {stage}: {state}; {remedy}"
        )
        super().__init__(self.reason)


class Deadline:
    """A wall-clock limit that begins when it is made."""

    def __init__(self, limit_s: float, clock: Callable[[], float] = perf_counter) -> None:
        """Args: the limit [s], and what tells the time [s]."""
        self.limit_s, self._clock = limit_s, clock
        self._end = clock() + limit_s

    @property
    def left_s(self) -> float:
        """Time left [s], never quite none: for solvers that take a limit."""
        return max(_SHORTEST_S, self._end - self._clock())

    def is_over(self) -> bool:
        """Whether no time is left."""
        return self._clock() >= self._end

    def check(self, stage: str, state: str, lower: str = "") -> None:
        """Go on if there is time.

        Args:
            stage: where this is.
            state: how far it is.
            lower: the setting that makes the stage shorter.

        Raises:
            TimeLimitError: if there is none.
        """
        if self.is_over():
            raise TimeLimitError(
                self.limit_s, stage, state, "raise solve_time_limit_s" + (f" or lower {lower}" if lower else "")
            )


NEVER = Deadline(inf)
