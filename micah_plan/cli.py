"""The command line. Exit codes: 0 done, 1 an honest negative (no plan), 2 bad input.

Results go to stdout (with --json exactly one JSON object), progress and errors to stderr. Wrong usage is bad input: one
line, before any work, and so are outputs of a wrong kind or that would overwrite an input or one another.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from micah_plan import __version__, summaries
from micah_plan import cli_tables as tables
from micah_plan.cli_tables import out
from micah_plan.errors import InputError, MicahError, MissingDependencyError
from micah_plan.outputs import FIGURE, MODEL, PAGE, PLAN, RUNS, Output, check_outputs

HONEST_NEGATIVE = 1
BAD_INPUT = 2
INTERRUPTED = 130
# Brackets are markup unless they are escaped.

# Click's UsageError: typer has its own copy of click from 0.2x on, so only this way leads to the one that is raised.
_UsageError: type[Exception] = typer.BadParameter.__bases__[0]

app = typer.Typer(
    help="From a recorded demonstration of an articulated object to a plan that holds under uncertainty.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
err = Console(stderr=True, soft_wrap=True, highlight=False)


class LearnMethod(StrEnum):
    """How segments are scored: with the actions or by the poses alone."""

    ACT_CHAMP = "act-champ"
    CHAMP = "champ"


class PlantName(StrEnum):
    """Where a plan is executed."""

    NOMINAL = "nominal"
    MUJOCO = "mujoco"


PlannerName = StrEnum("PlannerName", {"POMDP_HD": "pomdp-hd", "DIRECT": "direct", "RRT": "rrt"})
JsonFlag = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of all that is random; same seed, same bytes.")]
OutputPath = Annotated[Path, typer.Option("-o", "--output", help="File to write.")]


def main() -> None:
    """Entry point of `micah-plan`: runs a command and turns errors into one line and an exit code."""
    try:
        code = app(prog_name="micah-plan", standalone_mode=False) or 0
    except _UsageError as error:
        _fail(_usage_line(error), BAD_INPUT)
    except (InputError, MissingDependencyError) as error:
        _fail(error, BAD_INPUT)
    except MicahError as error:
        _fail(error, HONEST_NEGATIVE)
    except (KeyboardInterrupt, typer.Abort):
        code = INTERRUPTED
    except Exception as error:
        _say(f"{type(error).__name__}: {error}; this is a bug in micah-plan, please report it with the lines below")
        raise
    if code == INTERRUPTED:  # what typer makes of a KeyboardInterrupt within a command
        _fail("interrupted; nothing was half-written", INTERRUPTED)
    sys.exit(code)


def _usage_line(error: Any) -> InputError:
    """What click says about wrong usage, in the form of all other errors."""
    text = " ".join(error.format_message().replace("Value error, ", "").split()).rstrip(".")
    command = error.ctx.command_path if error.ctx is not None else "micah-plan"
    return InputError(text[:1].lower() + text[1:], remedy=f"see {command} --help")


def _fail(error: MicahError | str, code: int) -> NoReturn:
    _say(error)
    sys.exit(code)


def _say(error: MicahError | str) -> None:
    text = " ".join(str(error).split())
    if "--json" in sys.argv:
        print(json.dumps({"error": text}))
    err.print(f"error: {text}", markup=False, style="red")


@app.callback(invoke_without_command=True)
def _version(
    context: typer.Context, version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False
) -> None:
    if version:
        out.print(__version__)
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(context.get_help(), err=True)
        raise typer.Exit(BAD_INPUT)


@app.command()
def learn(
    recording: Annotated[Path, typer.Argument(help="Recording (CSV, TUM text or NPZ).")],
    output: OutputPath,
    method: Annotated[
        LearnMethod, typer.Option(help="Score segments with or without the actions.")
    ] = LearnMethod.ACT_CHAMP,
    parts: Annotated[
        Path | None, typer.Option(help="Shapes and handles of the parts (YAML), added to the model.")
    ] = None,
    figure: Annotated[Path | None, typer.Option(help="Write the segmented track as PNG.")] = None,
    html: Annotated[Path | None, typer.Option(help="Write the segmented track as a page.")] = None,
    seed: Seed = 0,
    as_json: JsonFlag = False,
) -> None:
    """Learn a hybrid automaton from a recording and save it as YAML; exit code 1 if no single joint fits some rows."""
    from micah_plan import workflow
    from micah_plan.files import replace_file
    from micah_plan.learn.settings import FEWEST_ROWS
    from micah_plan.spec.model_file import dump_model
    from micah_plan.spec.parts_file import load_parts

    written = Output("-o", output, MODEL), Output("--figure", figure, FIGURE), Output("--html", html, PAGE)
    check_outputs((recording, parts), written)
    shapes = () if parts is None else load_parts(parts)
    with _progress(as_json) as progress:
        measured = workflow.read(recording, minimum_rows=FEWEST_ROWS)
        try:
            learned = workflow.learn(measured, method=method.value, seed=seed, parts=shapes, progress=progress)
        except InputError as error:
            raise error.located(recording) from None
    for warning in learned.warnings:
        err.print(f"warning: {warning}", markup=False, style="yellow")
    if learned.automaton is not None:
        dump_model(learned.automaton, output)
    if figure is not None:
        from micah_plan.view.figures import save_figure
        from micah_plan.view.learning_figure import learning_figure

        save_figure(learning_figure(learned.recording, learned.graph), figure)
    if html is not None:
        from micah_plan.view.page import recording_page

        replace_file(html, recording_page(learned.recording, learned.graph, title=recording.stem).encode())
    summary = summaries.learned(learned, seed)
    files = (output if learned.automaton is not None else None, figure, html)
    _report(as_json, summary, lambda: tables.print_learned(learned, files))
    if learned.automaton is None:
        raise typer.Exit(HONEST_NEGATIVE)


@app.command()
def solve(
    problem: Annotated[Path, typer.Argument(help="Problem (YAML).")],
    output: OutputPath,
    model: Annotated[
        Path | None, typer.Option(help="Model (YAML) to use instead of the one that the problem names.")
    ] = None,
    html: Annotated[Path | None, typer.Option(help="Write the plan as a page.")] = None,
    figure: Annotated[Path | None, typer.Option(help="Write the belief trajectory as PNG.")] = None,
    planner: Annotated[PlannerName | None, typer.Option(help="Planner, if not as in the problem.")] = None,
    seed: Seed = 0,
    as_json: JsonFlag = False,
) -> None:
    """Plan in belief space; exit code 1 if there is no plan."""
    from micah_plan import workflow
    from micah_plan.files import replace_file
    from micah_plan.spec.plan_file import timings_path, write_plan, write_timings
    from micah_plan.spec.problem_file import load_problem

    outputs = [Output("-o", output, PLAN), Output("--html", html, PAGE), Output("--figure", figure, FIGURE)]
    outputs += [Output("the times of -o", timings_path(output), PLAN)] if output.suffix else []
    check_outputs((problem, model), outputs)
    overrides = {} if model is None else {"model": str(model.resolve())}
    overrides |= {} if planner is None else {"planner.method": planner.value}
    asked = load_problem(problem, overrides)
    with _progress(as_json) as progress:
        plan = workflow.solve(asked, seed=seed, progress=progress)
    write_plan(plan, asked, output)
    write_timings(plan, output)
    if html is not None:
        from micah_plan.view.page import plan_page

        replace_file(html, plan_page(plan, asked, title=problem.stem).encode())
    if figure is not None and plan.trajectory is not None:
        from micah_plan.view.figures import belief_figure, save_figure

        save_figure(belief_figure(asked, plan), figure)
    written = (output, html, figure if plan.trajectory is not None else None)
    _report(as_json, summaries.solved(plan), lambda: tables.print_solved(plan, asked, written))
    if plan.outcome != "solved":
        raise typer.Exit(HONEST_NEGATIVE)


@app.command()
def explain(
    plan: Annotated[Path, typer.Argument(help="Plan (JSON) that `solve` wrote, with any outcome.")],
    as_json: JsonFlag = False,
) -> None:
    """Say what a plan ran into: level, mode sequence, knot, constraint, amount and remedy; exit code 1 if it failed."""
    from micah_plan.planning.explain import explain as explained
    from micah_plan.spec.plan_file import load_plan

    stored = load_plan(plan)
    explanation = explained(stored.problem, stored.plan)
    _report(as_json, summaries.explained(explanation), lambda: tables.print_lines(explanation.lines))
    if stored.plan.outcome != "solved":
        raise typer.Exit(HONEST_NEGATIVE)


@app.command()
def execute(
    plan: Annotated[Path, typer.Argument(help="Plan (JSON) that `solve` wrote.")],
    output: OutputPath,
    plant: Annotated[PlantName, typer.Option(help="The model with noise, or independent physics.")] = PlantName.NOMINAL,
    trials: Annotated[int, typer.Option(min=1, help="Number of seeded trials.")] = 1,
    replan_every: Annotated[int | None, typer.Option(min=0, help="Plan anew every so many steps; 0: never.")] = None,
    figure: Annotated[Path | None, typer.Option(help="Write planned belief against executed runs as PNG.")] = None,
    seed: Seed = 0,
    as_json: JsonFlag = False,
) -> None:
    """Execute a plan in closed loop and write the runs as a recording."""
    from micah_plan import workflow
    from micah_plan.recording.read import write_recording
    from micah_plan.spec.plan_file import load_plan, require_executable

    check_outputs((plan,), (Output("-o", output, RUNS), Output("--figure", figure, FIGURE)))
    stored = load_plan(plan)
    require_executable(stored)
    begin = time.perf_counter()
    with _progress(as_json) as progress:
        run = partial(workflow.execute, stored.problem, stored.plan, plant=plant.value, trials=trials, seed=seed)
        statistics = run(replan_every=replan_every, progress=progress)
    write_recording(statistics.recording, output)
    if figure is not None:
        from micah_plan.view.figures import belief_figure, save_figure

        save_figure(belief_figure(stored.problem, stored.plan, statistics.recording), figure)
    summary = summaries.executed(statistics, time.perf_counter() - begin)
    _report(as_json, summary, lambda: tables.print_executed(summary, (output, figure)))


@app.command()
def predict(
    model: Annotated[Path, typer.Argument(help="Model (YAML).")],
    recording: Annotated[Path, typer.Argument(help="Recording with actions.")],
    as_json: JsonFlag = False,
) -> None:
    """Compare measured motion with the model's one-step and roll-out predictions."""
    from micah_plan import workflow
    from micah_plan.spec.model_file import load_model

    automaton = load_model(model)
    measured = workflow.read(recording, minimum_rows=2)
    try:
        runs = workflow.predict(automaton, measured)
    except InputError as error:
        raise error.located(recording) from None
    summary = summaries.predicted(runs)
    _report(as_json, summary, lambda: tables.print_predicted(summary))


