"""Planning that times itself by the processor: what else the machine does counts less."""

from __future__ import annotations

from time import process_time

from micah_plan.planning import tightening
from micah_plan.task import settings


def time_by_processor() -> None:
    """From now on, in this process, the timings of plans are seconds of the processor."""
    for module in (settings, tightening):
        vars(module)["perf_counter"] = process_time
