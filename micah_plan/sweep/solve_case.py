"""The work on one case: load, solve, optionally execute; every failure is a result."""

from __future__ import annotations

import threading
from dataclasses import replace
from functools import lru_cache
from math import isfinite
from pathlib import Path
from time import perf_counter

from micah_plan.documents.problem import ProblemReader
from micah_plan.errors import InputError, MicahError, MissingDependencyError
from micah_plan.execution.trials import run_trials
from micah_plan.files import read_bytes
from micah_plan.planning.solver import solve
from micah_plan.sweep.result import CaseResult, CaseRun, Outcome
from micah_plan.task.plan import Plan
from micah_plan.task.sweep import Case

# CasADi and OMPL are not made for several threads, and OMPL's generators belong to the process.
_ONE_AT_A_TIME = threading.Lock()


class WorkerFilesError(MicahError):
    """A worker does not see the files of the sweep."""


def solve_case(case: Case) -> CaseRun:
    """Load, solve and optionally execute a case. The result depends on the case alone; one at a time per process.

    Raises:
        MissingDependencyError: if the plant needs a library that is not installed here.
        WorkerFilesError: if the files are not here or others than those that the sweep began with.
    """
    with _ONE_AT_A_TIME:
        begin, seconds = perf_counter(), dict[str, float]()
        try:
            result = _solved(case, seconds)
        except (MissingDependencyError, WorkerFilesError):
            raise  # no other case would fare better
        except InputError as error:
            # Without the file's name, which is another when the files are moved.
            alone = InputError(error.problem, where=error.where, remedy=error.remedy)
            result = CaseResult("bad_input", str(alone))
        except Exception as error:
            result = _failure("error", f"{type(error).__name__}: {error}")
        return CaseRun(result, {**seconds, "total": perf_counter() - begin})


def run_of_dead_workers(attempts: int, error: BaseException) -> CaseRun:
    """The run of a case on which every worker died."""
    sentence = f"the worker died {attempts} times over it ({type(error).__name__}); was it out of memory?"
    return CaseRun(_failure("worker_died", sentence), attempts=attempts)


def _failure(outcome: Outcome, sentence: str) -> CaseResult:
    line = " ".join(sentence.split())[:1000]
    return CaseResult(outcome, "".join(c if c.isprintable() else "?" for c in line))


def _solved(case: Case, seconds: dict[str, float]) -> CaseResult:
    begin = perf_counter()
    try:
        read_bytes(case.path)
    except InputError as error:
        raise WorkerFilesError(f"a worker cannot read a problem: {error}; let it see the same files") from None
    problem = _reader(case.path).load(dict(case.overrides))
    for role, digest in problem.digests.items():
        if case.digests.get(role) != digest:
            sentence = f"{case.path}: the {role} file is not the one that the sweep began with"
            raise WorkerFilesError(f"{sentence}; let workers see the same files, and give the command again")
    seconds["load"] = perf_counter() - begin
    begin = perf_counter()
    plan = solve(problem, seed=case.seed, advise=False)
    seconds["solve"] = perf_counter() - begin
    if plan.outcome != "solved" or not case.trials:
        return _planned(plan)
    begin = perf_counter()
    statistics = run_trials(problem, plan, plant=case.plant, trials=case.trials, seed=case.seed)
    seconds["execute"] = perf_counter() - begin
    return replace(
        _planned(plan),
        successes=statistics.successes,
        final_error_mean=_finite(statistics.final_error.mean),
        final_error_std=_finite(statistics.final_error.std),
        final_error_max=_finite(statistics.final_error.max),
    )


@lru_cache(maxsize=1)
def _reader(path: Path) -> ProblemReader:
    """A cached reader of problem files: successive cases mostly share the problem."""
    return ProblemReader(path)


def _planned(plan: Plan) -> CaseResult:
    return CaseResult(
        outcome=plan.outcome,
        reason=plan.reason,
        modes=plan.mode_sequence,
        steps=None if plan.trajectory is None else int((~plan.trajectory.is_transition).sum()),
        cost=_finite(plan.cost),
        goal_error=_finite(plan.goal_error),
        goal_std=_finite(plan.goal_std),
        success_probability=_finite(plan.success_probability),
    )


def _finite(value: float | None) -> float | None:
    return None if value is None or not isfinite(value) else float(value)
