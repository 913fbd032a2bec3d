"""Replanning with a higher confidence where roll-outs fail too often, accepted only on fresh roll-outs.

Planning satisfies each guard and each boundary with the confidence, one by one. Where several may fail, or the Gaussian
is too optimistic, all of them together hold less often; roll-outs measure how often. The plan is then made again with a
higher confidence, whose failure rate is reduced by the factor by which too many roll-outs failed. So transitions go
deeper into their guards, boundaries are kept at a larger distance, and more measurements are made before the goal. If
that does not help, plans are made with fewer and longer steps: each adds noise, and the information from a contact
decays with every one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import Protocol

from micah_plan.planning import messages
from micah_plan.planning.verification import verify
from micah_plan.task.deadline import Deadline
from micah_plan.task.plan import Finding, Plan
from micah_plan.task.problem import Problem

# A round allows at most this share of the failures that the round before allowed.
_SLOWEST = 0.3
# Of the largest step: how fast plans are made where those with more room fail as often.
_FASTER = 0.8
# Planning always allows this share of failures: the far tails of a Gaussian are unreliable.
_FEWEST_FAILURES = 1e-4
# Distance between the seeds of the rounds; also far from the small seeds that users choose.
_SEED_STRIDE = 7_919


class Planner(Protocol):
    """Finds a plan for a problem before a deadline."""

    def __call__(self, problem: Problem, /, *, deadline: Deadline) -> Plan:
        """The plan, or one without a trajectory."""


class Verifier(Protocol):
    """Verifies a plan by roll-outs, as `verification.verify` does."""

    def __call__(self, problem: Problem, plan: Plan, *, seed: int, deadline: Deadline) -> Plan:
        """The plan with its success probability, or refused."""


def verified_plan(
    problem: Problem,
    planner: Planner,
    seed: int = 0,
    rounds: int | None = None,
    deadline: Deadline | None = None,
    *,
    verifier: Verifier = verify,
) -> Plan:
    """Plan, verify, and replan with a higher confidence while roll-outs fail too often.

    As long as each round succeeds more often than the best before. Each round has roll-outs of its own. A plan that a
    round accepts is verified once more with others, because the best of several looks better than it is; the plan
    states that last share.

    Args:
        problem: the roll-outs must confirm its confidence in every round.
        planner: gives a plan for a problem; called again with other settings.
        seed: of the roll-outs.
        rounds: largest number; None: from the settings.
        deadline: of planning and verification together; None: the time limit of the settings from now on.
        verifier: judges a plan by roll-outs.

    Returns:
        The first plan that is confirmed, otherwise the one that succeeds most often, as ``"not_verified"``.
    """
    settings, deadline = problem.settings, deadline or Deadline(problem.settings.solve_time_limit_s)
    most = settings.tightening_rounds if rounds is None else rounds

    def check(plan: Plan, seed: int) -> Plan:
        return _best_verified(plan, partial(verifier, problem, seed=seed, deadline=deadline), deadline)

    best = check(planner(problem, deadline=deadline), seed)
    timings, confidence, pace = dict(best.timings), settings.confidence, settings.pace
    for number in range(1, 1 + most):
        if best.outcome != "not_verified" or deadline.is_over():
            break
        share = best.success_probability or 0.0
        confidence = tightened(confidence, settings.confidence, 1.0 - share)
        closer = replace(problem, settings=replace(settings, confidence=confidence, pace=pace))
        plan, own_seed = planner(closer, deadline=deadline), seed + number * _SEED_STRIDE
        answer = check(plan, own_seed)
        if answer.outcome == "solved":  # these roll-outs have chosen the plan: its share is that of others
            answer = check(replace(plan, timings=answer.timings), own_seed + 1)
        timings = _summed_timings(timings, answer.timings)
        if answer.outcome == "solved":
            best = _with_tightening_note(answer, best, confidence, number)
        elif (answer.success_probability or 0.0) > share:
            best = answer
        elif pace < _FASTER:  # more room does not help: fewer steps have less noise
            pace = _FASTER
        else:
            break
    is_cut = most > 0 and best.outcome == "not_verified" and deadline.is_over()
    return replace(_with_deadline_finding(best, deadline) if is_cut else best, timings=timings)


def _best_verified(plan: Plan, verified: Callable[[Plan], Plan], deadline: Deadline) -> Plan:
    """The first verified of a plan and its alternatives, else the one with the highest success rate."""
    if plan.trajectory is None:
        return plan
    begin, best = perf_counter(), None
    for candidate in (plan, *plan.alternatives):
        answer = replace(verified(candidate), alternatives=())
        if best is None or (answer.success_probability or 0.0) > (best.success_probability or 0.0):
            best = answer
        if answer.outcome == "solved" or deadline.is_over():
            break
    spent = perf_counter() - begin
    return replace(best or plan, timings=_summed_timings(plan.timings, {"verify": spent, "total": spent}))


def _with_deadline_finding(plan: Plan, deadline: Deadline) -> Plan:
    """A plan whose replanning was cut off by the deadline, with that as the first finding."""
    if plan.success_probability is None:  # the roll-outs were cut short, which is reported
        return plan
    sentence, remedy = messages.no_time_for_more_room(deadline.limit_s), messages.RAISE_SOLVE_TIME_LIMIT
    finding = Finding("verification", "time_limit_reached", sentence, remedy, plan.mode_sequence)
    return plan.refused_for(finding, f"{plan.reason}; ", outcome=plan.outcome)


def _summed_timings(first: Mapping[str, float], second: Mapping[str, float]) -> dict[str, float]:
    """Sums of seconds by stage."""
    return {stage: first.get(stage, 0.0) + second.get(stage, 0.0) for stage in {**first, **second}}


def tightened(planned: float, asked: float, failing: float) -> float:
    """The next confidence to plan with.

    Args:
        planned: confidence of the last plan.
        asked: confidence that roll-outs must confirm.
        failing: share of the roll-outs that failed.
    """
    fewer = min(_SLOWEST, (1.0 - asked) / failing) if failing > 0.0 else _SLOWEST
    return max(planned, 1.0 - max(_FEWEST_FAILURES, (1.0 - planned) * fewer))


def _with_tightening_note(answer: Plan, before: Plan, confidence: float, rounds: int) -> Plan:
    """A verified plan whose reason mentions that and why it was planned again."""
    sentences = [finding.sentence for finding in before.findings if finding.level == "verification"]
    why = messages.planned_again(rounds, confidence, sentences[0] if sentences else "")
    return replace(answer, reason=f"{answer.reason}{why}")
