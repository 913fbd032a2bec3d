"""Sentences of starts and time limits."""

from __future__ import annotations

from collections.abc import Sequence

from micah_plan.message import message

CHANGE_START_OR_MODE = "change the start or its mode"
MOVE_START_INTO_RANGE = "move it into the range of a mode"


@message
def start_outside_mode(start: str, mode: str) -> str:
    """A start, as text, outside the range of the mode that it names."""
    return f"the start {start} is outside the range of its mode '{mode}'"


@message
def start_in_no_mode(start: str, modes: Sequence[str]) -> str:
    """A start, as text, outside the ranges of all modes."""
    names = ", ".join(f"'{name}'" for name in modes)
    return f"the start {start} is in the range of no mode ({names})"


@message
def time_limit_reached(limit_s: float, stage: str, state: str) -> str:
    """A stage of planning that was cut off, and how far it was."""
    return f"the time limit of {limit_s:g} s (solve_time_limit_s) was reached in the {stage}: {state}"


def raise_time_limit(setting: str) -> str:
    """The remedy; a setting that shortens the stage, or empty."""
    return "raise solve_time_limit_s" + (f" or lower {setting}" if setting else "")
