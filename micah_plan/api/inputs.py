"""Inputs of the public functions: paths, values, or results that contain them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import fields, replace
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

import numpy as np

from micah_plan.api.result import Result
from micah_plan.automaton.check import check_automaton
from micah_plan.automaton.hybrid import HybridAutomaton, Part
from micah_plan.errors import InputError, choices, located_in, shown
from micah_plan.learning.settings import FEWEST_ROWS, LearnSettings
from micah_plan.quantities import quantity
from micah_plan.recording.checks import checked_recording
from micah_plan.recording.commands import check_one_meaning
from micah_plan.recording.conventions import Conventions
from micah_plan.recording.value import Recording
from micah_plan.task.problem import Problem
from micah_plan.task.settings import PlannerSettings

Source = str | Path
Modelled = Source | Mapping[str, Any] | HybridAutomaton | Result | Problem
"""A model, or what has one: a path of a model, problem or plan, data with the keys of a model file, values, results."""
Problematic = Source | Mapping[str, Any] | Problem | HybridAutomaton | Result
"""A problem, or what has one: a path, data with the keys of a problem file, values, results; a model, or what has one,
stands for the problem of moving it most of its way."""


class DataFrame(Protocol):
    """A table of pandas, polars or the like."""

    @property
    def columns(self) -> Any:
        """Names of its columns."""

    def __getitem__(self, name: Any, /) -> Any:
        """A column."""


Measured = Source | Recording | Result | DataFrame | Mapping[str, Any] | Sequence["Measured"]
"""A recording, or what has one: a path, a value, a table with the columns of a recording CSV, arrays by the names of a
recording's attributes, executed runs, what was learned; or several, whose runs are joined."""


def located(source: object) -> AbstractContextManager[None]:
    """A context that adds the file to input errors, if the source is one."""
    return located_in(source) if isinstance(source, Source) else nullcontext()


def conventions_of(values: Mapping[str, Any]) -> Conventions | None:
    """Conventions of a recording from keywords; None without any.

    Raises:
        InputError: for a name that conventions do not have.
    """
    names = [field.name for field in fields(Conventions)]
    for name in values:
        if name not in names:
            raise InputError(f"conventions have no {shown(name)}", remedy=f"choose among {', '.join(names)}")
    return Conventions(**values) if values else None


def recording_of(source: Measured, *, minimum_rows: int = 1, conventions: Conventions | None = None) -> Recording:
    """A recording with validated rows; the conventions apply to paths.

    Raises:
        InputError: for recordings that `recording.checks` refuses, such as a quaternion of zeros, and for anything
            else.
    """
    from micah_plan.exchange.load import load_recording

    if isinstance(source, Source):
        return load_recording(source, minimum_rows=minimum_rows, conventions=conventions)
    if isinstance(source, Result) and hasattr(source, "recording"):
        return checked_recording(source.recording, minimum_rows=minimum_rows)
    if is_table(source) or isinstance(source, Mapping):
        return checked_recording(_of_table(source, conventions), minimum_rows=minimum_rows)
    if isinstance(source, list | tuple) and source:
        return joined_recordings([recording_of(recording, minimum_rows=minimum_rows) for recording in source])
    if not isinstance(source, Recording):
        raise _wrong_type_error("a recording", source, "give the path of one, or a micah_plan.Recording")
    return checked_recording(source, minimum_rows=minimum_rows)


def is_table(value: Any) -> bool:
    """Whether something has the columns of a recording: a data frame, a table of Arrow, a mapping of such names."""
    if isinstance(value, Mapping):
        return not {"t", "x", "time", "position"}.isdisjoint(value)
    return not isinstance(value, Recording | ModuleType) and hasattr(value, "__getitem__") and bool(_names_of(value))


def _names_of(table: Any) -> list[Any]:
    """Names of the columns of a data frame or table of Arrow."""
    names = getattr(table, "column_names", None) or getattr(table, "columns", None)
    return list(names) if names is not None and not callable(names) else []


