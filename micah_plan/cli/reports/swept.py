"""What `sweep` says: how many cases there are, and what became of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Container
from pathlib import Path
from typing import TYPE_CHECKING, Any

from micah_plan.cli.console import out, print_files
from micah_plan.quantities import count, duration

if TYPE_CHECKING:
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


def print_counted(summary: dict[str, Any]) -> None:
    """How many cases a sweep has, and of what."""
    values = [f"{number} of {key}" for key, number in summary["grid"].items()]
    factors = [count(summary["problems"], "problem"), *values, count(summary["seeds"], "seed")]
    out.print(f"{count(summary['cases'], 'case')}: {' x '.join(factors)}", markup=False)
    out.print(f"  finished  {summary['finished']:,}")


def print_swept(summary: dict[str, Any], files: tuple[Path, ...]) -> None:
    """What became of the cases of a sweep."""
    before = f", {summary['resumed']:,} of them before" if summary["resumed"] else ""
    out.print(f"finished {count(summary['cases'], 'case')}{before} in {duration(summary['seconds'])}")
    for outcome, number in summary["outcomes"].items():
        out.print(f"  {outcome:<12} {number:,}")
    if summary["trials"]:
        out.print(f"  {summary['successes']:,} of {summary['trials']:,} trials reached the goal")
    print_files(files)
