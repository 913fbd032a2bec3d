"""Checks of files for usability, without solving, learning or executing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from micah_plan.documents.kind import FileKind, kind_of
from micah_plan.errors import InputError

if TYPE_CHECKING:
    from micah_plan.task.problem import Problem


@dataclass(frozen=True, eq=False)
class FileCheck:
    """Result of checking a file.

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
        return FileCheck(file, kind, warnings=_CHECKS[kind](file))
    except InputError as error:
        return FileCheck(file, kind, faults=error.each())


# Each check returns the warnings about a file that can be used. Readers are imported in the check that needs them, so
# that a file waits for its own reader alone.


def _check_recording(file: Path) -> tuple[str, ...]:
    from micah_plan.exchange.load import load_recording
    from micah_plan.recording.suspicion import suspicions_of_recording

    recording = load_recording(file)
    return recording.notes + suspicions_of_recording(recording)


def _check_model(file: Path) -> tuple[str, ...]:
    from micah_plan.automaton.plausible import suspicions_of_automaton
    from micah_plan.documents.model import load_model

    return suspicions_of_automaton(load_model(file))


def _check_parts(file: Path) -> tuple[str, ...]:
    from micah_plan.automaton.plausible import implausible, part_amounts
    from micah_plan.documents.parts import load_parts

    return tuple(implausible(part_amounts(load_parts(file))))


def _check_conventions(file: Path) -> tuple[str, ...]:
    from micah_plan.documents.conventions import load_conventions

    load_conventions(file)
    return ()


def _check_tags(file: Path) -> tuple[str, ...]:
    from micah_plan.documents.tags import load_tags

    load_tags(file)
    return ()


def suspicions_of(problem: Problem) -> tuple[str, ...]:
    """Suspicious values of a problem, its model and its plant, one line each."""
    from micah_plan.automaton.plausible import implausible, suspicions_of_automaton
    from micah_plan.execution.mujoco.parameters import amounts
    from micah_plan.task.plausible import suspicions_of_problem

    # The modes of a held object are contacts of the hand's own model.
    of_model = () if problem.hold is not None else suspicions_of_automaton(problem.automaton)
    of_plant = implausible(amounts(problem.plant, held=problem.hold is not None))
    return (*of_model, *suspicions_of_problem(problem), *of_plant)


def _check_problem(file: Path) -> tuple[str, ...]:
    from micah_plan.documents.problem import load_problem

    problem = load_problem(file)
    if problem.robot is not None:
        from micah_plan.robot.load_arm import load_arm

        load_arm(problem.robot)
        if problem.release is not None:
            from micah_plan.robot.release_path import with_open_gripper

            load_arm(with_open_gripper(problem))
    return suspicions_of(problem)


def _check_scene(file: Path) -> tuple[str, ...]:
    from micah_plan.documents.exploration_scene import load_scene
    from micah_plan.task.plausible import suspicions_of_scene

    return suspicions_of_scene(load_scene(file))


def _check_sweep(file: Path) -> tuple[str, ...]:
    from micah_plan.documents.sweep import load_sweep

    load_sweep(file)
    return ()


def _check_experiment(file: Path) -> tuple[str, ...]:
    from micah_plan.documents.experiment import load_experiment
    from micah_plan.task.plausible import suspicions_of_experiment

    return suspicions_of_experiment(load_experiment(file))


def _check_plan(file: Path) -> tuple[str, ...]:
    from micah_plan.documents.plan import load_plan
    from micah_plan.task.plausible import suspicions_of_plan

    stored = load_plan(file)
    return (*suspicions_of(stored.problem), *suspicions_of_plan(stored.plan, stored.problem))


_CHECKS: dict[FileKind, Callable[[Path], tuple[str, ...]]] = {
    "model": _check_model,
    "parts": _check_parts,
    "problem": _check_problem,
    "scene": _check_scene,
    "sweep": _check_sweep,
    "experiment": _check_experiment,
    "conventions": _check_conventions,
    "tags": _check_tags,
    "plan": _check_plan,
    "recording": _check_recording,
}
