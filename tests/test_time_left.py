"""What a progress bar says of the time that is left."""

from __future__ import annotations

import io

import pytest
from rich.console import Console
from rich.progress import Progress

from micah_plan.cli.time_left import TimeLeft, time_left


@pytest.mark.parametrize(
    ("elapsed_s", "fraction", "said"),
    [
        (10.0, 0.5, "about 10 s left"),
        (30.0, 0.25, "about 1 min 30 s left"),
        (600.0, 0.1, "about 1 h 30 min left"),
        (10.0, 0.999, "about 1 s left"),
        (1.0, 0.5, ""),  # too early to tell
        (10.0, 0.01, ""),
        (10.0, 0.0, ""),
        (10.0, 1.0, ""),  # done
    ],
)
def test_the_rest_takes_as_long_as_its_share(elapsed_s: float, fraction: float, said: str) -> None:
    assert time_left(elapsed_s, fraction) == said


def test_a_bar_shows_it() -> None:
    now, shown = 0.0, io.StringIO()
    bars = Progress(TimeLeft(), console=Console(file=shown, force_terminal=True), get_time=lambda: now)
    task = bars.add_task("", total=1.0)
    now = 6.0
    bars.update(task, completed=0.75)
    bars.start()
    bars.stop()
    assert "about 2 s left" in shown.getvalue()
