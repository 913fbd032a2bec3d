"""Random small problems: a plan whose claims hold or a reason that is true, never an exception."""

from __future__ import annotations

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from planning_examples import one_dimensional

from micah_plan.arrays import EQUAL
from micah_plan.planning.pomdp_hd import plan
from micah_plan.task.goal import Goal
from micah_plan.task.problem import Problem
from micah_plan.task.settings import PlannerSettings
from micah_plan.task.start import Start

unit = st.floats(0.0, 1.0)


@pytest.mark.slow
@settings(max_examples=40)
@given(threshold=st.floats(0.2, 0.8), start=st.floats(-0.3, 1.3), goal=st.floats(-0.3, 1.3), std=st.floats(0.0, 0.1),
       tolerance=st.floats(0.005, 0.2), seed=st.integers(0, 10))  # fmt: skip
@example(threshold=0.5, start=5e-324, goal=0.0, std=0.0, tolerance=0.125, seed=0)
@example(threshold=0.5, start=-6e-8, goal=0.0, std=0.0, tolerance=0.125, seed=0)
def test_a_plan_or_a_true_reason(
    threshold: float, start: float, goal: float, std: float, tolerance: float, seed: int
) -> None:
    automaton = one_dimensional(0.0, threshold, 1.0)
    settings_ = PlannerSettings(samples_per_mode=20, time_limit_s=5.0)
    problem = Problem(automaton, Start((start,), (std,)), Goal(((0, goal, tolerance),)), settings_)
    found = plan(problem, seed)
    # A limit copied with fewer digits is still the limit.
    beyond = max(0.0 - start - EQUAL * threshold, start - 1.0 - EQUAL * (1.0 - threshold))
    start_outside = beyond > 3.0 * max(std, 1e-9)
    goal_outside = max(0.0 - goal, goal - 1.0) > tolerance + 1e-9
    if found.outcome == "solved":
        trajectory = found.trajectory
        assert trajectory is not None
        assert abs(trajectory.means[-1, 0] - goal) <= tolerance + 1e-5
        assert not start_outside
        assert not goal_outside
    elif found.findings[0].code == "start_in_no_mode":
        assert start_outside
    else:
        assert goal_outside, found.reason
        assert found.findings[0].code in ("goal_in_no_mode", "goal_outside_range")
