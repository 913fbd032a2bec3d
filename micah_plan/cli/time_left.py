"""How long work will still take, beside its progress bar."""

from __future__ import annotations

from rich.progress import ProgressColumn, Task
from rich.text import Text

from micah_plan.quantities import duration

# Before so much time [s] and so great a share is done, an estimate says nothing.
_FIRST_S, _FIRST_SHARE = 2.0, 0.05


def time_left(elapsed_s: float, fraction: float) -> str:
    """In words, if the rest is as slow as what is done: stages differ, so it is right within a factor of two or so."""
    if elapsed_s < _FIRST_S or not _FIRST_SHARE <= fraction < 1.0:
        return ""
    return f"about {duration(max(round(elapsed_s * (1.0 - fraction) / fraction), 1))} left"


class TimeLeft(ProgressColumn):
    """The column of a bar that says `time_left`."""

    def render(self, task: Task) -> Text:
        """Of a task of which `completed` is the fraction done."""
        return Text(time_left(task.elapsed or 0.0, task.completed), style="progress.remaining")
