"""Purposes of modes in words."""

from __future__ import annotations

from micah_plan.quantities import plain
from micah_plan.task.plan import ModePurpose, Plan


def purpose_sentences(plan: Plan) -> tuple[tuple[str, str], ...]:
    """(mode, sentence): why the plan visits each mode but the first, as far as the search could decide."""
    sentences = dict[str, str]()
    for purpose in plan.purposes:
        if purpose.mode not in plan.mode_sequence:
            continue
        sentence = _sentence(purpose, plan)
        before = next((mode for mode, said in sentences.items() if said == sentence), None)
        sentences[purpose.mode] = sentence if before is None else f"is there for the same reason as {before}"
    return tuple(sentences.items())


def _sentence(purpose: ModePurpose, plan: Plan) -> str:
    if purpose.is_goal:
        return "the goal is in no other mode"
    if not purpose.without:
        return f"without it the search finds no way: {purpose.why}"
    way = " -> ".join(purpose.without)
    tried = next((one for one in plan.candidates if one.modes == purpose.without), None)
    if tried is None:
        own = next((one.search_cost for one in plan.candidates if one.modes == plan.mode_sequence), None)
        instead = "" if own is None else f" instead of {plain(own)}"
        return f"the way without it, {way}, was expected to cost {plain(purpose.steps_without or 0.0)} steps{instead}"
    if tried.cost is None:
        return f"the way without it, {way}, was tried, and there is no plan along it"
    if plan.cost is not None and tried.cost > plan.cost:
        return f"along the way without it, {way}, a plan costs {plain(tried.cost)} instead of {plain(plan.cost)}"
    return f"along the way without it, {way}, a plan costs {plain(tried.cost)}, but its roll-outs fail"
