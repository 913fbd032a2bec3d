"""`micah-plan sweep`: many cases at once."""

from __future__ import annotations

import time
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from micah_plan.cli.console import Interrupted, JsonFlag, print_summary, progress_bar
from micah_plan.errors import InputError

if TYPE_CHECKING:
    from micah_plan.sweep.workers import Workers
    from micah_plan.task.sweep import Sweep


def sweep(
    file: Annotated[Path, typer.Argument(metavar="SWEEP", help="Sweep (YAML): problems, values to try, seeds.")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Table to write (.csv or .parquet), with a journal beside it.")
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; default: one per core.")] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Dask scheduler to use instead, e.g. tcp://10.0.0.1:8786.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only check the sweep and count its cases.")] = False,
    as_json: JsonFlag = False,
) -> None:
    """Solve problems with many values and seeds; after an interruption, the same command goes on where it was."""
    from micah_plan.cli.reports.swept import counted, print_counted, print_swept, swept
    from micah_plan.documents.sweep import load_sweep
    from micah_plan.sweep.journal import journal_path, read_journal
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
            finished = {} if output is None else read_journal(journal_path(output))
            counts = counted(asked, finished)
            print_summary(as_json, counts, lambda: print_counted(counts))
            return
        begin = time.perf_counter()
        try:
            with _workers(workers, scheduler) as chosen:
                done = run_on(asked, output, chosen, progress)
        except KeyboardInterrupt:
            raise Interrupted(_how_to_go_on(asked, output)) from None
    summary = swept(done, time.perf_counter() - begin)
    print_summary(as_json, summary, lambda: print_swept(summary, done.files))


def _workers(count: int | None, scheduler: str | None) -> AbstractContextManager[Workers]:
    from micah_plan.sweep.workers import dask_workers, process_workers

    return process_workers(count) if scheduler is None else dask_workers(scheduler)


def _how_to_go_on(asked: Sweep, output: Path) -> str:
    from micah_plan.cli.reports.swept import counted
    from micah_plan.sweep.journal import journal_path, read_journal

    counts = counted(asked, read_journal(journal_path(output)))
    state = f"{counts['finished']} of {counts['cases']} cases are finished"
    return f"interrupted; {state} and kept in {journal_path(output)}; give the same command again to go on"
