"""Deadline of planning, polled by all stages, and the durations of stages."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import inf
from time import perf_counter, process_time

from micah_plan.task import messages
from micah_plan.task.reason import Reason

# The least time that a solver is given, so that it can report the time limit [s].
_SHORTEST_S = 1e-3


class TimeLimitError(Exception):
    """The time limit was reached.

    Attributes:
        reason: the stage, its progress, and the remedy.
    """

    def __init__(self, limit_s: float, stage: str, state: str, remedy: str) -> None:
        sentence = messages.time_limit_reached(limit_s, stage, state)
        self.reason = Reason("time_limit_reached", sentence, (remedy,))
        super().__init__(str(self.reason))


class Deadline:
    """A limit on processor time from its creation on, so that results do not depend on the machine's load."""

    def __init__(self, limit_s: float, clock: Callable[[], float] = process_time) -> None:
        """Args: the limit [s], and the clock [s]."""
        self.limit_s, self._clock = limit_s, clock
        self._end = clock() + limit_s

    @property
    def left_s(self) -> float:
        """Time left [s], always positive, for solvers with a limit."""
        return max(_SHORTEST_S, self._end - self._clock())

    def is_over(self) -> bool:
        """Whether no time is left."""
        return self._clock() >= self._end

    def check(self, stage: str, state: str, lower: str = "") -> None:
        """Raise an error if time is up.

        Args:
            stage: where this is.
            state: how far it is.
            lower: the setting that makes the stage shorter.

        Raises:
            TimeLimitError: if there is none.
        """
        if self.is_over():
            raise TimeLimitError(self.limit_s, stage, state, messages.raise_time_limit(lower))


NEVER = Deadline(inf)


class Clock:
    """Seconds by stage since creation."""

    def __init__(self) -> None:
        self._began = perf_counter()
        self._seconds = {"search": 0.0, "build": 0.0, "optimise": 0.0}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """A context whose duration is added to a stage."""
        began = perf_counter()
        try:
            yield
        finally:
            self._seconds[name] += perf_counter() - began

    def timings(self) -> dict[str, float]:
        """Each stage, and ``"total"`` [s]."""
        return {**self._seconds, "total": perf_counter() - self._began}
