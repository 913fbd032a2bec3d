"""POMDP-HD as a whole: outcomes, reasons, determinism, replanning."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from many_doors import cabinet_problem
from planning_examples import DOOR_SHUT, door_automaton, door_problem, drawer_problem, planar_problem, with_settings

from micah_plan.belief.filter import initial_belief
from micah_plan.planning.pomdp_hd import plan
from micah_plan.planning.replanning import replan
from micah_plan.planning.solver import solve
from micah_plan.planning.verification import verify
from micah_plan.task.plan import Plan
from micah_plan.task.problem import Problem
from micah_plan.task.reason import Reason
from micah_plan.task.start import start_mode


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("problem", "modes"),
    [
        (door_problem(0.2, DOOR_SHUT, goal_modes=("shut",)), ("swings", "shut")),
        (door_problem(DOOR_SHUT, 0.3, mode="shut"), ("shut", "swings")),
        (drawer_problem(0.0, 0.3), ("slides",)),
        (drawer_problem(0.3, 0.0), ("slides",)),
        (planar_problem(), ("left", "right")),
    ],
)
def test_plans_reach_the_goal_through_the_right_modes(problem: Problem, modes: tuple[str, ...]) -> None:
    found = plan(problem)
    assert found.outcome == "solved"
    assert found.mode_sequence == modes
    trajectory = found.trajectory
    assert trajectory is not None
    K, n, m = len(trajectory.modes), problem.automaton.n, problem.automaton.m
    assert trajectory.means.shape == (K, n)
    assert trajectory.factors.shape == (K, n, n)
    assert trajectory.inputs.shape == (K - 1, m)
    assert trajectory.gains.shape == (K - 1, m, n)
    assert trajectory.is_transition.sum() == len(modes) - 1
    np.testing.assert_allclose(trajectory.means[0], problem.start.mean, atol=1e-9)
    errors = [abs(trajectory.means[-1, i] - value) for i, value, _ in problem.goal.target]
    assert found.goal_error == pytest.approx(max(errors))
    assert all(e <= t + 1e-6 for e, (_, _, t) in zip(errors, problem.goal.target, strict=True))
    assert found.goal_std == pytest.approx(
        max(np.sqrt((trajectory.factors[-1] @ trajectory.factors[-1].T)[i, i]) for i, _, _ in problem.goal.target)
    )
    assert {"search", "build", "optimise", "total"} <= set(found.timings)


def test_candidates_come_in_order_of_search_cost_and_the_cheapest_optimum_is_kept() -> None:
    found = plan(door_problem(0.2, DOOR_SHUT))
    costs = [c.search_cost for c in found.candidates]
    assert costs == sorted(costs)
    assert len(costs) == 2
    assert found.cost == min(c.cost for c in found.candidates if c.cost is not None)


def test_latching_pays_when_the_pin_is_precise_and_sensing_is_not() -> None:
    """Contact is information: the same goal is reached through the latch only where the latch knows more."""
    problem = door_problem(0.2, DOOR_SHUT, tolerance=0.02)
    vague = replace(problem, automaton=replace(door_automaton(pin_std=1.0)))
    assert plan(problem).mode_sequence == ("swings", "shut")
    assert plan(with_settings(vague, confidence=0.5)).mode_sequence == ("swings",)


@pytest.mark.sweep
@pytest.mark.parametrize("problem", [door_problem(0.2, DOOR_SHUT), planar_problem()])
def test_the_same_seed_gives_the_same_bytes(problem: Problem) -> None:
    def content(found: Plan) -> tuple[object, ...]:
        t = found.trajectory
        assert t is not None
        arrays = (t.means, t.factors, t.inputs, t.gains, t.is_transition)
        return (t.modes, found.candidates, found.cost, found.reason, *(a.tobytes() for a in arrays))

    first = plan(problem, seed=5)
    plan(drawer_problem(0.0, 0.3), seed=1)
    assert content(plan(problem, seed=5)) == content(first)


def test_no_plan_for_a_goal_out_of_range_or_a_start_in_no_mode() -> None:
    out_of_range, lost = plan(door_problem(0.2, 2.0)), plan(door_problem(1.5, 0.9))
    assert (out_of_range.outcome, lost.outcome) == ("no_plan", "no_plan")
    assert out_of_range.trajectory is None
    assert out_of_range.findings[0].code == "goal_outside_range"
    assert [finding.code for finding in lost.findings] == ["start_in_no_mode"]
    assert "door = 1.5 ± 0.02 rad" in lost.reason


def test_no_plan_after_optimisation_names_the_sequence_and_the_cause() -> None:
    found = plan(with_settings(door_problem(0.2, 0.9), max_knots=10))
    assert found.outcome == "no_plan"
    assert "no mode sequence could be optimised; swings: the path needs at least" in found.reason
    assert all(c.cost is None for c in found.candidates)


def mode_of(problem: Problem) -> tuple[str | None, Reason | None]:
    return start_mode(problem.automaton, problem.start)


def test_the_start_mode_is_the_named_one_or_the_first_that_holds_the_mean() -> None:
    assert mode_of(door_problem(DOOR_SHUT, 0.3, mode="shut"))[0] == "shut"
    assert mode_of(door_problem(DOOR_SHUT, 0.3))[0] == "swings"
    # Slightly outside of every range, as an estimate may be: the nearest.
    assert mode_of(door_problem(-0.01, 0.3))[0] == "swings"
    mode, reason = mode_of(door_problem(0.3, 0.6, mode="shut"))
    assert mode is None
    assert "outside the range of its mode 'shut'" in str(reason)


def test_the_time_limit_ends_the_optimisation() -> None:
    found = plan(with_settings(planar_problem(), time_limit_s=1e-3))
    assert found.candidates
    assert all("stopped at the time limit" in c.message for c in found.candidates)


def test_progress_reports_stages_with_growing_fractions() -> None:
    heard: list[tuple[str, float]] = []
    plan(door_problem(0.2, DOOR_SHUT), progress=lambda text, fraction: heard.append((text, fraction)))
    assert [text for text, _ in heard] == ["searching mode sequences", "optimising swings", "optimising swings -> shut"]
    fractions = [fraction for _, fraction in heard]
    assert fractions == sorted(fractions)
    assert 0.0 <= fractions[0] < fractions[-1] < 1.0


def test_replanning_starts_from_the_belief() -> None:
    problem = door_problem(0.2, DOOR_SHUT)
    trajectory = replan(problem, initial_belief(problem.automaton, [0.7], [0.01], "swings"))
    assert trajectory is not None
    np.testing.assert_allclose(trajectory.means[0], [0.7])
    np.testing.assert_allclose(trajectory.factors[0], [[0.01]], rtol=1e-6)
    assert replan(door_problem(0.2, 3.0), initial_belief(problem.automaton, [0.7], [0.01], "swings")) is None


@pytest.mark.sweep
@pytest.mark.parametrize(("angle", "mode"), [(0.7, "swings"), (0.15, "swings"), (DOOR_SHUT, "shut")])
def test_replanning_keeps_to_the_modes_that_are_left_of_what_was_followed(
    angle: float, mode: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # 0.15 is further from the goal than the plan began: its modes still serve, its number of steps does not.
    problem = door_problem(0.2, DOOR_SHUT, goal_modes=("shut",))
    followed = plan(problem).trajectory
    assert followed is not None
    belief = initial_belief(problem.automaton, [angle], [0.0 if mode == "shut" else 0.01], mode)
    searched = replan(problem, belief)
    monkeypatch.setattr("micah_plan.planning.pomdp_hd.search_modes", lambda *_args, **_options: pytest.fail("searched"))
    rest = replan(problem, belief, (followed, 4))
    assert rest is not None
    assert searched is not None
    assert rest.modes == searched.modes
    np.testing.assert_allclose(rest.means, searched.means, atol=1e-3)


def test_replanning_searches_where_what_was_followed_does_not_lead_through_the_belief() -> None:
    problem = door_problem(DOOR_SHUT, 0.3, mode="shut", goal_modes=("swings",))
    away = plan(problem).trajectory
    assert away is not None
    ends = replace(away, modes=("swings",), means=away.means[-1:], factors=away.factors[-1:], inputs=away.inputs[:0])
    ends = replace(ends, gains=away.gains[:0], is_transition=away.is_transition[:0])
    again = replan(problem, initial_belief(problem.automaton, [DOOR_SHUT], [0.0], "shut"), (ends, 0))
    assert again is not None
    assert again.modes[0] == "shut"
    assert again.modes[-1] == "swings"


def test_planning_prints_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    plan(door_problem(0.2, DOOR_SHUT))
    assert capfd.readouterr() == ("", "")


@pytest.mark.evidence
def test_twelve_dimensions_and_64_modes_are_solved() -> None:
    problem = cabinet_problem(doors=6, drawers=6, opened=12, steps=10)
    assert (problem.automaton.n, len(problem.automaton.modes)) == (12, 64)
    found = solve(problem)
    assert found.outcome == "solved"
    assert len(found.mode_sequence) == 7
    assert found.success_probability is not None
    assert found.success_probability >= 0.95


def test_the_faster_the_pace_the_fewer_the_steps() -> None:
    problem = drawer_problem(0.0, 0.3)
    slow, usual, fast = (plan(with_settings(problem, pace=pace)) for pace in (0.3, 0.6, 1.0))
    steps = [len(found.trajectory.inputs) for found in (slow, usual, fast) if found.trajectory is not None]
    assert steps[0] > 1.7 * steps[1]
    assert steps[2] < 0.8 * steps[1]
    assert fast.outcome == "solved"


def test_a_latch_is_pushed_further_in_than_required_where_that_is_cheap() -> None:
    """Of the plans that only do what the confidence asks for, one in twenty misses; a centimetre more costs little."""
    problem = door_problem(0.2, DOOR_SHUT, goal_modes=("shut",))
    least, usual = (plan(with_settings(problem, weight_goal=weight)) for weight in (0.0, 1.0))
    verified = [verify(problem, found, trials=2000, seed=1) for found in (least, usual)]
    failing = [1.0 - (found.success_probability or 0.0) for found in verified]
    assert 0.03 < failing[0] < 0.08
    assert failing[1] < 0.01
    assert least.trajectory is not None
    assert usual.trajectory is not None
    assert len(usual.trajectory.inputs) == len(least.trajectory.inputs)
