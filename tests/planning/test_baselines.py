"""The planners to compare with: through the same problem file, judged by the same roll-outs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import baseline_direct
import baseline_rrt
import numpy as np
import pytest
from baseline_direct import mixture_step, nominal_trajectory
from planning_examples import DOOR_SHUT, door_problem, drawer_problem, planar_problem, with_settings

from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.transition import simulate
from micah_plan.belief.filter import initial_belief, predict_belief, update
from micah_plan.documents.problem import load_problem
from micah_plan.errors import InputError
from micah_plan.planning.limits import limits_of
from micah_plan.planning.plan_cost import cost_of
from micah_plan.planning.pomdp_hd import plan as plan_pomdp_hd
from micah_plan.planning.solver import solve
from micah_plan.task.goal import Goal
from micah_plan.task.plan import Plan
from micah_plan.task.problem import Problem

PROBLEMS = Path(__file__).resolve().parents[2] / "problems"


PLANNERS = {"direct": baseline_direct.plan, "rrt": baseline_rrt.plan}


def solved_by(problem: Problem, name: str, seed: int = 0, **changes: object) -> Plan:
    return solve(with_settings(problem, **changes), planner=PLANNERS[name], seed=seed)


@pytest.mark.sweep
@pytest.mark.parametrize("method", ["direct", "rrt"])
@pytest.mark.parametrize("name", ["drawer_open", "microwave_close"])
def test_baselines_solve_the_easy_problems(method: str, name: str) -> None:
    problem = load_problem(PROBLEMS / f"{name}.yaml")
    found = solved_by(problem, method)
    assert found.outcome == "solved"
    assert found.trajectory is not None
    assert found.success_probability is not None
    assert found.success_probability >= 0.93
    for index, value, tolerance in problem.goal.target:
        assert abs(found.trajectory.means[-1, index] - value) <= tolerance
    assert np.all(np.abs(found.trajectory.inputs) <= limits_of(problem).max_step + 1e-9)


@pytest.mark.slow
def test_the_tree_goes_through_the_gate_and_past_the_trap() -> None:
    found = solved_by(planar_problem(), "rrt")
    assert found.mode_sequence == ("left", "right")
    assert found.trajectory is not None
    modes, states = found.trajectory.modes, found.trajectory.means
    # The last knot of "left" and the first of "right" share a time, at which the gate is passed.
    gate = modes.index("right")
    assert states[gate, 1] >= 0.8 - 0.12
    # A belief that the tree does not know makes part of the roll-outs hit the trap.
    assert found.success_probability is not None


@pytest.mark.slow
def test_the_same_seed_gives_the_same_tree_after_any_other_call() -> None:
    problem = with_settings(planar_problem(), verification_trials=1)
    first = solved_by(problem, "rrt", 3)
    solved_by(problem, "rrt", 4)
    again = solved_by(problem, "rrt", 3)
    assert first.trajectory is not None
    assert again.trajectory is not None
    assert first.trajectory.inputs.tobytes() == again.trajectory.inputs.tobytes()


@pytest.mark.evidence
def test_the_direct_planner_does_not_see_the_way_around_a_wall() -> None:
    """The straight start runs against the trap, from which no gradient leads to the gate: what the modes are for."""
    problem = with_settings(planar_problem(), verification_trials=200)
    hierarchical, direct = solve(problem), solved_by(problem, "direct")
    assert hierarchical.outcome == "solved"
    assert direct.outcome != "solved"


@pytest.mark.slow
@pytest.mark.parametrize("method", ["direct", "rrt"])
def test_what_is_impossible_is_refused_with_a_reason(method: str) -> None:
    outside = solved_by(door_problem(0.2, 2.0), method)
    assert outside.outcome == "no_plan"
    assert outside.findings[0].level == "goal"
    start = solved_by(door_problem(-3.0, 0.5), method)
    assert start.outcome == "no_plan"
    assert start.findings[0].level == "start"


def test_limits_of_time_end_the_baselines() -> None:
    goal = Goal(((0, 0.6, 0.02),), ("shut",))  # the latch holds the door elsewhere
    problem = replace(door_problem(0.2, DOOR_SHUT), goal=goal)
    hasty = solved_by(planar_problem(), "rrt", solve_time_limit_s=1e-6)
    assert "within the time limit" in hasty.reason
    assert (
        "reached in the optimisation: 0 of 4 starts"
        in solved_by(planar_problem(), "direct", solve_time_limit_s=1e-6).reason
    )
    assert solved_by(problem, "rrt").outcome == "no_plan"


def test_a_mixture_that_is_too_large_is_not_begun() -> None:
    problem = planar_problem()
    wide = replace(problem.automaton, modes=problem.automaton.modes * 1000)
    assert "too large for direct planning" in solved_by(replace(problem, automaton=wide), "direct").reason


def test_the_nominal_trajectory_is_that_of_the_real_transitions() -> None:
    problem = door_problem(0.9, DOOR_SHUT)
    inputs = np.array([[0.05]] * 8)
    found = nominal_trajectory(problem, limits_of(problem), "swings", inputs)
    run = simulate(problem.automaton, "swings", [0.9], inputs)
    timed = np.concatenate([[0], np.flatnonzero(~found.is_transition) + 1])
    np.testing.assert_array_equal(found.means[timed], run.states)
    assert found.modes[-1] == run.modes[-1] == "shut"
    assert found.is_transition.sum() == 1


def test_costs_of_baselines_are_those_of_the_hierarchical_programme() -> None:
    problem = drawer_problem(0.05, 0.3)
    found = plan_pomdp_hd(problem)
    assert found.trajectory is not None
    assert cost_of(problem, limits_of(problem), found.trajectory) == pytest.approx(found.cost, abs=1e-4)


def test_the_mixture_step_agrees_with_the_filter_far_from_guards_and_moves_weight_behind_them() -> None:
    problem = door_problem(0.2, DOOR_SHUT)
    automaton, limits = problem.automaton, limits_of(problem)
    step = mixture_step(automaton, limits)
    belief = initial_belief(automaton, [0.5], [0.02], "swings")
    z = np.array([0.5, 0.02, 1.0, 0.0])
    for _ in range(4):
        predicted = predict_belief(automaton, belief, [0.03])
        belief = update(automaton, predicted, predicted.means[0])
        z = np.array(step(z, [0.03])).ravel()
    np.testing.assert_allclose(z, [belief.means[0, 0], belief.factors[0, 0, 0], 1.0, 0.0], atol=1e-5)
    for _ in range(25):
        z = np.array(step(z, [0.05])).ravel()
    assert z[3] > 0.95
    assert z[2] + z[3] == pytest.approx(1.0)
    assert z[0] == pytest.approx(DOOR_SHUT, abs=0.02)


def test_what_planning_leaves_out_of_a_model_is_reported() -> None:
    problem = drawer_problem(0.05, 0.3)
    lags = with_effect(problem.automaton, Effect("lag", "drawer", (("steps", 0.3),)))
    (told,) = solved_by(replace(problem, automaton=lags), "direct").warnings
    assert "leave out the lag of drawer" in told


@pytest.mark.parametrize(("value", "said"), [("rrt", "expected 'pomdp-hd'"), ("pomdp-hd", "")])
def test_files_that_name_the_planner_are_read_if_it_is_the_one(tmp_path: Path, value: str, said: str) -> None:
    text = (PROBLEMS / "drawer_open.yaml").read_text().replace("../models", str(PROBLEMS.parent / "models"))
    (tmp_path / "p.yaml").write_text(text.replace("planner:\n", f"planner:\n  method: {value}\n", 1))
    if said:
        with pytest.raises(InputError, match=said):
            load_problem(tmp_path / "p.yaml")
    else:
        assert load_problem(tmp_path / "p.yaml").settings == load_problem(PROBLEMS / "drawer_open.yaml").settings
