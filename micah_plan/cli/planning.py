"""`micah-plan solve`, `explain` and `execute`: from a problem to a plan and to its runs.

**Plants.** The machine of a user is named on the command line: ``FILE.py:CLASS``, or a name that an installed package
registered.

This is the only place that loads code which is not the package's. It is above everything that reads files, so no
problem, sweep or plan can have code loaded.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import partial
from importlib.metadata import EntryPoint, entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from micah_plan.api.formatting import plan_lines, runs_lines
from micah_plan.cli.console import (
    NO_RESULT,
    Interrupted,
    JsonFlag,
    OutputPath,
    Seed,
    out,
    print_files,
    print_lines,
    print_summary,
    print_warnings,
    progress_bar,
    title_of,
)
from micah_plan.errors import InputError, MicahError, shown
from micah_plan.files import FIGURE, PAGE, PLAN, RUNS, Output, check_outputs
from micah_plan.quantities import LARGEST, duration
from micah_plan.task.plants import BUILT_IN, DEFAULT_PLANT, SENTENCES

if TYPE_CHECKING:
    from micah_plan.documents.plan import StoredPlan
    from micah_plan.execution.plant import PlantMaker
    from micah_plan.execution.trials import TrialStatistics
    from micah_plan.recording.value import Recording
    from micah_plan.task.plan import ArmTrajectory, Plan
    from micah_plan.task.problem import Problem


def solve(
    problem: Annotated[Path, typer.Argument(help="Problem (YAML), or a model that is moved most of its way.")],
    output: OutputPath,
    model: Annotated[
        Path | None, typer.Option(help="Model (YAML) to use instead of the one that the problem names.")
    ] = None,
    html: Annotated[Path | None, typer.Option(help="Write the plan as a page.")] = None,
    figure: Annotated[Path | None, typer.Option(help="Write the belief trajectory as PNG.")] = None,
    seed: Seed = 0,
    as_json: JsonFlag = False,
) -> None:
    """Plan in belief space; exit code 1 if there is no plan."""
    from micah_plan.api import stages
    from micah_plan.documents.plan import check_timings, plan_text, timings_path, timings_text
    from micah_plan.files import replace_files

    outputs = [Output("-o", output, PLAN), Output("--html", html, PAGE), Output("--figure", figure, FIGURE)]
    outputs += [Output("the times of -o", timings_path(output), PLAN)] if output.suffix else []
    check_outputs((problem, model), outputs)  # which end otherwise than what a problem names
    check_timings(output)
    overrides = {} if model is None else {"model": str(model.resolve())}
    asked, notes = stages.read_problem(problem, overrides)
    with progress_bar(as_json) as progress:
        plan = stages.solve(asked, seed=seed, progress=progress)
    print_warnings((*notes, *plan.warnings))
    contents = {output: plan_text(plan, asked).encode(), timings_path(output): timings_text(plan).encode()}
    if html is not None:
        from micah_plan.view.plan_page import plan_page

        contents[html] = plan_page(plan, asked, title=title_of(problem)).encode()
    if figure is not None and plan.trajectory is not None:
        from micah_plan.view.figures import belief_figure, png

        contents[figure] = png(belief_figure(asked, plan))
    replace_files(contents)
    written = (output, html, figure if plan.trajectory is not None else None)
    print_summary(as_json, _solved(plan), lambda: _print_solved(plan, asked, written))
    if plan.outcome != "solved":
        raise typer.Exit(NO_RESULT)


def _solved(plan: Plan) -> dict[str, Any]:
    """Keys of `solve`."""
    return {
        "outcome": plan.outcome,
        "reason": plan.reason,
        "modes": plan.mode_sequence,
        "cost": plan.cost,
        "goal_error": plan.goal_error,
        "goal_std": plan.goal_std,
        "success_probability": plan.success_probability,
        "success_interval": plan.success_interval,
        "verification_trials": plan.verification_trials,
        "findings": [asdict(finding) for finding in plan.findings],
        "warnings": plan.warnings,
        "arm": None if plan.arm is None else _arm(plan.arm),
        "seconds": plan.timings,
        "seed": plan.seed,
    }


def _arm(arm: ArmTrajectory) -> dict[str, Any]:
    return {
        "least_clearance": arm.least_clearance,
        "closest_pair": arm.closest_pair,
        "closest_knot": arm.closest_knot,
        "least_manipulability": float(arm.manipulability.min()),
        "deviation": arm.deviation,
        "limit_margin": arm.limit_margin,
        "limit_joint": arm.limit_joint,
    }


def _print_solved(plan: Plan, problem: Problem, files: tuple[Path | None, ...]) -> None:
    """Outcome and figures of a plan; of one that failed, what stands in the way."""
    solved = plan.outcome == "solved"
    out.print(f"{plan.outcome}: {plan.reason}", style="green" if solved else "yellow")
    if not solved:
        from micah_plan.planning.findings import explain as explanation_of

        print_lines(explanation_of(problem, plan).lines[1:])
    print_lines(plan_lines(plan, problem))
    named = ", ".join(f"{stage} {duration(seconds)}" for stage, seconds in plan.timings.items())
    out.print(f"  time         {named}")
    print_files(files)


def explain(
    plan: Annotated[Path, typer.Argument(help="Plan (JSON) that `solve` wrote, with any outcome.")],
    as_json: JsonFlag = False,
) -> None:
    """Explain a plan: level, mode sequence, knot, constraint, amount, remedy; exit code 1 if it failed."""
    from micah_plan.documents.plan import load_plan
    from micah_plan.planning.findings import explain as explanation_of

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
    html: Annotated[Path | None, typer.Option(help="Write the runs beside the plan as a page.")] = None,
    start: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="Where simulated trials truly start, whatever is believed [rad or m]."),
    ] = None,
    seed: Seed = 0,
    as_json: JsonFlag = False,
) -> None:
    """Execute a plan in closed loop and write the runs as a recording, also when it is interrupted.

    With a plant of your own, give --plant FILE.py:CLASS: the class is called with the problem and has reset, apply and
    close. Exit code 1 if the machine cannot be reset, 2 if its code fails; a failed trial is a result, exit code 0.
    """
    from micah_plan.api import stages
    from micah_plan.documents.kind import kind_of
    from micah_plan.documents.plan import load_plan, require_executable
    from micah_plan.files import replace_files
    from micah_plan.recording.read import recording_bytes

    outputs = Output("-o", output, RUNS), Output("--figure", figure, FIGURE), Output("--html", html, PAGE)
    check_outputs((plan,), outputs)
    if kind_of(plan) == "experiment":
        others = {"--replan-every": replan_every, "--figure": figure, "--html": html, "--start": start}
        _refuse(others, plan)
        _carry_out(plan, output, plant, trials, seed, as_json)
        return
    stored, trials = load_plan(plan), trials or 1
    require_executable(stored)
    machine, problem = named_plant(plant), starting_at(stored.problem, start or ())
    print_warnings(stored.plan.warnings)
    begin = time.perf_counter()
    with _kept_logs(output) as logs, progress_bar(as_json) as progress:
        run = partial(stages.execute, problem, stored.plan, plant=machine, trials=trials, seed=seed)
        statistics = run(replan_every=replan_every, progress=progress, keep=logs.append)
    drawn = _drawn_runs(stored, statistics, title_of(plan), figure, html)
    replace_files({output: recording_bytes(statistics.recording, output), **drawn})
    summary, unit = _executed(statistics, time.perf_counter() - begin), stored.problem.goal_unit
    print_summary(
        as_json, summary, lambda: _print_executed(runs_lines(statistics, unit, trials), (output, figure, html))
    )


def _refuse(options: Mapping[str, object], experiment: Path) -> None:
    """Refuse options that have no meaning for commands in open loop."""
    for name, value in options.items():
        if value is not None:
            raise InputError(f"{name} is for plans, this is an experiment", source=experiment, remedy=f"omit {name}")


def _carry_out(file: Path, output: Path, plant: str, repetitions: int | None, seed: int, as_json: bool) -> None:
    """The runs of an experiment as a recording."""
    from micah_plan.documents.experiment import load_experiment
    from micah_plan.execution.open_loop import carry_out
    from micah_plan.recording.read import write_recording

    asked, machine = load_experiment(file), named_plant(plant)
    asked = asked if repetitions is None else replace(asked, repetitions=repetitions)
    begin = time.perf_counter()
    with _kept_logs(output) as logs, progress_bar(as_json) as progress:
        log, failed = carry_out(asked, plant=machine, seed=seed, progress=progress, keep=logs.append)
    write_recording(log, output)
    summary = {
        "trials": len(log.runs),
        "rows": len(log.time),
        "failures": [{"trial": run, "reason": reason} for run, reason in failed],
        "seconds": time.perf_counter() - begin,
    }
    lines = [f"{len(log.runs)} runs carried out, {len(failed)} broken off", *(f"  run {n}: {why}" for n, why in failed)]
    print_summary(as_json, summary, lambda: _print_executed(lines, (output,)))


def _drawn_runs(
    stored: StoredPlan, statistics: TrialStatistics, title: str, figure: Path | None, html: Path | None
) -> dict[Path, bytes]:
    """Contents of the files that show runs beside their plan."""
    contents = dict[Path, bytes]()
    if figure is not None:
        from micah_plan.view.figures import belief_figure, png

        contents[figure] = png(belief_figure(stored.problem, stored.plan, statistics.recording))
    if html is not None:
        from micah_plan.view.plan_page import plan_page

        runs, failures = statistics.recording, dict(statistics.failures)
        page = plan_page(stored.plan, stored.problem, title=title, executed=runs, failures=failures)
        contents[html] = page.encode()
    return contents


def starting_at(problem: Problem, entries: Sequence[str]) -> Problem:
    """The problem with true starts, each as NAME=VALUE.

    Raises:
        InputError: for another form, a coordinate that there is not, or a value that is no number.
    """
    names, values = [coordinate.name for coordinate in problem.automaton.coordinates], dict(problem.start.true)
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
        values[names.index(name)] = value
    return replace(problem, start=replace(problem.start, true=tuple(values.items())))


def _executed(statistics: TrialStatistics, seconds: float) -> dict[str, Any]:
    """Keys of `execute`. `believed`: the truth is unknown, so successes and errors are what the belief says."""
    return {
        "trials": statistics.trials,
        "successes": statistics.successes,
        "believed": statistics.believed,
        "final_error": asdict(statistics.final_error),
        **({} if statistics.released is None else {"released": statistics.released}),
        "failures": [{"trial": trial, "reason": reason} for trial, reason in statistics.failures],
        "seconds": seconds,
    }


def _print_executed(lines: Sequence[str], files: tuple[Path | None, ...]) -> None:
    print_lines(lines)
    print_files(files)


@contextmanager
def _kept_logs(output: Path) -> Iterator[list[Recording]]:
    """A block that fills a list with logs, which are written also if something breaks it off."""
    logs: list[Recording] = []
    try:
        yield logs
    except BaseException as error:
        stopped = _broken_off(error, logs, output)
        if stopped is error:
            raise
        raise stopped from error


def _broken_off(error: BaseException, logs: Sequence[Recording], output: Path) -> BaseException:
    """The error that says what broke an execution off and where its logs are, which are written now; a bug stays."""
    if not logs:
        return error
    from micah_plan.execution.log import concatenated
    from micah_plan.recording.read import write_recording

    write_recording(concatenated(logs), output)
    kept = f"what was logged until then is in {output}"
    if isinstance(error, KeyboardInterrupt):
        return Interrupted(f"interrupted; {kept}")
    if isinstance(error, InputError):
        remedy = f"{error.remedy}; {kept}" if error.remedy else kept
        return InputError(error.problem, source=error.source, where=error.where, remedy=remedy)
    return type(error)(f"{error}; {kept}") if isinstance(error, MicahError) else error


ENTRY_POINTS = "micah_plan.plants"
"""Group under which packages register plants: ``NAME = "module:CLASS"``."""


def named_plant(text: str) -> str | PlantMaker:
    """What ``--plant`` means: the name of a plant of the package, or a class or function that makes one of the problem.

    Raises:
        InputError: if there is none, or its code cannot be loaded.
    """
    if text in BUILT_IN:
        return text
    place, _, name = text.rpartition(":")
    if place:
        return _in_file(Path(place), name)
    if text.endswith(".py"):
        raise InputError(f"expected FILE.py:CLASS, found {shown(text)}", remedy="name the class after a colon")
    registered = {point.name: point for point in entry_points(group=ENTRY_POINTS)}
    if text not in registered:
        names = ", ".join([*BUILT_IN, *sorted(registered.keys() - BUILT_IN.keys())])
        raise InputError(f"there is no plant {shown(text)}", remedy=f"choose among {names}, or give FILE.py:CLASS")
    return _registered(registered[text])


def _in_file(file: Path, name: str) -> PlantMaker:
    from micah_plan.execution.checked_plant import fault

    source = str(file)
    if not file.is_file():
        raise InputError("the file does not exist", source=file, remedy="give --plant as FILE.py:CLASS")
    path = str(file.resolve())
    spec = spec_from_file_location(f"_plant_{file.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError("expected a Python file", source=file, remedy="give --plant as FILE.py:CLASS")
    module = module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look there
    sys.path.append(str(Path(path).parent))  # what lies beside the file can be imported, and hides nothing
    try:
        spec.loader.exec_module(module)
    except MicahError:
        raise
    except (Exception, SystemExit) as error:
        raise fault(error, path, "loading it") from error
    return _maker(getattr(module, name, None), name, source)


def _registered(point: EntryPoint) -> PlantMaker:
    from micah_plan.execution.checked_plant import fault

    try:
        maker = point.load()
    except (Exception, SystemExit) as error:
        raise fault(error, None, f"loading the plant {shown(point.name)} ({point.value})") from error
    return _maker(maker, point.attr, point.value)


def _maker(maker: Any, name: str, source: str) -> PlantMaker:
    if maker is None:
        raise InputError(f"there is no class {shown(name)}", source=source, remedy="check its name")
    if not callable(maker):
        problem = f"{name} must be a class or function that is called with the problem. Got {type(maker).__name__}"
        raise InputError(problem, source=source)
    made: PlantMaker = maker
    return made
