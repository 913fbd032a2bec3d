"""`micah-plan predict` and `calibrate`: a model against measured motion."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from micah_plan.cli.console import NO_RESULT, JsonFlag, OutputPath, print_summary, progress_bar
from micah_plan.errors import InputError
from micah_plan.outputs import MODEL, PAGE, Output, check_outputs

if TYPE_CHECKING:
    from micah_plan.automaton.hybrid import HybridAutomaton


def predict(
    model: Annotated[Path, typer.Argument(help="Model, or the problem or plan that was executed (YAML, JSON).")],
    recording: Annotated[Path, typer.Argument(help="Recording with actions.")],
    as_learned: Annotated[
        bool, typer.Option("--actions-as-learned", help="Read actions as in the demonstration of the model.")
    ] = False,
    as_json: JsonFlag = False,
) -> None:
    """Compare measured motion with one-step and roll-out predictions, and their errors with the noise in the data.

    A held object has no model file of its own: give the problem or a plan instead.
    """
    from micah_plan import workflow
    from micah_plan.cli.reports.predicted import predicted, print_predicted

    automaton = _automaton_of(model)
    measured = workflow.read(recording, minimum_rows=2)
    try:
        automaton = workflow.for_demonstrations(automaton, measured) if as_learned else automaton
        runs = workflow.predict(automaton, measured)
    except InputError as error:
        raise error.located(recording) from None
    summary = predicted(automaton, runs)
    print_summary(as_json, summary, lambda: print_predicted(summary))


def _automaton_of(path: Path) -> HybridAutomaton:
    """The model in a file, or that of the problem in it."""
    from micah_plan.documents.kind import kind_of
    from micah_plan.documents.model import load_model
    from micah_plan.documents.plan import load_plan
    from micah_plan.documents.problem import load_problem

    kind = kind_of(path)
    if kind == "problem":
        return load_problem(path).automaton
    return load_plan(path).problem.automaton if kind == "plan" else load_model(path)


def calibrate(
    model: Annotated[Path, typer.Argument(help="Model (YAML).")],
    recording: Annotated[Path, typer.Argument(help="Recording with actions: executed runs or a demonstration.")],
    output: OutputPath,
    report: Annotated[Path | None, typer.Option(help="Write the comparison and the effects as a page.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Find what a model lacks and write it with that added; exit code 1 if something is missing that has no name."""
    from micah_plan import workflow
    from micah_plan.cli.reports.calibrated import calibrated, print_calibrated
    from micah_plan.documents.model import dump_model, load_model
    from micah_plan.documents.model_difference import differences

    check_outputs((model, recording), (Output("-o", output, MODEL), Output("--report", report, PAGE)))
    automaton = load_model(model)
    measured = workflow.read(recording, minimum_rows=2)
    begin = time.perf_counter()
    with progress_bar(as_json) as progress:
        try:
            found = workflow.calibrate(automaton, measured, progress=progress)
        except InputError as error:
            raise error.located(recording) from None
    dump_model(found.automaton, output)
    if report is not None:
        from micah_plan.files import replace_file
        from micah_plan.view.calibration_page import calibration_page

        replace_file(report, calibration_page(found, title=recording.stem).encode())
    changes = differences(automaton, found.automaton)
    summary = calibrated(found, time.perf_counter() - begin)
    summary["changes"] = [{"place": d.place, "before": d.before, "after": d.after} for d in changes]
    print_summary(as_json, summary, lambda: print_calibrated(summary, changes, (output, report)))
    if found.verdict == "unexplained":
        raise typer.Exit(NO_RESULT)
