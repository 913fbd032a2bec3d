"""Cases handed to workers until all are finished, though workers may die."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Generator, Sequence
from concurrent.futures import ALL_COMPLETED, FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from dataclasses import replace

from micah_plan.errors import MicahError
from micah_plan.sweep.result import CaseRun
from micah_plan.sweep.solve_case import worker_died
from micah_plan.sweep.workers import Workers
from micah_plan.task.sweep import Case

MOST_ATTEMPTS = 3
_GO_ON = "what is finished is in the journal; give the command again to go on"


class SweepStoppedError(MicahError):
    """The workers cannot go on; what was finished is in the journal."""


def finished_cases(cases: Sequence[Case], workers: Workers) -> Generator[tuple[Case, CaseRun], None, None]:
    """Every case with its run, in the order in which they end; closed early, it takes back what has not begun.

    When a process of a pool dies, all cases handed over are lost and nobody knows which one killed it. They are tried
    again one at a time, so that it is only the guilty one that in the end becomes a failure.

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
                    yield case, worker_died(MOST_ATTEMPTS, error)
            if not intact and not workers.renew():
                raise SweepStoppedError(f"the executor broke; {_GO_ON}")
    finally:
        for future in running:
            future.cancel()


def _hand_over(
    waiting: deque[Case], suspects: deque[Case], running: dict[Future[CaseRun], Case], workers: Workers
) -> bool:
    """Give workers what they can take: a suspect alone, else what keeps them busy. False if they are gone."""
    source, room = (suspects, 1) if suspects else (waiting, workers.in_flight)
    try:
        while source and len(running) < room:
            running[workers.submit(source[0])] = source[0]
            source.popleft()
    except BrokenExecutor:
        return False
    except RuntimeError as error:  # how executors say that they are shut down
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
    said = " ".join(f"{type(error).__name__}: {error}".split())[:300]
    return SweepStoppedError(f"the executor cannot run cases ({said}); {_GO_ON}")
