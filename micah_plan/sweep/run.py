"""`run_sweep`: every case of a sweep exactly once, even if workers die or the sweep is restarted."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Generator, Sequence
from concurrent.futures import ALL_COMPLETED, FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

from micah_plan.errors import MicahError
from micah_plan.files import replace_files
from micah_plan.output_files import TABLE, Output, check_outputs
from micah_plan.summaries import Progress
from micah_plan.sweep.journal import Journal, journal_path
from micah_plan.sweep.result import CaseResult, CaseRun, results_table, sweep_timings_path, timings_table
from micah_plan.sweep.solve_case import run_of_dead_workers
from micah_plan.sweep.workers import Workers, process_workers
from micah_plan.task.sweep import Case, Sweep

MOST_ATTEMPTS = 3
_GO_ON = "what is finished is in the journal; give the command again to go on"
# More than any executor has workers.
_EXECUTOR_IN_FLIGHT = 1000


class SweepStoppedError(MicahError):
    """The workers cannot continue; finished cases are in the journal."""


@dataclass(frozen=True, eq=False)
class SweepResults:
    """Result of `run_sweep`.

    Attributes:
        cases, results: one each per case, in the order of the table.
        resumed: how many were in the journal already.
        files: the table, its timings and the journal.
    """

    cases: tuple[Case, ...]
    results: tuple[CaseResult, ...]
    resumed: int
    files: tuple[Path, ...]


def run_sweep(
    sweep: Sweep,
    output: str | Path,
    *,
    executor: Executor | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> SweepResults:
    """Solve all cases of a sweep and write its table, or resume an interrupted one.

    Args:
        output: CSV or Parquet file; its timings (`*.timings.*`) and journal (`*.journal`) lie beside it.
        executor: any; its workers must see the same files. None: processes of this machine.
        workers: how many processes; None: one per core.
        progress: called with a message and the fraction done.

    Raises:
        InputError: if the output or its journal cannot be used.
        MissingDependencyError: if a library is missing for the table or the plant.
        SweepStoppedError: if the executor broke or was closed; run again to go on.
    """
    if executor is not None:
        return run_on(sweep, Path(output), Workers(executor, _EXECUTOR_IN_FLIGHT), progress)
    with process_workers(workers) as chosen:
        return run_on(sweep, Path(output), chosen, progress)


def run_on(sweep: Sweep, output: Path, workers: Workers, progress: Progress | None = None) -> SweepResults:
    """`run_sweep` on workers of any kind."""
    check_sweep_outputs(sweep, output)
    cases = tuple(sweep.cases())
    with Journal(journal_path(output)) as journal:
        distinct = {case.key: case for case in cases}
        unfinished = [case for key, case in distinct.items() if key not in journal.finished]
        resumed = len(distinct) - len(unfinished)
        outcomes: Counter[str] = Counter({"from before": resumed} if resumed else {})
        _report_progress(progress, outcomes, len(distinct))
        with closing(finished_cases(unfinished, workers)) as ended:
            for case, run in ended:
                journal.append(case.key, run)
                outcomes[run.result.outcome] += 1
                _report_progress(progress, outcomes, len(distinct))
        runs = [journal.finished[case.key] for case in cases]
    results = tuple(run.result for run in runs)
    table, timings = results_table(sweep, cases, results, output.suffix), timings_table(runs, output.suffix)
    replace_files({output: table, sweep_timings_path(output): timings})
    return SweepResults(cases, results, resumed, (output, sweep_timings_path(output), journal_path(output)))


def check_sweep_outputs(sweep: Sweep, output: Path) -> None:
    """Refuse output files that would overwrite others or cannot be written.

    Raises:
        InputError: as `output_files.check_outputs`.
        MissingDependencyError: if the table needs a library that is not installed.
    """
    read = [Path(sweep.source) if sweep.source else None, *(problem.path for problem in sweep.problems)]
    beside = [Output("the journal of -o", journal_path(output), (".journal",))]
    beside += [Output("the times of -o", sweep_timings_path(output), TABLE)] if output.suffix else []
    check_outputs(read, [Output("-o", output, TABLE), *beside])
    results_table(sweep, (), (), output.suffix)


def _report_progress(progress: Progress | None, outcomes: Counter[str], total: int) -> None:
    """Report the number of finished cases by outcome."""
    if progress is not None:
        parts = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items()) or "starting workers"
        progress(f"{outcomes.total()} of {total} cases ({parts})", outcomes.total() / max(1, total))


def finished_cases(cases: Sequence[Case], workers: Workers) -> Generator[tuple[Case, CaseRun], None, None]:
    """Every case with its run, in order of completion; closing the generator cancels waiting cases.

    When a process of a pool dies, all cases handed over are lost and nobody knows which one killed it. They are tried
    again one at a time, so that only the one that kills becomes a failure.

    Raises:
        SweepStoppedError: if the executor broke and cannot be renewed, was closed, or cannot run cases at all.
        MicahError: what a worker says that holds for every case.
    """
    waiting, suspects = deque(cases), deque[Case]()
    running: dict[Future[CaseRun], Case] = {}
    attempts: Counter[str] = Counter()
    try:
        while waiting or suspects or running:
            intact = _hand_over(waiting, suspects, running, workers)
            done = wait(running, return_when=FIRST_COMPLETED if intact else ALL_COMPLETED).done
            if any(isinstance(_error(future), BrokenExecutor) for future in done):
                intact, done = False, wait(running).done
            for future in done:
                case, error = running.pop(future), _error(future)
                attempts[case.key] += 1
                if error is None:
                    yield case, replace(future.result(), attempts=attempts[case.key])
                elif not _is_death(error):
                    raise _stopped(error) from error
                elif attempts[case.key] < MOST_ATTEMPTS:
                    suspects.append(case)
                else:
                    yield case, run_of_dead_workers(MOST_ATTEMPTS, error)
            if not intact and not workers.renew():
                raise SweepStoppedError(f"the executor broke; {_GO_ON}")
    finally:
        for future in running:
            future.cancel()


def _hand_over(
    waiting: deque[Case], suspects: deque[Case], running: dict[Future[CaseRun], Case], workers: Workers
) -> bool:
    """Submit cases to workers: a suspect alone, else enough to keep them busy. False if the workers are gone."""
    source, room = (suspects, 1) if suspects else (waiting, workers.in_flight)
    try:
        while source and len(running) < room:
            running[workers.submit(source[0])] = source[0]
            source.popleft()
    except BrokenExecutor:
        return False
    except RuntimeError as error:  # how executors report that they are shut down
        raise _stopped(error) from error
    return True


def _error(future: Future[CaseRun]) -> BaseException | None:
    return CancelledError("cancelled") if future.cancelled() else future.exception()


def _is_death(error: BaseException) -> bool:
    """Whether a worker died: pools have an error for it; Dask, when some workers died over a case, KilledWorker."""
    return isinstance(error, BrokenExecutor) or type(error).__name__ == "KilledWorker"


def _stopped(error: BaseException) -> MicahError:
    if isinstance(error, MicahError):
        return error
    if isinstance(error, CancelledError):
        return SweepStoppedError(f"the executor or its scheduler was closed; {_GO_ON}")
    message = " ".join(f"{type(error).__name__}: {error}".split())[:300]
    return SweepStoppedError(f"the executor cannot run cases ({message}); {_GO_ON}")
