"""What `execute` says of trials."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from micah_plan.cli.console import out, print_files
from micah_plan.quantities import quantity, with_spread

if TYPE_CHECKING:
    from micah_plan.execution.trials import TrialStatistics


def executed(statistics: TrialStatistics, seconds: float) -> dict[str, Any]:
    """Keys of `execute`. `believed`: nobody knows the truth, so successes and errors are what the belief says."""
    return {
        "trials": statistics.trials,
        "successes": statistics.successes,
        "believed": statistics.believed,
        "final_error": {
            "mean": statistics.final_error.mean,
            "std": statistics.final_error.std,
            "max": statistics.final_error.max,
        },
        "failures": [{"trial": trial, "reason": reason} for trial, reason in statistics.failures],
        "seconds": seconds,
    }


def print_executed(summary: dict[str, Any], unit: str, files: tuple[Path | None, ...]) -> None:
    """Successes and errors [unit] of trials."""
    error, said, whose = summary["final_error"], "reached the goal", ""
    if summary["believed"]:
        said, whose = "are believed to have reached the goal (the plant does not know the truth)", " (believed)"
    out.print(f"{summary['successes']} of {summary['trials']} trials {said}")
    spread = with_spread(error["mean"], error["std"], unit)
    out.print(f"  final error  {spread}, at most {quantity(error['max'], unit)}{whose}")
    for failure in summary["failures"]:
        out.print(f"  trial {failure['trial']}: {failure['reason']}", markup=False)
    print_files(files)
