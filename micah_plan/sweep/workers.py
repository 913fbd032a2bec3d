"""Where cases are solved: processes of this machine, or any executor that is given."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Protocol, TypeVar

from micah_plan.errors import MicahError
from micah_plan.sweep.result import CaseRun
from micah_plan.sweep.solve_case import solve_case
from micah_plan.task.sweep import Case

T = TypeVar("T")


class Workers(Protocol):
    """What a sweep needs of them."""

    @property
    def in_flight(self) -> int:
        """How many cases to hand over at a time: enough that no worker waits for the next."""

    def submit(self, case: Case) -> Future[CaseRun]:
        """Hand over a case."""

    def renew(self) -> bool:
        """Start again after workers died and took the executor along; False if that cannot be done here."""


class ExecutorWorkers:
    """An executor that somebody else made and will close."""

    def __init__(self, executor: Executor, in_flight: int) -> None:
        """Args: the executor, and how many cases to hand over at a time."""
        self._executor, self._in_flight = executor, in_flight

    @property
    def in_flight(self) -> int:
        return self._in_flight

    def submit(self, case: Case) -> Future[CaseRun]:
        return self._executor.submit(solve_case, case)

    def renew(self) -> bool:
        return False


class ProcessWorkers:
    """A pool of fresh processes (spawned: CasADi and OMPL do not survive a fork), and another one when it breaks.

    A worker lives as long as this process holds one end of a pipe: it goes when it is told to, and also when this
    process is killed. Ctrl-C is for this process alone.
    """

    def __init__(self, count: int) -> None:
        """Args: how many processes."""
        self._count = count
        self._begin()

    @property
    def in_flight(self) -> int:
        return 2 * self._count

    def submit(self, case: Case) -> Future[CaseRun]:
        return self._submit(solve_case, case)

    def renew(self) -> bool:
        if self._first_begun.exception() is not None:
            raise MicahError(
                "no worker process can start; a script that runs a sweep must do it below `if __name__ == '__main__':`"
            )
        self.close()
        self._begin()
        return True

    def close(self) -> None:
        """End the processes, whatever they are doing."""
        self._held.close()
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._watched.close()

    def _submit(self, function: Callable[..., T], *arguments: object) -> Future[T]:
        # The pool starts processes here; they inherit what this thread blocks.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return self._pool.submit(function, *arguments)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def _begin(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._watched, self._held = context.Pipe(duplex=False)
        self._pool = ProcessPoolExecutor(self._count, context, _live_with_parent, (self._watched,))
        self._first_begun = self._submit(os.getpid)


@contextmanager
def process_workers(count: int | None = None) -> Iterator[ProcessWorkers]:
    """Processes of this machine, ended with the block.

    Args:
        count: None: one for each core that this process may use.
    """
    workers = ProcessWorkers(count or len(os.sched_getaffinity(0)))
    try:
        yield workers
    finally:
        workers.close()


def _live_with_parent(watched: Connection) -> None:
    """End this process as soon as nobody holds the other end of the pipe."""

    def watch() -> None:
        watched.poll(None)  # nothing is ever sent, so this returns at the end of the pipe only
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
