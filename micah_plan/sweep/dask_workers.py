"""Workers of a Dask cluster. The only importer of distributed."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager, suppress
from typing import Any

from micah_plan.errors import InputError, MissingDependencyError
from micah_plan.sweep.workers import ExecutorWorkers

_CONNECT_S = 10.0


class DaskWorkers(ExecutorWorkers):
    """The workers that a scheduler has at each time. Dask itself gives the cases of a dead worker to others."""

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
    """The workers of the scheduler at an address such as ``tcp://10.0.0.1:8786``; left alone with the block.

    Raises:
        MissingDependencyError: if distributed is not installed.
        InputError: if no scheduler answers there, or it has no workers.
    """
    try:
        from distributed import Client
    except ModuleNotFoundError:
        raise MissingDependencyError("a Dask cluster needs distributed: pip install 'micah-plan[cluster]'") from None
    try:
        client = Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        said = " ".join(str(error).split())[:200]
        remedy = "start one with `dask scheduler`, and workers with `dask worker ADDRESS --nthreads 1`"
        raise InputError(f"no Dask scheduler answers at {address} ({said})", remedy=remedy) from None
    with _silent_logs(), client:
        yield from _connected(client, address)


@contextmanager
def _silent_logs() -> Iterator[None]:
    """Without the tracebacks that Dask logs when workers and schedulers go: the sweep says in a line what matters."""
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


def _connected(client: Any, address: str) -> Iterator[DaskWorkers]:
    if not client.ncores():
        problem = f"the Dask scheduler at {address} has no workers"
        raise InputError(problem, remedy="start some: dask worker ADDRESS --nthreads 1")
    executor = client.get_executor(pure=False)
    try:
        yield DaskWorkers(client, executor)
    finally:
        executor.shutdown(wait=False)
