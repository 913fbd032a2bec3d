"""What `micah-plan sweep` reports, as plain data: the JSON keys that scripts rely on."""

from __future__ import annotations

from collections import Counter
from collections.abc import Container
from typing import Any

from micah_plan.sweep.run import SweepResults
from micah_plan.task.sweep import Sweep


def counted(sweep: Sweep, finished: Container[str]) -> dict[str, Any]:
    """Keys of `sweep --dry-run`: what the cases are made of, and how many there are, each counted once.

    Args:
        finished: keys of the cases in the journal.
    """
    keys = {case.key for case in sweep.cases()}
    return {
        "problems": len(sweep.problems),
        "grid": {key: len(values) for key, values in sweep.grid},
        "seeds": len(sweep.seeds),
        "cases": len(keys),
        "finished": sum(key in finished for key in keys),
    }


def swept(done: SweepResults, seconds: float) -> dict[str, Any]:
    """Keys of `sweep`: how many cases, how many of them were finished before, and what became of them."""
    pairs = zip(done.cases, done.results, strict=True)
    executed = [(case.trials, result.successes) for case, result in pairs if result.successes is not None]
    return {
        "cases": len(done.cases),
        "resumed": done.resumed,
        "outcomes": dict(sorted(Counter(result.outcome for result in done.results).items())),
        "trials": sum(trials for trials, _ in executed),
        "successes": sum(successes for _, successes in executed),
        "files": [str(file) for file in done.files],
        "seconds": seconds,
    }
