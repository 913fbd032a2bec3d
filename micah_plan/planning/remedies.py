"""Numbers in remedies: each is tried, by planning with it, before it is named.

What a failure measures, such as how far too many roll-outs end from the goal, says where to begin, not what suffices: a
plan for a wider tolerance is another plan. So a remedy names a number only if planning with it succeeds, with the
problem's seed and with one more; else it stays without.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

from micah_plan.planning.findings import LEAST_CONFIDENCE
from micah_plan.quantities import plain
from micah_plan.task.plan import Finding, Offer, Plan
from micah_plan.task.problem import Problem

NO_CONFIDENCE = "make more room (lowering `confidence` did not help)"
# Numbers tried for one change, and problems solved for all of a plan's remedies.
_MOST_NUMBERS = 4
_MOST_SOLVED = 8
# A tolerance that does not suffice is widened by at least this factor; a confidence lowered by at least this much.
_WIDER = 1.1
_TWICE = 2.0  # times as far a root is moved the next time
_LOWER = 0.02


class PlanSolver(Protocol):
    """What solves a problem, without advice, to see whether a change helps."""

    def __call__(self, problem: Problem, *, seed: int) -> Plan:
        """The plan, verified, and with its arm if it has one."""


def advised(problem: Problem, plan: Plan, solver: PlanSolver, seed: int = 0) -> Plan:
    """A plan that failed, with the numbers in its remedies that help; of each kind of change the first is tried."""
    budget, done, findings = [_MOST_SOLVED], set[str](), list[Finding]()
    for finding in plan.findings if plan.outcome != "solved" else ():
        remedy = finding.remedy
        for offer in finding.offers:
            if offer.kind in done:
                continue
            done.add(offer.kind)
            words, helping = offer.words, _that_helps(problem, offer, solver, seed, budget)
            if helping is not None:
                words = f"{offer.named} {_number(problem, helping)}"
            elif offer.kind == "confidence" and budget[0]:
                words = NO_CONFIDENCE
            remedy = remedy.replace(offer.words, words, 1)
        findings.append(replace(finding, remedy=remedy, offers=()))
    return replace(plan, findings=tuple(findings)) if findings else plan


def changed(problem: Problem, offer: Offer) -> Problem:
    """The problem with the change."""
    values = dict(offer.values)
    if offer.kind == "confidence":
        return replace(problem, settings=replace(problem.settings, confidence=values[0]))
    if offer.kind == "root" and problem.robot is not None:
        return replace(problem, robot=replace(problem.robot, position=(values[0], values[1], values[2])))
    if offer.kind == "start":
        mean = tuple(values.get(i, mean) for i, mean in enumerate(problem.start.mean))
        return replace(problem, start=replace(problem.start, mean=mean))
    target = tuple(
        (i, values.get(i, value), tol) if offer.kind == "target" else (i, value, values.get(i, tol))
        for i, value, tol in problem.goal.target
    )
    return replace(problem, goal=replace(problem.goal, target=target))


def _that_helps(problem: Problem, offer: Offer, solver: PlanSolver, seed: int, budget: list[int]) -> Offer | None:
    """The offer, or the next larger change of its kind, with which planning succeeds with two seeds."""
    for _ in range(_MOST_NUMBERS):
        offer = _written(offer)
        if (offer.kind == "confidence" and offer.values[0][1] <= LEAST_CONFIDENCE) or not offer.values:
            return None
        answers = list[Plan]()
        for seed_tried in (seed, seed + 1):
            if not budget[0]:
                return None
            budget[0] -= 1
            answers.append(solver(changed(problem, offer), seed=seed_tried))
            if answers[-1].outcome != "solved":
                break
        else:
            return offer
        if offer.kind in ("start", "target"):  # there is only one nearest
            return None
        offer = _further(problem, offer, [o for finding in answers[-1].findings for o in finding.offers], answers[-1])
    return None


def _further(problem: Problem, offer: Offer, next_offers: Sequence[Offer], answer: Plan) -> Offer:
    """A larger change of the same kind than one that did not suffice, as its failure proposes."""
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


def _written(offer: Offer) -> Offer:
    """The offer with numbers as they are printed: tolerances up, confidences down."""
    if offer.kind == "confidence":
        return replace(offer, values=((0, math.floor(100.0 * offer.values[0][1] + 1e-9) / 100.0),))
    if offer.kind == "root":
        return replace(offer, values=tuple((i, round(value, 2)) for i, value in offer.values))
    if offer.kind != "tolerance":
        return replace(offer, values=tuple((i, float(f"{value:.4g}")) for i, value in offer.values))
    return replace(offer, values=tuple((i, _rounded_up(value)) for i, value in offer.values))


def _rounded_up(value: float) -> float:
    """The next number of three significant digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return float(f"{math.ceil(value / unit - 1e-9) * unit:.3g}")


def _number(problem: Problem, offer: Offer) -> str:
    """The numbers as they are to be written into the file."""
    if offer.kind == "confidence":
        return f"{offer.values[0][1]:.2f}"
    if offer.kind == "root":
        return f"[{', '.join(_text(value) for _, value in offer.values)}] m"
    coordinates = problem.automaton.coordinates
    # The coordinate that the words name comes first: its number follows them.
    named = sorted(offer.values, key=lambda pair: f"'{coordinates[pair[0]].name}'" not in offer.words)
    first, *others = [(coordinates[i], value) for i, value in named]
    texts = [f"{_text(first[1])} {first[0].unit}"]
    texts += [f"that of '{c.name}' to {_text(value)} {c.unit}" for c, value in others]
    return texts[0] if len(texts) == 1 else ", ".join(texts[:-1]) + f" and {texts[-1]}"


def _text(value: float) -> str:
    return plain(value, 6)
