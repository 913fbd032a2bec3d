"""Random small hybrid problems: a plan that verifies or a reason that is true, checked on a grid by other code.

Where the grid knows a clear way and noise is small, the planner must find one; where it knows that there is none, it
must not. In between either answer may be right, but what is claimed must hold.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_hybrids import CELLS, Grid, is_clearly_reachable, is_clearly_unreachable, random_problem, with_less_noise

from micah_plan.planning.limits import limits_of
from micah_plan.planning.roll_outs import are_in_goal, departure, draw_chances, roll_out
from micah_plan.planning.solver import solve
from micah_plan.task.goal import Goal
from micah_plan.task.plan import Plan
from micah_plan.task.problem import Problem

QUICK, BLOCKING, ALL = 3, 30, 200
# Fresh roll-outs of a verified plan, and by how much their share may be smaller than what was asked: 4 standard errors.
FRESH, SHORTFALL = 200, 0.08


def modes_of_goal(problem: Problem) -> set[str]:
    """The modes whose box has a state within the goal."""
    holding = set()
    for mode in problem.automaton.modes:
        rows = mode.invariant.half_spaces
        # A row says x[i] >= c or -x[i] >= c: how far the target is outside of it.
        gaps = [(h.c - h.a[i] * value, tol) for i, value, tol in problem.goal.target for h in rows if h.a[i]]
        if all(gap <= tolerance for gap, tolerance in gaps):
            holding.add(mode.name)
    return holding & set(problem.goal.modes or holding)


def modes_that_can_change(problem: Problem) -> set[str]:
    """The modes that inputs move or that another mode follows; all if there are none."""
    automaton = problem.automaton
    left = {edge.source for edge in automaton.edges if edge.target != edge.source}
    return left | {mode.name for mode in automaton.modes if np.any(mode.input_matrix)} or set(automaton.mode_names)


def has_chain(problem: Problem, ends: set[str]) -> bool:
    """Whether transitions lead from the start's mode to one of the modes."""
    reached = {problem.start.mode or ""}
    for _ in problem.automaton.modes:
        reached |= {edge.target for edge in problem.automaton.edges if edge.source in reached}
    return bool(reached & ends)


def check_answer(problem: Problem, found: Plan, seed: int) -> None:
    reachable, unreachable = is_clearly_reachable(problem), is_clearly_unreachable(problem)
    assert not (reachable and unreachable)
    assert found.reason
    if found.outcome == "no_plan":
        check_reason(problem, found)
        assert found.trajectory is None
        assert found.findings
    else:
        assert not unreachable, found.reason
    if found.outcome == "solved":
        assert found.trajectory is not None
        for index, value, tolerance in problem.goal.target:
            assert abs(found.trajectory.means[-1, index] - value) <= tolerance + 1e-5
        assert np.all(np.abs(found.trajectory.inputs) <= limits_of(problem).max_step + 1e-9)
        ends = roll_out(problem, found.trajectory, draw_chances(problem, found.trajectory, FRESH, 1000 + seed))
        assert departure(problem, found.trajectory) is None
        assert are_in_goal(problem, ends).mean() >= problem.settings.confidence - SHORTFALL


def check_reason(problem: Problem, found: Plan) -> None:
    """Reasons that claim a fact: the fact."""
    holding = modes_of_goal(problem)
    code = found.findings[0].code
    if code == "goal_outside_range":  # a goal that names no mode is sought where the state can still change
        assert not holding & (set(problem.goal.modes) or modes_that_can_change(problem)), found.reason
    elif code == "goal_in_no_mode":
        assert not holding, found.reason
    elif code == "no_transition_to_goal":
        assert not has_chain(problem, holding), found.reason
    elif code == "coordinate_not_moved":
        assert is_clearly_unreachable(problem), found.reason
    else:
        assert not is_clearly_reachable(with_less_noise(problem)) or is_noisy(problem), found.reason


def is_noisy(problem: Problem) -> bool:
    return problem.automaton.noise.process_std[0] > 0.001 or problem.start.std[0] > 0.004


@pytest.mark.parametrize(
    "seed",
    [
        *range(QUICK),
        *(pytest.param(s, marks=pytest.mark.slow) for s in range(QUICK, BLOCKING)),
        *(pytest.param(s, marks=pytest.mark.evidence) for s in range(BLOCKING, ALL)),
    ],
)
def test_a_plan_that_verifies_or_a_reason_that_is_true(seed: int) -> None:
    problem = random_problem(seed)
    found = solve(problem)
    check_answer(problem, found, seed)
    if is_clearly_reachable(problem) and not is_noisy(problem):
        assert found.outcome == "solved", found.reason


@pytest.mark.parametrize("seed", [78, 178])
def test_what_a_remedy_tries_gets_an_answer(seed: int) -> None:
    """Of 78 no input moves away from an obstacle; of 178 a state that is cut out lies in the goal."""
    check_answer(random_problem(seed), solve(random_problem(seed)), seed)


@pytest.mark.slow
@settings(max_examples=10)
@given(
    seed=st.integers(1000, 1020),
    std=st.floats(0.0, 0.2),
    tolerance=st.floats(1e-3, 0.5),
    knots=st.integers(2, 60),
    candidates=st.integers(1, 3),
    samples=st.integers(1, 40),
)
def test_no_setting_makes_it_fail(
    seed: int, std: float, tolerance: float, knots: int, candidates: int, samples: int
) -> None:
    problem = random_problem(seed)
    goal = Goal(tuple((i, value, tolerance) for i, value, _ in problem.goal.target), problem.goal.modes)
    chosen = replace(
        problem.settings, max_knots=knots, candidates=candidates, samples_per_mode=samples, verification_trials=20
    )
    start = replace(problem.start, std=(std,) * problem.automaton.n)
    found = solve(replace(problem, goal=goal, start=start, settings=chosen))
    assert found.outcome in ("solved", "no_plan", "not_verified")
    assert found.reason
    if found.trajectory is not None:
        assert len(found.trajectory.modes) <= knots


def test_the_grid_keeps_its_values() -> None:
    """A way that is there, and the same without the transition that it needs."""
    counts = {True: 0, False: 0}
    for seed in range(60):
        problem = random_problem(seed)
        if not is_clearly_reachable(problem):
            continue
        assert not is_clearly_unreachable(problem)
        severed = replace(problem, automaton=replace(problem.automaton, edges=()))
        ends = {name for name, _ in Grid(problem, -1.5 / CELLS).goal_parts()}
        counts[problem.start.mode in ends] += 1
        if problem.start.mode not in ends:
            assert is_clearly_unreachable(severed)
    assert min(counts.values()) >= 3
