"""Whether files can be used, said for each of them without solving, learning or executing anything."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from micah_plan.documents.kind import FileKind, kind_of
from micah_plan.errors import InputError


@dataclass(frozen=True, eq=False)
class FileCheck:
    """What was found in a file.

    Attributes:
        file: as it was named.
        kind: None if unknown.
        faults: why it cannot be used, first in the file first; empty if it can. Values of a YAML file are looked at
            together, what they mean one after the other, so that correcting these may reveal others.
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
    """Warnings about a file that can be used. Readers are imported where they are used: a file waits for its own."""
    if kind == "recording":
        from micah_plan.recording.read import read_recording
        from micah_plan.recording.suspicion import suspicions

        return suspicions(read_recording(file))
    if kind == "model":
        from micah_plan.automaton.suspicion import suspicions as suspicions_of_model
        from micah_plan.documents.model import load_model

        return suspicions_of_model(load_model(file))
    if kind == "parts":
        from micah_plan.automaton.suspicion import far_handles
        from micah_plan.documents.parts import load_parts

        return tuple(far_handles(load_parts(file)))
    if kind == "plan":
        from micah_plan.documents.plan import load_plan

        load_plan(file)
    elif kind == "scene":
        from micah_plan.documents.exploration import load_scene
        from micah_plan.task.suspicion import suspicions_of_scene

        return suspicions_of_scene(load_scene(file))
    if kind == "experiment":
        from micah_plan.documents.experiment import load_experiment

        load_experiment(file)
    elif kind == "sweep":
        from micah_plan.documents.sweep import load_sweep

        load_sweep(file)
    else:
        from micah_plan.documents.problem import load_problem

        problem = load_problem(file)
        if problem.robot is not None:
            from micah_plan.robot.load_arm import load_arm

            load_arm(problem.robot)
            if problem.release is not None:
                from micah_plan.robot.along_release import with_open_gripper

                load_arm(with_open_gripper(problem))
        from micah_plan.automaton.suspicion import suspicions as suspicions_of_model
        from micah_plan.task.suspicion import suspicions as suspicions_of_problem

        # The modes of a held object are contacts of the hand's own model.
        of_model = () if problem.hold is not None else suspicions_of_model(problem.automaton)
        return (*of_model, *suspicions_of_problem(problem))
    return ()
