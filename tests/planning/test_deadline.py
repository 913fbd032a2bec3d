"""A time limit ends every stage, and the answer names it. Time is a clock that ticks when it is asked."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import partial

import baseline_direct
import baseline_rrt
import pytest
from planning_examples import planar_problem, with_settings

from micah_plan.planning.pomdp_hd import plan
from micah_plan.planning.solver import solve
from micah_plan.planning.tightening import verified_plan
from micah_plan.task.deadline import Deadline
from micah_plan.task.plan import Plan


def solved_within(ticks: int) -> tuple[Plan, int]:
    """The plan, and how often the clock was asked."""
    clock = itertools.count()
    problem = with_settings(planar_problem(), verification_trials=50)
    found = verified_plan(problem, partial(plan, seed=0), deadline=Deadline(ticks, lambda: next(clock)))
    return found, next(clock)


@pytest.mark.slow
def test_every_stage_ends_at_the_limit_and_is_named() -> None:
    whole, ticks = solved_within(10**9)
    assert whole.outcome == "solved"
    named = set[str]()
    for limit in (0, 1, 2, 4, *range(8, ticks, max(1, ticks // 12)), ticks - 2):
        found, asked = solved_within(limit)
        if found.outcome == "solved":  # what was left out of it is said for the candidate
            assert any("was reached in the optimisation" in candidate.message for candidate in found.candidates)
            continue
        (stage,) = {s for s in ("search", "optimisation", "verification") if f"reached in the {s}" in found.reason}
        named.add(stage)
        assert found.outcome == ("not_verified" if stage == "verification" else "no_plan")
        assert found.findings[0].level == stage
        assert "solve_time_limit_s" in found.findings[0].remedy
        # Once it is over nothing new begins: the sequences left each ask once or twice.
        assert asked <= limit + 20
    assert named == {"search", "optimisation", "verification"}


@pytest.mark.parametrize("planner", [None, baseline_direct.plan, baseline_rrt.plan])
def test_a_tiny_limit_is_an_answer(planner: Callable[..., Plan] | None) -> None:
    found = solve(with_settings(planar_problem(), solve_time_limit_s=1e-9), planner=planner)
    assert found.outcome == "no_plan"
    assert "time limit" in found.reason
