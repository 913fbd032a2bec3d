"""`micah-plan solve`, `explain` and `execute`: from a problem to a plan and to its runs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from micah_plan.cli.console import (
    NO_RESULT,
    Interrupted,
    JsonFlag,
    OutputPath,
    Seed,
    drawn,
    print_lines,
    print_summary,
    print_warnings,
    progress_bar,
    title_of,
    write_and_print,
)
from micah_plan.cli.user_code import Code, load_code
from micah_plan.errors import InputError, MicahError, shown
from micah_plan.output_files import FIGURE, PAGE, PLAN, RUNS, Output, check_outputs
from micah_plan.quantities import LARGEST
from micah_plan.task.plants import DEFAULT_PLANT, SENTENCES

if TYPE_CHECKING:
    from micah_plan.recording.value import Recording
    from micah_plan.task.problem import Problem
from micah_plan.cli.plants import named_plant


def solve(
    problem: Annotated[Path, typer.Argument(help="Problem (YAML), or a model that is moved most of its way.")],
    output: OutputPath,
    model: Annotated[
        Path | None, typer.Option(help="Model (YAML) to use instead of the one that the problem names.")
    ] = None,
    html: Annotated[Path | None, typer.Option(help="Write the plan as a page.")] = None,
    figure: Annotated[Path | None, typer.Option(help="Write the belief trajectory as PNG.")] = None,
    code: Code = None,
    seed: Seed = 0,
    as_json: JsonFlag = False,
) -> None:
    """Plan in belief space; exit code 1 if there is no plan."""
    from micah_plan.api.planning import solve as solved
    from micah_plan.documents.plan import check_timings, plan_text, timings_path, timings_text

    outputs = [Output("-o", output, PLAN), Output("--html", html, PAGE), Output("--figure", figure, FIGURE)]
    outputs += [Output("the times of -o", timings_path(output), PLAN)] if output.suffix else []
    load_code(code)
    check_outputs((problem, model), outputs)  # which end otherwise than what a problem names
    check_timings(output)
    with progress_bar(as_json) as progress:
        result = solved(problem, model=model, seed=seed, progress=progress)
    contents = {output: plan_text(result.plan, result.problem).encode()}
    contents[timings_path(output)] = timings_text(result.plan).encode()
    contents |= drawn(result, title_of(problem), html, None if result.plan.trajectory is None else figure)
    write_and_print(result, contents, as_json)
    if not result.success:
        raise typer.Exit(NO_RESULT)


def explain(
    plan: Annotated[Path, typer.Argument(help="Plan (JSON) that `solve` wrote, with any outcome.")],
    code: Code = None,
    as_json: JsonFlag = False,
) -> None:
    """Explain the modes of a plan, or the obstacles to it with the nearest remedy; exit code 1 if it failed."""
    from micah_plan.documents.plan import load_plan
    from micah_plan.planning.findings import explain as explanation_of

    load_code(code)
    stored = load_plan(plan)
    explanation = explanation_of(stored.problem, stored.plan)
    print_summary(as_json, asdict(explanation), lambda: print_lines(explanation.lines))
    if stored.plan.outcome != "solved":
        raise typer.Exit(NO_RESULT)


def execute(
    plan: Annotated[Path, typer.Argument(help="Plan (JSON) that `solve` wrote, or an experiment (YAML).")],
    output: OutputPath,
    plant: Annotated[str, typer.Option(metavar="NAME|FILE.py:CLASS", help=f"{SENTENCES}; or yours.")] = DEFAULT_PLANT,
    trials: Annotated[
        int | None, typer.Option(min=1, help="Number of seeded trials, 1 if not given; of experiments: repetitions.")
    ] = None,
    replan_every: Annotated[
        int | None, typer.Option(min=0, help="Optimise the rest of the plan every so many steps; 0: never.")
    ] = None,
    figure: Annotated[Path | None, typer.Option(help="Write planned belief against executed runs as PNG.")] = None,
    html: Annotated[Path | None, typer.Option(help="Write a page of the runs with the plan.")] = None,
    start: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE", help="True start of simulated trials, independent of the belief [rad or m]."
        ),
    ] = None,
    anyway: Annotated[
        bool,
        typer.Option("--anyway", help="Also a plan that is not verified, in simulation, to see how it fails."),
    ] = False,
    code: Code = None,
    seed: Seed = 0,
    as_json: JsonFlag = False,
) -> None:
    """Execute a plan in closed loop and write the runs as a recording, also when it is interrupted.

    With a plant of your own, give --plant FILE.py:CLASS: the class is called with the problem and has reset, apply and
    close. Exit code 1 if the machine cannot be reset, 2 if its code fails; a failed trial is a result, exit code 0.
    """
    from micah_plan.api.execution import execute as executed
    from micah_plan.api.experiments import refuse_options_of_plans
    from micah_plan.api.planning import PlanningResult
    from micah_plan.documents.kind import kind_of
    from micah_plan.documents.plan import load_plan, require_executable
    from micah_plan.recording.read import recording_bytes

    outputs = Output("-o", output, RUNS), Output("--figure", figure, FIGURE), Output("--html", html, PAGE)
    load_code(code)
    check_outputs((plan,), outputs)
    if kind_of(plan) == "experiment":
        others = {"--replan-every": replan_every, "--figure": figure, "--html": html, "--start": start}
        others |= {"--anyway": anyway or None}
        refuse_options_of_plans(others, plan)
        _carry_out(plan, output, plant, trials, seed, as_json)
        return
    stored = load_plan(plan)
    require_executable(stored, anyway)
    planned, machine = PlanningResult(stored.plan, stored.problem), named_plant(plant)
    begun = starts_of(stored.problem, start or ())
    print_warnings(stored.plan.warnings)
    with _kept_logs(output) as logs, progress_bar(as_json) as progress:
        run = partial(executed, planned, plant=machine, trials=trials or 1, seed=seed, start=begun, anyway=anyway)
        result = run(replan_every=replan_every, progress=progress, keep=logs.append)
    contents = {output: recording_bytes(result.recording, output)} | drawn(result, title_of(plan), html, figure)
    write_and_print(result, contents, as_json)


def _carry_out(file: Path, output: Path, plant: str, repetitions: int | None, seed: int, as_json: bool) -> None:
    """The runs of an experiment as a recording."""
    from micah_plan.api.experiments import carry_out_experiment

    machine = named_plant(plant)
    with _kept_logs(output) as logs, progress_bar(as_json) as progress:
        run = partial(carry_out_experiment, file, plant=machine, repetitions=repetitions, seed=seed)
        result = run(progress=progress, keep=logs.append)
    result.save(output)
    lines = (*map(str, result.report()), f"wrote {output}")
    print_summary(as_json, result.json(), lambda: print_lines(lines))


def starts_of(problem: Problem, entries: Sequence[str]) -> dict[str, float]:
    """True starts by coordinate, each written as NAME=VALUE.

    Raises:
        InputError: for another form, a coordinate that there is not, or a value that is no number.
    """
    names, values = problem.automaton.coordinate_names, dict[str, float]()
    for entry in entries:
        name, _, text = entry.partition("=")
        if name not in names:
            raise InputError(f"--start: no coordinate {shown(name)}", remedy=f"choose among {', '.join(names)}")
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not abs(value) <= LARGEST:
            raise InputError(f"--start {name}: expected a number, found {shown(text)}", remedy="write NAME=VALUE")
        values[name] = value
    return values


@contextmanager
def _kept_logs(output: Path) -> Iterator[list[Recording]]:
    """A context that collects logs and writes them even if it is aborted."""
    logs: list[Recording] = []
    try:
        yield logs
    except BaseException as error:
        stopped = _aborted_with_logs(error, logs, output)
        if stopped is error:
            raise
        raise stopped from error


def _aborted_with_logs(error: BaseException, logs: Sequence[Recording], output: Path) -> BaseException:
    """The error of an aborted execution with the path of its logs, which are written now."""
    if not logs:
        return error
    from micah_plan.execution.log import concatenated_recordings
    from micah_plan.recording.read import write_recording

    write_recording(concatenated_recordings(logs), output)
    kept = f"what was logged until then is in {output}"
    if isinstance(error, KeyboardInterrupt):
        return Interrupted(f"interrupted; {kept}")
    if isinstance(error, InputError):
        remedy = f"{error.remedy}; {kept}" if error.remedy else kept
        return InputError(error.problem, source=error.source, where=error.where, remedy=remedy)
    return type(error)(f"{error}; {kept}") if isinstance(error, MicahError) else error
