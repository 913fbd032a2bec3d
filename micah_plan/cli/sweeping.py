"""`micah-plan sweep`: many cases at once."""

from __future__ import annotations

import time
from collections import Counter
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from micah_plan.cli.console import Interrupted, JsonFlag, out, print_files, print_summary, progress_bar
from micah_plan.errors import InputError
from micah_plan.quantities import count, duration

if TYPE_CHECKING:
    from micah_plan.sweep.run import SweepResults
    from micah_plan.sweep.workers import Workers
    from micah_plan.task.sweep import Sweep


def sweep(
    file: Annotated[Path, typer.Argument(metavar="SWEEP", help="Sweep (YAML): problems, values to try, seeds.")],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Table to write (.csv or .parquet), with a journal next to it."),
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; default: one per core.")] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Dask scheduler to use instead, e.g. tcp://10.0.0.1:8786.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only check the sweep and count its cases.")] = False,
    as_json: JsonFlag = False,
) -> None:
    """Solve problems with many values and seeds; after an interruption, the same command resumes."""
    from micah_plan.documents.sweep import load_sweep
    from micah_plan.sweep.journal import journal_path
    from micah_plan.sweep.run import check_sweep_outputs, run_on

    if workers is not None and scheduler is not None:
        raise InputError("--workers and --scheduler exclude each other", remedy="a Dask cluster has its own workers")
    if output is None and not dry_run:
        raise InputError("no file for the results", remedy="name one with -o, or only count with --dry-run")
    with progress_bar(as_json) as progress:
        progress(f"checking {file.name}", 0.0)
        asked = load_sweep(file)
        if output is not None:
            check_sweep_outputs(asked, output)
        if output is None or dry_run:
            counts = _dry_run_json(asked, output)
            print_summary(as_json, counts, lambda: _print_counted(counts))
            return
        begin = time.perf_counter()
        try:
            with _workers(workers, scheduler) as chosen:
                done = run_on(asked, output, chosen, progress)
        except KeyboardInterrupt:
            counts = _dry_run_json(asked, output)
            state = f"{counts['finished']} of {counts['cases']} cases are finished and kept in {journal_path(output)}"
            raise Interrupted(f"interrupted; {state}; give the same command again to go on") from None
    summary = _sweep_json(done, time.perf_counter() - begin)
    print_summary(as_json, summary, lambda: _print_swept(summary, done.files))


def _workers(count: int | None, scheduler: str | None) -> AbstractContextManager[Workers]:
    from micah_plan.sweep.workers import dask_workers, process_workers

    return process_workers(count) if scheduler is None else dask_workers(scheduler)


def _dry_run_json(sweep: Sweep, output: Path | None) -> dict[str, Any]:
    """JSON of `sweep --dry-run`: problems, grid, seeds, number of cases, and those in the journal."""
    from micah_plan.sweep.journal import journal_path, read_journal

    finished = {} if output is None else read_journal(journal_path(output))
    keys = {case.key for case in sweep.cases()}
    return {
        "problems": len(sweep.problems),
        "grid": {key: len(values) for key, values in sweep.grid},
        "seeds": len(sweep.seeds),
        "cases": len(keys),
        "finished": sum(key in finished for key in keys),
    }


def _sweep_json(done: SweepResults, seconds: float) -> dict[str, Any]:
    """JSON of `sweep`: cases, resumed cases, and outcomes."""
    pairs = zip(done.cases, done.results, strict=True)
    executed = [(case.trials, result.successes) for case, result in pairs if result.successes is not None]
    return {
        "cases": len(done.cases),
        "resumed": done.resumed,
        "outcomes": dict(sorted(Counter(result.outcome for result in done.results).items())),
        "trials": sum(trials for trials, _ in executed),
        "successes": sum(successes for _, successes in executed),
        "files": [str(file) for file in done.files],
        "seconds": seconds,
    }


def _print_counted(summary: dict[str, Any]) -> None:
    values = [f"{number} of {key}" for key, number in summary["grid"].items()]
    factors = [count(summary["problems"], "problem"), *values, count(summary["seeds"], "seed")]
    out.print(f"{count(summary['cases'], 'case')}: {' x '.join(factors)}")
    out.print(f"  finished  {summary['finished']:,}")


def _print_swept(summary: dict[str, Any], files: tuple[Path, ...]) -> None:
    before = f", {summary['resumed']:,} of them before" if summary["resumed"] else ""
    out.print(f"finished {count(summary['cases'], 'case')}{before} in {duration(summary['seconds'])}")
    for outcome, number in summary["outcomes"].items():
        out.print(f"  {outcome:<12} {number:,}")
    if summary["trials"]:
        out.print(f"  {summary['successes']:,} of {summary['trials']:,} trials reached the goal")
    print_files(files)