@app.command()
def calibrate(
    model: Annotated[Path, typer.Argument(help="Model (YAML).")],
    recording: Annotated[Path, typer.Argument(help="Recording with actions: executed runs or a demonstration.")],
    output: OutputPath,
    report: Annotated[Path | None, typer.Option(help="Write what was compared and found as a page.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Find what a model lacks and write it with that added; exit code 1 if something is missing that has no name."""
    from micah_plan import workflow
    from micah_plan.spec.model_file import dump_model, load_model

    check_outputs((model, recording), (Output("-o", output, MODEL), Output("--report", report, PAGE)))
    automaton = load_model(model)
    measured = workflow.read(recording, minimum_rows=2)
    begin = time.perf_counter()
    with _progress(as_json) as progress:
        try:
            found = workflow.calibrate(automaton, measured, progress=progress)
        except InputError as error:
            raise error.located(recording) from None
    dump_model(found.automaton, output)
    if report is not None:
        from micah_plan.files import replace_file
        from micah_plan.view.page import calibration_page

        replace_file(report, calibration_page(found, title=recording.stem).encode())
    summary = summaries.calibrated(found, time.perf_counter() - begin)
    _report(as_json, summary, lambda: tables.print_calibrated(summary, (output, report)))
    if found.verdict == "unexplained":
        raise typer.Exit(HONEST_NEGATIVE)


@app.command()
def show(
    file: Annotated[Path, typer.Argument(help="A recording, a model or a plan.")],
    output: OutputPath,
    as_json: JsonFlag = False,
) -> None:
    """Write a self-contained page of a recording, a model or a plan."""
    from micah_plan.files import replace_file

    check_outputs((file,), (Output("-o", output, PAGE),))
    with _progress(as_json) as progress:
        kind, page = _page_of(file, progress)
    replace_file(output, page.encode())
    summary = {"kind": kind, "page": str(output), "bytes": len(page.encode())}
    _report(as_json, summary, lambda: tables.print_files((output,)))


def _page_of(file: Path, progress: Callable[[str, float], None]) -> tuple[str, str]:
    from micah_plan import workflow
    from micah_plan.view import page

    if file.suffix.lower() in (".yaml", ".yml"):
        from micah_plan.spec.model_file import load_model

        return "model", page.model_page(load_model(file), title=file.stem)
    if file.suffix.lower() == ".json":
        from micah_plan.spec.plan_file import load_plan

        stored = load_plan(file)
        return "plan", page.plan_page(stored.plan, stored.problem, title=file.stem)
    recording = workflow.read(file)
    if not workflow.is_long_enough(recording):  # the track alone is still worth seeing
        return "recording", page.recording_page(recording, None, title=file.stem)
    try:
        learned = workflow.learn(recording, progress=progress)
    except InputError as error:
        raise error.located(file) from None
    return "recording", page.recording_page(recording, learned.graph, title=file.stem)


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[str, float], None]]:
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=err, transient=True, disable=quiet or not err.is_terminal) as bars:
        task = bars.add_task("starting", total=1.0)
        yield lambda message, fraction: bars.update(task, description=message, completed=fraction)


def _report(as_json: bool, summary: dict[str, Any], human: Callable[[], None]) -> None:
    if as_json:
        print(json.dumps(summary, allow_nan=False))
    else:
        human()