def _of_table(table: Any, conventions: Conventions | None) -> Recording:
    from micah_plan.recording.columns import recording_of_columns
    from micah_plan.recording.conventions import as_recorded

    if isinstance(table, Mapping) and "position" in table:
        known = {field.name for field in fields(Recording)} - {"conventions", "notes", "has_run", "has_part"}
        for name in table:
            if name not in known:
                raise InputError(f"a recording has no {shown(name)}", remedy=f"choose among {', '.join(sorted(known))}")
        if "time" not in table:
            raise InputError("the array 'time' is missing", remedy="give time (n,) [s] beside position (n, 3) [m]")
        try:
            made = Recording(**{"has_run": "run" in table, "has_part": "part" in table, **table})
        except (TypeError, ValueError) as error:  # texts, rows of different lengths
            text = " ".join(str(error).split())
            raise InputError(f"expected arrays of numbers ({shown(text)})", remedy="give NumPy arrays") from None
        return as_recorded(made, conventions or Conventions())
    names = list(table) if isinstance(table, Mapping) else _names_of(table)
    return recording_of_columns({str(name): table[name] for name in names}, conventions)


def joined_recordings(recordings: Sequence[Recording]) -> Recording:
    """One recording of all runs, numbered anew, with the further columns that all have."""
    from micah_plan.execution.log import concatenated_recordings

    check_one_meaning(recordings)
    common, numbered, number = set.intersection(*(set(each.extra) for each in recordings)), list[Recording](), 0
    for each in recordings:
        runs, run = np.unique(each.run, return_inverse=True)
        extra = {name: column for name, column in each.extra.items() if name in common}
        numbered.append(replace(each, run=run + number, extra=extra))
        number += len(runs)
    return checked_recording(concatenated_recordings(numbered))


def demonstration_of(source: Measured, conventions: Conventions | None = None) -> Recording:
    """A recording with enough rows for learning; files with suspicious units need explicit conventions.

    Raises:
        InputError: also where a file looks misread (`recording.suspicion`).
    """
    from micah_plan.recording.suspicion import require_conventions

    recording = recording_of(source, minimum_rows=FEWEST_ROWS, conventions=conventions)
    if isinstance(source, Source):
        with located_in(source):
            require_conventions(recording)
    return recording


def automaton_of(source: Modelled) -> HybridAutomaton:
    """A validated model; problems and plans provide theirs.

    Raises:
        InputError: if there is none in it, or it is none that can be used.
    """
    if isinstance(source, Source):
        return _read_automaton(source)
    if isinstance(source, Mapping):
        from micah_plan.documents.model import model_of

        return model_of(source)
    if isinstance(source, Problem | Result) and hasattr(source, "automaton"):
        if source.automaton is None:
            raise InputError(f"nothing was learned: {getattr(source, 'reason', '')}")
        return source.automaton
    if not isinstance(source, HybridAutomaton):
        raise _wrong_type_error(
            "a model", source, "give the path of one, what learn returns, or data with a model file's keys"
        )
    check_automaton(source)
    return source


def _read_automaton(path: Source) -> HybridAutomaton:
    from micah_plan.documents.kind import kind_of
    from micah_plan.documents.model import load_model
    from micah_plan.documents.plan import load_plan
    from micah_plan.documents.problem import load_problem

    kind = kind_of(path)
    if kind == "problem":
        return load_problem(path).automaton
    return load_plan(path).automaton if kind == "plan" else load_model(path)


def problem_of(source: Problematic, model: Modelled | None = None) -> Problem:
    """A problem, optionally with another model; for a model alone, the problem of moving it through most of its range.

    Raises:
        InputError: if it cannot be used, or the model has other coordinates.
    """
    return problem_and_notes(source, model)[0]


