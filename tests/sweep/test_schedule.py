"""Whatever workers do, every case ends exactly once, and only those that kill workers end as failures."""

from __future__ import annotations

from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from micah_plan.errors import MissingDependencyError
from micah_plan.sweep.result import CaseResult, CaseRun
from micah_plan.sweep.run import MOST_ATTEMPTS, SweepStoppedError, finished_cases
from micah_plan.task.sweep import Case


class KilledWorker(Exception):  # noqa: N818 - as Dask calls it
    """What Dask says when a case has killed several workers."""


class Doomed:
    """Workers of which a case may kill one: a pool then loses all that it has, a cluster only that case."""

    def __init__(self, deaths: dict[int, int], in_flight: int, *, is_pool: bool = True, renews: bool = True) -> None:
        """Args: how often the case of a seed kills; cases at a time; pool or cluster; whether it can begin again."""
        self.deaths, self.in_flight, self._is_pool, self._renews = dict(deaths), in_flight, is_pool, renews
        self.runs: list[int] = []
        self._pending: list[tuple[Case, Future[CaseRun]]] = []
        self._broken = False

    def submit(self, case: Case) -> Future[CaseRun]:
        if self._broken:
            raise BrokenProcessPool("gone")
        future: Future[CaseRun] = Future()
        self._pending.append((case, future))
        if self.deaths.get(case.seed, 0):
            self.deaths[case.seed] -= 1
            if self._is_pool:
                self._broken = True
                for _, lost in self._pending:
                    lost.set_exception(BrokenProcessPool("died"))
                self._pending.clear()
            else:
                self._pending.remove((case, future))
                future.set_exception(KilledWorker())
        elif len(self._pending) >= self.in_flight or case.seed % 3 == 0:
            for each, waiting in self._pending:
                self.runs.append(each.seed)
                waiting.set_result(CaseRun(CaseResult("solved", "", cost=float(each.seed))))
            self._pending.clear()
        return future

    def renew(self) -> bool:
        self._broken = False
        return self._renews


def cases(count: int) -> list[Case]:
    return [Case("p", Path("/p"), {}, (), seed) for seed in range(0, 3 * count, 3)]


@settings(max_examples=150)
@given(
    st.integers(1, 12),
    st.dictionaries(st.integers(0, 11).map(lambda i: 3 * i), st.integers(1, 4), max_size=5),
    st.integers(1, 6),
    st.booleans(),
)
def test_each_case_ends_once_and_only_killers_fail(
    count: int, deaths: dict[int, int], in_flight: int, is_pool: bool
) -> None:
    asked = cases(count)
    workers = Doomed(deaths, in_flight, is_pool=is_pool)
    ended = list(finished_cases(asked, workers))
    assert sorted(case.seed for case, _ in ended) == [case.seed for case in asked]
    failed = {case.seed for case, run in ended if run.result.outcome == "worker_died"}
    assert failed == {case.seed for case in asked if deaths.get(case.seed, 0) >= MOST_ATTEMPTS}
    for case, run in ended:
        if run.result.outcome == "solved":
            assert run.result.cost == case.seed
            assert run.attempts <= MOST_ATTEMPTS
    assert len(workers.runs) == len(set(workers.runs)), "no case that ended was done again"


def test_an_executor_that_cannot_begin_again_stops_the_sweep() -> None:
    with pytest.raises(SweepStoppedError, match="the executor broke; what is finished is in the journal"):
        list(finished_cases(cases(4), Doomed({3: 1}, 2, renews=False)))


@pytest.mark.parametrize(
    ("error", "expected", "said"),
    [
        (MissingDependencyError("install mujoco"), MissingDependencyError, "install mujoco"),
        (ModuleNotFoundError("No module named 'micah_plan'"), SweepStoppedError, r"cannot run cases \(ModuleNotFound"),
        (None, SweepStoppedError, "the executor or its scheduler was closed; what is finished"),
    ],
)
def test_what_no_case_can_help_stops_the_sweep(error: Exception | None, expected: type[Exception], said: str) -> None:
    class Failing(Doomed):
        def submit(self, case: Case) -> Future[CaseRun]:  # noqa: ARG002
            future: Future[CaseRun] = Future()
            if error is None:
                future.cancel()
                future.set_running_or_notify_cancel()
            else:
                future.set_exception(error)
            return future

    with pytest.raises(expected, match=said):
        list(finished_cases(cases(2), Failing({}, 1)))
