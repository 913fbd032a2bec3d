"""Where cases are solved: processes of this machine, a Dask cluster, any executor. The only importer of distributed."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from typing import Any, TypeVar

from micah_plan.errors import InputError, MicahError, MissingDependencyError
from micah_plan.sweep.result import CaseRun
from micah_plan.sweep.solve_case import solve_case
from micah_plan.task.sweep import Case

T = TypeVar("T")

_CONNECT_S = 10.0


class Workers:
    """Workers of an executor that the caller owns."""

    def __init__(self, executor: Executor, in_flight: int) -> None:
        """Args: the executor, and the number of cases in flight."""
        self._executor, self._in_flight = executor, in_flight

    @property
    def in_flight(self) -> int:
        """Number of cases in flight, enough to keep all workers busy."""
        return self._in_flight

    def submit(self, case: Case) -> Future[CaseRun]:
        """Submit a case."""
        return self._executor.submit(solve_case, case)

    def renew(self) -> bool:
        """Restart after workers died; False if impossible here."""
        return False


class ProcessWorkers(Workers):
    """A pool of spawned processes (CasADi and OMPL do not survive a fork), replaced when it breaks.

    A worker lives as long as this process holds one end of a pipe: it goes when it is told to, and also when this
    process is killed. Ctrl-C is for this process alone.
    """

    def __init__(self, count: int) -> None:
        """Args: number of processes."""
        self._count = count
        super().__init__(self._begin(), in_flight=2 * count)

    def submit(self, case: Case) -> Future[CaseRun]:
        return self._submit(self._executor, solve_case, case)

    def renew(self) -> bool:
        if self._first_begun.exception() is not None:
            raise MicahError(
                "no worker process can start; a script that runs a sweep must do it below `if __name__ == '__main__':`"
            )
        self.close()
        self._executor = self._begin()
        return True

    def close(self) -> None:
        """Terminate the processes."""
        self._held.close()
        self._executor.shutdown(wait=True, cancel_futures=True)
        self._watched.close()

    def _begin(self) -> Executor:
        context = multiprocessing.get_context("spawn")
        self._watched, self._held = context.Pipe(duplex=False)
        pool = ProcessPoolExecutor(self._count, context, _live_with_parent, (self._watched,))
        self._first_begun = self._submit(pool, os.getpid)
        return pool

    @staticmethod
    def _submit(pool: Executor, function: Callable[..., T], *arguments: object) -> Future[T]:
        # The pool starts processes here; they inherit what this thread blocks.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return pool.submit(function, *arguments)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def process_workers(count: int | None = None) -> Iterator[ProcessWorkers]:
    """Processes of this machine, terminated at the end of the block.

    Args:
        count: None: one for each core that this process may use.
    """
    workers = ProcessWorkers(count or len(os.sched_getaffinity(0)))
    try:
        yield workers
    finally:
        workers.close()


def _live_with_parent(watched: Connection) -> None:
    """Terminate this process when the other end of the pipe is closed."""

    def watch() -> None:
        watched.poll(None)  # nothing is ever sent, so this returns at the end of the pipe only
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


class DaskWorkers(Workers):
    """The present workers of a Dask scheduler, which reassigns cases of dead workers itself."""

    def __init__(self, client: Any, executor: Executor) -> None:
        """Args: a connected `distributed.Client`, and its executor."""
        super().__init__(executor, in_flight=2)
        self._client = client

    @property
    def in_flight(self) -> int:
        # A scheduler that does not answer is noticed by the cases that it had.
        with suppress(OSError, RuntimeError, ValueError):
            self._in_flight = 2 * max(1, sum(self._client.ncores().values()))
        return self._in_flight


@contextmanager
def dask_workers(address: str) -> Iterator[DaskWorkers]:
    """The workers of a scheduler at an address such as ``tcp://10.0.0.1:8786``; disconnected at the end of the block.

    Raises:
        MissingDependencyError: if distributed is not installed.
        InputError: if no scheduler answers there, or it has no workers.
    """
    try:
        from distributed import Client
    except ModuleNotFoundError:
        raise MissingDependencyError.of("cluster", "a Dask cluster needs distributed") from None
    try:
        client = Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        message = " ".join(str(error).split())[:200]
        remedy = "start one with `dask scheduler`, and workers with `dask worker ADDRESS --nthreads 1`"
        raise InputError(f"no Dask scheduler answers at {address} ({message})", remedy=remedy) from None
    # Without the tracebacks that Dask logs when workers and schedulers exit: the sweep reports the cause in one line.
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        with client:
            if not client.ncores():
                problem = f"the Dask scheduler at {address} has no workers"
                raise InputError(problem, remedy="start some: dask worker ADDRESS --nthreads 1")
            executor = client.get_executor(pure=False)
            try:
                yield DaskWorkers(client, executor)
            finally:
                executor.shutdown(wait=False)
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
