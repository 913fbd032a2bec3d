"""Files of any kind as values, and values as files and pages."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from micah_plan.api import inputs
from micah_plan.api.inputs import DataFrame, Source
from micah_plan.api.planning import PlanningResult, plan_of
from micah_plan.api.result import Page, Result, save_model
from micah_plan.automaton.hybrid import HybridAutomaton, Part
from micah_plan.errors import InputError
from micah_plan.recording.value import Recording
from micah_plan.task.experiment import Experiment
from micah_plan.task.problem import Problem
from micah_plan.task.sweep import Sweep

Loaded = Recording | HybridAutomaton | Problem | PlanningResult | Sweep | Experiment | tuple[Part, ...]
"""What files hold."""


def load(source: Source | DataFrame | Mapping[str, Any], **conventions: Any) -> Loaded:
    """Load a file of any kind: a recording, model, problem, plan, sweep, experiment or shapes of parts.

    Args:
        source: the file; a table with the columns of a recording CSV; or data with the keys of a model file (a model
            made by hand, with names), or with those of a problem file.
        **conventions: of a recording, how it is meant (`Conventions`), as in ``columns={"t": "Time", "x": "TX"},
            length="mm", up="y"``.

    Raises:
        InputError: if it cannot be used; one line with the place, expected and found content, and a remedy.
    """
    if isinstance(source, Mapping) and not inputs.is_table(source) and "columns" not in conventions:
        return inputs.problem_of(source) if "goal" in source else inputs.automaton_of(source)
    if not isinstance(source, Source):
        return inputs.recording_of(source, conventions=inputs.conventions_of(conventions))
    from micah_plan.documents.kind import kind_of

    kind = kind_of(source)
    if kind == "recording":
        return inputs.recording_of(source, conventions=inputs.conventions_of(conventions))
    if conventions:
        raise InputError(f"a {kind} has no conventions", source=source, remedy="leave them out")
    if kind == "problem":
        return inputs.problem_of(source)
    if kind == "plan":
        return plan_of(source)
    if kind == "parts":
        return inputs.parts_of(source)
    if kind == "sweep":
        from micah_plan.documents.sweep import load_sweep

        return load_sweep(source)
    if kind == "experiment":
        from micah_plan.documents.experiment import load_experiment

        return load_experiment(source)
    return inputs.automaton_of(source)


def save(value: Any, path: str | Path) -> None:
    """Write a recording, a model, or the main output of a result, atomically.

    Raises:
        InputError: if the file cannot be written, or there is nothing to write.
    """
    from micah_plan.recording.read import write_recording

    if isinstance(value, Result):
        value.save(path)
    elif isinstance(value, HybridAutomaton):
        save_model(value, "", path)
    elif isinstance(value, Recording):
        write_recording(value, path)
    else:
        raise InputError(f"there is no file for a {type(value).__name__}", remedy="give a recording, model or result")


def show(value: Any, path: str | Path | None = None, *, before: Any = None) -> Page:
    """The page of a recording, a model, a problem or a result: opened in the browser, or within a notebook.

    Args:
        value: to show.
        path: of the page to write, without opening it; None: a temporary file.
        before: runs before a change, as a result or a recording, to compare with those that `execute` returned.

    Raises:
        InputError: if there is no page of such a value, or there are no runs to compare.
    """
    if before is not None:
        from micah_plan.api.execution import RunsResult

        earlier = before.recording if isinstance(before, RunsResult) else before
        if not isinstance(value, RunsResult) or not isinstance(earlier, Recording):
            problem = f"expected runs before and after, found a {type(before).__name__} and a {type(value).__name__}"
            raise InputError(problem, where="before", remedy="give what execute returned, or the recording of its runs")
        return Page(value.page(before=earlier)).opened(path)
    if isinstance(value, Result):
        return value.show(path)
    if isinstance(value, Recording):
        from micah_plan.view.recording_page import recording_page

        return Page(recording_page(value)).opened(path)
    if isinstance(value, HybridAutomaton):
        from micah_plan.view.model_page import model_page

        return Page(model_page(value)).opened(path)
    if isinstance(value, Problem):
        from micah_plan.view.plan_page import problem_page

        return Page(problem_page(value)).opened(path)
    raise InputError(
        f"there is no page of a {type(value).__name__}", remedy="give a recording, model, problem or result"
    )
