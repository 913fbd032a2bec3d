"""Whether files can be used, said for each of them without solving, learning or executing anything."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from micah_plan.documents.kind import FileKind, kind_of
from micah_plan.documents.model_file import load_model
from micah_plan.documents.parts_file import load_parts
from micah_plan.documents.plan_file import load_plan
from micah_plan.documents.problem_file import load_problem
from micah_plan.documents.sweep_file import load_sweep
from micah_plan.errors import InputError
from micah_plan.recording.read import read_recording
from micah_plan.recording.suspicion import suspicions


@dataclass(frozen=True, eq=False)
class FileCheck:
    """What was found in a file.

    Attributes:
        file: as it was named.
        kind: None if it is of none that is known.
        faults: why it cannot be used, first in the file first; empty if it can. Values of a YAML file are looked at
            together, what they mean one after the other, so that mending these may bring up others.
        warnings: what looks like a mistake but can be used, one line each.
    """

    file: Path
    kind: FileKind | None
    faults: tuple[InputError, ...] = ()
    warnings: tuple[str, ...] = ()


def check_file(path: str | Path) -> FileCheck:
    """Read a file of any kind as the commands do, a problem with its model and robot, a sweep with its problems."""
    file, kind = Path(path), None
    try:
        kind = kind_of(file)
        return FileCheck(file, kind, warnings=_checked(file, kind))
    except InputError as error:
        return FileCheck(file, kind, faults=error.each())


def _checked(file: Path, kind: FileKind) -> tuple[str, ...]:
    """Warnings about a file that can be used."""
    if kind == "recording":
        return suspicions(read_recording(file))
    if kind == "model":
        load_model(file)
    elif kind == "parts":
        load_parts(file)
    elif kind == "plan":
        load_plan(file)
    elif kind == "sweep":
        load_sweep(file)
    else:
        robot = load_problem(file).robot
        if robot is not None:
            from micah_plan.robot.load_arm import load_arm

            load_arm(robot)
    return ()
