"""Remaining time next to a progress bar."""

from __future__ import annotations

from rich.progress import ProgressColumn, Task
from rich.text import Text

from micah_plan.quantities import duration

# Before so much time [s] and so great a share is done, an estimate is meaningless.
_FIRST_S, _FIRST_SHARE = 2.0, 0.05


def time_left(elapsed_s: float, fraction: float) -> str:
    """Remaining time in words by extrapolation, right within a factor of about two."""
    if elapsed_s < _FIRST_S or not _FIRST_SHARE <= fraction < 1.0:
        return ""
    return f"about {duration(max(round(elapsed_s * (1.0 - fraction) / fraction), 1))} left"


class TimeLeft(ProgressColumn):
    """The column of a progress bar with the remaining time."""

    def render(self, task: Task) -> Text:
        """The remaining time of a task whose `completed` is the fraction done."""
        return Text(time_left(task.elapsed or 0.0, task.completed), style="progress.remaining")
