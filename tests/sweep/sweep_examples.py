"""Small sweeps, and executors that tests can look into."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]

# A drawer that is planned for in a tenth of a second.
SMALL: dict[str, Any] = {
    "format": "micah-plan/sweep/1",
    "problems": ["problems/drawer_close.yaml"],
    "grid": {"start.std.drawer": [0.004, 0.01], "planner.verification_trials": [40], "confidence": [0.8]},
    "seeds": 2,
}


class Inline(Executor):
    """Runs everything at once in this thread, and counts."""

    submitted = 0

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.submitted += 1
        future: Future[Any] = Future()
        try:
            future.set_result(function(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future
