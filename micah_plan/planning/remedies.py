"""Tested remedies: each offered change is planned with before it is named.

The amount of a failure, such as the distance of too many roll-outs from the goal, is where to start, not what is
enough: a plan for a wider tolerance is another plan. So a remedy names a number only if planning with it succeeds, with
the problem's seed and with the next. Remedies that do not help are left out; untested ones are marked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

from micah_plan.planning import messages
from micah_plan.planning.findings import LEAST_CONFIDENCE
from micah_plan.planning.offers import changed, in_words, with_printable_numbers
from micah_plan.summaries import Progress
from micah_plan.task.plan import Finding, Plan
from micah_plan.task.problem import Problem
from micah_plan.task.reason import Offer, OfferKind, one_of

# Numbers tried for one change that has a number, and for one that has none; problems solved for a plan's remedies.
_MOST_NUMBERS, _MOST_FACTORS = 4, 2
_MOST_SOLVED = 14
# A tolerance that does not suffice is widened by at least this factor; a confidence lowered by at least this much.
_WIDER = 1.1
_TWICE = 2.0  # times as far a root is moved the next time
_LOWER = 0.02
# What is changed by a factor.
_FACTORS: tuple[OfferKind, ...] = (
    "max_knots", "max_step", "noise", "start_std", "surer", "samples_per_mode", "search_limit", "candidates",
)  # fmt: skip
# Has to be done, also where it is not enough.
_NECESSARY: tuple[OfferKind, ...] = ("start", "target")


class PlanSolver(Protocol):
    """Solves a problem without advice, to test whether a change helps."""

    def __call__(self, problem: Problem, *, seed: int) -> Plan:
        """The verified plan, with the arm's trajectory if there is an arm."""


def with_tested_remedies(
    problem: Problem, plan: Plan, solver: PlanSolver, seed: int = 0, progress: Progress | None = None
) -> Plan:
    """A failed plan with remedies that were tested; the first of each kind.

    Args:
        progress: called with the current trial, and the used share of the budget.
    """
    if plan.outcome == "solved" or not plan.findings:
        return plan
    trials, beginning = _Trials(problem, solver, seed, progress), plan.before_remedy
    findings = tuple(
        replace(finding, remedy=trials.tested_remedy(finding) if finding.ways else finding.remedy, ways=())
        for finding in plan.findings
    )
    # What was added to a reason since stands behind its remedy.
    is_of_first = beginning is not None and plan.reason == f"{beginning}{plan.findings[0].remedy}"
    return replace(plan, reason=f"{beginning}{findings[0].remedy}" if is_of_first else plan.reason, findings=findings)


class _BudgetExhaustedError(Exception):
    """The budget of test problems is exhausted."""


class _Trials:
    """Results of trial changes: the words of each helpful kind, "" if none helps."""

    def __init__(self, problem: Problem, solver: PlanSolver, seed: int, progress: Progress | None) -> None:
        self._problem, self._solver, self._seed, self._progress = problem, solver, seed, progress
        self._left = _MOST_SOLVED
        self._words = dict[OfferKind, str]()

    def tested_remedy(self, finding: Finding) -> str:
        """The remedy of a finding without the ways that failed in trials."""
        ways, failed = list[str](), list[str]()
        for way in finding.ways:
            words = way if isinstance(way, str) else self._tested_words(way)
            if isinstance(way, Offer) and way.kind in _NECESSARY:
                words = words or way.words
            if words:
                ways.append(words)
            elif isinstance(way, Offer):
                failed.append(way.words)
        return one_of(ways) if ways else messages.none_helped(failed)

    def _tested_words(self, offer: Offer) -> str:
        """Words of an offer; empty if it does not help."""
        if offer.kind in self._words:
            # For another coordinate or number than the tested one, the result is unknown.
            is_of_all = offer.kind in (*_FACTORS, "confidence", "revisits")
            return self._words[offer.kind] if is_of_all else offer.words
        try:
            helping = self._helpful_offer(offer)
        except _BudgetExhaustedError:
            return messages.untested(offer.words)
        self._words[offer.kind] = "" if helping is None else in_words(self._problem, helping)
        return self._words[offer.kind]

    def _helpful_offer(self, offer: Offer) -> Offer | None:
        """The offer, or a larger change of its kind, with which planning succeeds for two seeds.

        Raises:
            _BudgetExhaustedError: if the budget is exhausted before that is known.
        """
        for _ in range(_MOST_FACTORS if offer.kind in _FACTORS else _MOST_NUMBERS):
            offer = with_printable_numbers(offer)
            if (offer.kind == "confidence" and offer.values[0][1] <= LEAST_CONFIDENCE) or not offer.values:
                return None
            answers = list[Plan]()
            for seed in (self._seed, self._seed + 1):
                if not self._left:
                    raise _BudgetExhaustedError
                if self._progress is not None:
                    self._progress(messages.trying(offer.words), 1.0 - self._left / _MOST_SOLVED)
                self._left -= 1
                answers.append(self._solver(changed(self._problem, offer), seed=seed))
                if answers[-1].outcome != "solved":
                    break
            else:
                return offer
            if offer.kind in ("start", "target", "revisits"):  # there is only one nearest
                return None
            proposed = [way for finding in answers[-1].findings for way in finding.ways if isinstance(way, Offer)]
            offer = _larger_change(self._problem, offer, proposed, answers[-1])
        return None


def _larger_change(problem: Problem, offer: Offer, next_offers: Sequence[Offer], answer: Plan) -> Offer:
    """A larger change of the same kind, as the failure of a smaller one proposes."""
    if offer.kind in _FACTORS:
        value = offer.values[0][1]
        return replace(offer, values=((0, value * offer.growth if value > 1.0 else value / offer.growth),))
    if offer.kind == "root" and problem.robot is not None:
        stands = problem.robot.position
        return replace(offer, values=tuple((i, stands[i] + _TWICE * (value - stands[i])) for i, value in offer.values))
    proposed = dict(next((next_offer.values for next_offer in next_offers if next_offer.kind == offer.kind), ()))
    if offer.kind == "confidence":
        share = answer.success_probability
        most = min(offer.values[0][1], proposed.get(0, 1.0), 1.0 if share is None else share) - _LOWER
        return replace(offer, values=((0, most),))
    wider = {i: max(_WIDER * value, _WIDER * proposed.get(i, 0.0)) for i, value in offer.values}
    return replace(offer, values=tuple({**{i: _WIDER * v for i, v in proposed.items()}, **wider}.items()))
