"""Purposes of modes in words."""

from __future__ import annotations

from micah_plan.planning import messages
from micah_plan.task.plan import ModePurpose, Plan


def purpose_sentences(plan: Plan) -> tuple[tuple[str, str], ...]:
    """(mode, sentence): why the plan visits each mode but the first, as far as the search could decide."""
    sentences = dict[str, str]()
    for purpose in plan.purposes:
        if purpose.mode not in plan.mode_sequence:
            continue
        sentence = _purpose(purpose, plan)
        before = next((mode for mode, other in sentences.items() if other == sentence), None)
        sentences[purpose.mode] = sentence if before is None else messages.same_reason(before)
    return tuple(sentences.items())


def _purpose(purpose: ModePurpose, plan: Plan) -> str:
    """The purpose of a mode in a sentence."""
    if purpose.is_goal:
        return messages.only_mode_of_goal()
    if not purpose.without:
        return messages.no_path_without(purpose.why)
    tried = next((one for one in plan.candidates if one.modes == purpose.without), None)
    if tried is None:
        own = next((one.search_cost for one in plan.candidates if one.modes == plan.mode_sequence), None)
        return messages.costs_more_without(purpose.without, purpose.steps_without or 0.0, own)
    if tried.cost is None:
        return messages.no_plan_without(purpose.without)
    if plan.cost is not None and tried.cost > plan.cost:
        return messages.plan_costs_more_without(purpose.without, tried.cost, plan.cost)
    return messages.plan_fails_without(purpose.without, tried.cost)