def problem_and_notes(source: Problematic, model: Modelled | None = None) -> tuple[Problem, tuple[str, ...]]:
    """(problem as of `problem_of`, its notes)."""
    if isinstance(source, Source):
        return _read_problem(source, model)
    automaton = None if model is None else automaton_of(model)
    if isinstance(source, Mapping):
        return _of_data(source, automaton), ()
    problem = getattr(source, "problem", source) if isinstance(source, Result) else source
    if isinstance(problem, HybridAutomaton | Result) and automaton is None:
        from micah_plan.templates.first_problem import problem_for

        return problem_for(automaton_of(problem)), ()
    if not isinstance(problem, Problem):
        raise _wrong_type_error("a problem", source, "give the path of one, or what load returns for it")
    if automaton is None:
        return problem, ()
    nominal = problem.automaton
    if problem.hold is not None or (nominal.coordinates, nominal.inputs) != (automaton.coordinates, automaton.inputs):
        raise InputError(
            f"the problem is about {', '.join(nominal.coordinate_names)}, the model has "
            f"{', '.join(automaton.coordinate_names)}",
            remedy="give the problem's file together with the model",
        )
    return replace(problem, automaton=automaton), ()


def _of_data(data: Mapping[str, Any], automaton: HybridAutomaton | None) -> Problem:
    """A problem from data with the keys of a problem file; from a model's data, that of moving it."""
    from micah_plan.documents.problem import problem_of_data
    from micah_plan.templates.first_problem import problem_for

    if "modes" in data and automaton is None:
        return problem_for(automaton_of(data))
    return problem_of_data(data, automaton)


def checked_again(problem: Problem) -> Problem:
    """A problem with a changed start or goal, if it is possible.

    Raises:
        InputError: as for a file, with the keys that it would have.
    """
    from micah_plan.documents.problem import check_possible

    check_possible(problem, "solve")
    return replace(problem, digests={role: digest for role, digest in problem.digests.items() if role != "problem"})


def _read_problem(path: Source, model: Modelled | None) -> tuple[Problem, tuple[str, ...]]:
    """A problem from its file; for a model file, the one that `micah-plan new problem` writes."""
    from micah_plan.checking import suspicions_of
    from micah_plan.documents.kind import kind_of
    from micah_plan.documents.model import load_model
    from micah_plan.documents.problem import load_problem
    from micah_plan.templates.first_problem import problem_for

    if kind_of(path) == "model":
        if model is not None:
            remedy = "give a problem, or leave out the model"
            raise InputError("a model is solved as it is", source=path, remedy=remedy)
        problem = problem_for(load_model(path), str(path))
        return problem, (_note_of_default_goal(problem),)
    if isinstance(model, Source):  # whose file is named in the plan
        problem = load_problem(path, {"model": str(Path(model).resolve())})
    else:
        problem = load_problem(path, model=None if model is None else automaton_of(model))
    return problem, suspicions_of(problem)


def _note_of_default_goal(problem: Problem) -> str:
    """The note on the default goal where only a model is given."""
    aims = []
    for i, value, _ in problem.goal.target:
        coordinate = problem.automaton.coordinates[i]
        begin, end = (quantity(float(number), coordinate.unit) for number in (problem.start.mean[i], value))
        aims.append(f"{coordinate.name} from {begin} to {end}")
    asked = f"no problem is given, so the model is moved most of its way: {', '.join(aims)}"
    return f"{asked}; `micah-plan new problem FOLDER --model MODEL` writes a problem to edit"


def parts_of(source: Source | Sequence[Part]) -> tuple[Part, ...]:
    """Shapes and handles of parts."""
    if isinstance(source, Source):
        from micah_plan.documents.parts import load_parts

        return load_parts(source)
    return tuple(source)


def learn_settings(settings: LearnSettings | None, changes: Mapping[str, Any]) -> LearnSettings:
    """Settings of learning with changes by name.

    Raises:
        InputError: for a name that is none, and a value that is none of it.
    """
    names = [item.name for item in fields(LearnSettings)]
    for name in changes:
        if name not in names:
            raise InputError(f"learn: unknown setting {shown(name)}", remedy=choices(name, names))
    return replace(settings or LearnSettings(), **changes)


def planner_settings(problem: Problem, changes: Mapping[str, Any]) -> PlannerSettings:
    """The problem's settings with changes by their names in problem files.

    Raises:
        InputError: for a name that is none, and a value that a problem file could not have.
    """
    from micah_plan.documents.planner import settings_with

    return settings_with(problem.settings, changes, problem.automaton.input_names)


def _wrong_type_error(expected: str, value: object, remedy: str) -> InputError:
    return InputError(f"expected {expected}, found {shown(type(value).__name__)}", remedy=remedy)
