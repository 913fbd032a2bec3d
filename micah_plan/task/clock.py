"""How long the stages of planning took."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter


class Clock:
    """Seconds by stage since it was made."""

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
