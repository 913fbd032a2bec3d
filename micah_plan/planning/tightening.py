"""A plan that roll-outs fail too often is planned again with more room, and believed only on fresh roll-outs.

Guards and boundaries are planned to hold with the confidence one by one. Where several may fail, or where the Gaussian
promises too much, all of them together hold less often; roll-outs tell how often. The plan is then made anew with a
confidence whose allowed failures are fewer by the factor by which there were too many, so that transitions are
overshot further, boundaries kept further away and more measurements made before the goal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import Protocol

from micah_plan.planning.verification import verify
from micah_plan.quantities import percent
from micah_plan.task.deadline import Deadline
from micah_plan.task.plan import Plan
from micah_plan.task.problem import Problem


class Planner(Protocol):
    """What finds a plan for a problem before a deadline."""

    def __call__(self, problem: Problem, /, *, deadline: Deadline) -> Plan:
        """The plan, or one without a trajectory."""


class Verifier(Protocol):
    """What rolls a plan out and judges it, as `verification.verify` does."""

    def __call__(self, problem: Problem, plan: Plan, *, seed: int, deadline: Deadline) -> Plan:
        """The plan with its success probability, or refused."""


# Each round allows at most this share of the failures that the round before allowed.
_SLOWEST = 0.3
# Planning never allows fewer failures: k-sigma would ask for more than Gaussians can promise.
_FEWEST_FAILURES = 1e-4
# Seeds of the rounds' roll-outs lie so far apart, and from those that people choose.
_SEED_STRIDE = 7_919


def verified_plan(
    problem: Problem,
    planner: Planner,
    seed: int = 0,
    rounds: int | None = None,
    deadline: Deadline | None = None,
    *,
    verifier: Verifier = verify,
) -> Plan:
    """Plan, verify, and plan again with a higher confidence while the roll-outs succeed too rarely.

    At most `rounds` times, while each round succeeds more often than the best before and within
    `solve_time_limit_s`. A round's roll-outs have their own seeds; and a plan that a round accepts is rolled out once
    more, because the best of several looks better than it is. That last share is in the plan.

    Args:
        problem: its confidence is what the roll-outs must confirm in every round.
        planner: gives a plan for a problem; called again with other settings.
        seed: of the roll-outs.
        rounds: None: from the settings.
        deadline: of planning and verification together; None: as the settings say, from now on.
        verifier: tells of a plan whether roll-outs confirm it.

    Returns:
        The first plan that is confirmed, else the one that succeeds most often, as ``"not_verified"``.
    """
    settings = problem.settings
    deadline = deadline or Deadline(settings.solve_time_limit_s)
    check = partial(_verified, verifier, problem, deadline=deadline)
    best = check(planner(problem, deadline=deadline), seed)
    timings = dict(best.timings)
    confidence = settings.confidence
    most = settings.tightening_rounds if rounds is None else rounds
    for number in range(1, most + 1):
        if best.outcome != "not_verified" or deadline.is_over():
            break
        confidence = tightened(confidence, settings.confidence, 1.0 - (best.success_probability or 0.0))
        closer = replace(settings, confidence=confidence)
        again = planner(replace(problem, settings=closer), deadline=deadline)
        answer = _confirmed(check, again, seed + number * _SEED_STRIDE)
        timings = {key: timings.get(key, 0.0) + spent for key, spent in answer.timings.items()}
        if answer.trajectory is None or not _is_better(answer, best):
            break
        best = _told(answer, best, confidence, number)
    return replace(best, timings=timings)


def tightened(planned: float, asked: float, failing: float) -> float:
    """The confidence to plan with next.

    Args:
        planned: the last plan was made with it.
        asked: what the roll-outs are to confirm.
        failing: share of the roll-outs that failed.
    """
    fewer = min(_SLOWEST, (1.0 - asked) / failing) if failing > 0.0 else _SLOWEST
    return max(planned, 1.0 - max(_FEWEST_FAILURES, (1.0 - planned) * fewer))


def _verified(verifier: Verifier, problem: Problem, plan: Plan, seed: int, *, deadline: Deadline) -> Plan:
    """The plan verified, with the time that it took; one without a trajectory as it is."""
    if plan.trajectory is None:
        return plan
    begin = perf_counter()
    answer = verifier(problem, plan, seed=seed, deadline=deadline)
    spent = perf_counter() - begin
    timings = {**answer.timings, "verify": answer.timings.get("verify", 0.0) + spent}
    return replace(answer, timings={**timings, "total": answer.timings.get("total", 0.0) + spent})


def _confirmed(check: Callable[[Plan, int], Plan], plan: Plan, seed: int) -> Plan:
    """The plan verified twice: its share of successes is of roll-outs that did not choose it."""
    once = check(plan, seed)
    again = replace(plan, timings=once.timings)
    return once if once.outcome != "solved" else check(again, seed + 1)


def _is_better(answer: Plan, best: Plan) -> bool:
    """Whether a plan is confirmed, or at least succeeds more often than another."""
    return answer.outcome == "solved" or (answer.success_probability or 0.0) > (best.success_probability or 0.0)


def _told(answer: Plan, before: Plan, confidence: float, rounds: int) -> Plan:
    if answer.outcome != "solved":
        return answer
    seen = [finding.sentence for finding in before.findings if finding.level == "verification"]
    why = f": {seen[0]}" if seen else ""
    times = "once" if rounds == 1 else f"{rounds} times"
    return replace(answer, reason=f"{answer.reason}; planned again {times}, at last at {percent(confidence)}{why}")
