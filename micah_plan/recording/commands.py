"""Meaning of recorded commands: a displacement, a position, or a velocity.

The action of a row is a vector (ax, ay, az). For a machine that follows *displacements* it is the commanded
displacement from the part's current place. For one that follows *positions* it is the displacement from the measured
pose to the commanded place: the machine goes to that place from wherever the part is, so that earlier errors are made
up for. For one that follows *velocities* it is a velocity [m/s], which over the time to the next row is a displacement.

A recording states which of the first two it is in a column `command_meaning`, the same in all rows; velocities are
converted to displacements on reading. Without a statement, calibration compares both (`residual.command_meaning`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, cast, get_args

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.errors import InputError, shown
from micah_plan.recording.value import Recording

Meaning = Literal["displacement", "position"]
"""What the actions of a recording mean."""
CommandKind = Literal["displacement", "position", "velocity"]
"""What the commands of a file mean, as users say it."""

MEANING_COLUMN = "command_meaning"
TARGETS = ("target x", "target y", "target z")
"""Columns with the commanded place of the part's origin in the base frame, in place of actions."""


def command_meaning(recording: Recording) -> Meaning | None:
    """The meaning of a recording's actions; None where it is not stated.

    Raises:
        InputError: if its column has another value, or different ones.
    """
    texts = recording.extra.get(MEANING_COLUMN)
    if not texts:
        return None
    for row, text in enumerate(texts):
        if text != texts[0] or text not in get_args(Meaning):
            expected = " or ".join(get_args(Meaning))
            problem = f"expected {expected}, the same in all rows, found {shown(text)}"
            raise InputError(problem, where=f"row {row + 1}, column '{MEANING_COLUMN}'", remedy="split the recording")
    return cast(Meaning, texts[0])


def with_commands(recording: Recording, kind: CommandKind) -> Recording:
    """The recording with a stated kind of commands; velocities [m/s] become displacements [m].

    Raises:
        InputError: if it has no actions, or states another kind.
    """
    if kind not in get_args(CommandKind):
        raise InputError(f"commands: expected one of {', '.join(get_args(CommandKind))}, found {shown(str(kind))}")
    if recording.action is None:
        remedy = "leave it out, or name the columns of the actions or targets"
        raise InputError(f"commands of the kind {kind} are given, but the recording has no commands", remedy=remedy)
    stated = command_meaning(recording)
    if stated is not None and stated != kind:
        problem = f"commands of the kind {kind} are given, but the column '{MEANING_COLUMN}' has {stated}"
        raise InputError(problem, remedy="leave out the option, or remove the column")
    action = recording.action
    if kind == "velocity":
        action = action * _time_to_next(recording)[:, None]
    meaning: Meaning = "position" if kind == "position" else "displacement"
    return replace(recording, action=action, extra={**recording.extra, MEANING_COLUMN: (meaning,) * len(recording)})


def with_targets(recording: Recording, target: Floats) -> Recording:
    """The recording with commanded positions (n, 3) [m, base frame] as its actions, NaN where there is none.

    Raises:
        InputError: if it has actions as well.
    """
    if recording.action is not None:
        raise InputError("a recording has actions or targets, not both", remedy=f"leave out {shown(TARGETS[0])}")
    return with_commands(replace(recording, action=target - recording.position), "position")


def check_one_meaning(recordings: Sequence[Recording]) -> None:
    """Refuse to join recordings whose commands have different meanings.

    Raises:
        InputError: if they do.
    """
    meanings = dict.fromkeys(command_meaning(recording) for recording in recordings if recording.has_actions)
    if len(meanings) > 1:
        named = ", ".join(meaning or "not said" for meaning in meanings)
        problem = f"the commands of recordings that are joined mean different things: {named}"
        raise InputError(problem, remedy="state one meaning for all of them, or calibrate with those of one meaning")


def _time_to_next(recording: Recording) -> Floats:
    """(n,) seconds from each row to the next of its run and part; NaN in the last."""
    period = np.full(len(recording), np.nan)
    for run in recording.runs:
        for part in recording.parts:
            rows = np.atleast_1d(recording.index(run=run, part=part))
            period[rows[:-1]] = np.diff(recording.time[rows])
    return period
