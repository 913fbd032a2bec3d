"""Chains: transitions that fire one after the other at one instant, as one edge of search and transcription."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from planning_examples import door_problem, planar_problem

from micah_plan.automaton.transition import step
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.documents.plan import plan_text
from micah_plan.documents.problem import load_problem
from micah_plan.planning.receding_horizon import RecedingHorizon
from micah_plan.planning.replanning import rest_of
from micah_plan.planning.solver import solve
from micah_plan.planning.zero_time_transitions import ZeroTimeEdge, front_of, stds_of, with_zero_time_transitions
from micah_plan.task.problem import Problem

PROBLEMS = Path(__file__).resolve().parents[2] / "problems"


def stapler(theta: float, std: float = 0.03, name: str = "stapler_on_books") -> Problem:
    """A held stapler that is open by that much less than it can be, without the arm."""
    problem = load_problem(PROBLEMS / f"{name}.yaml")
    start = problem.start
    start = replace(start, mean=(*start.mean[:3], theta), std=(*start.std[:3], std))
    return replace(problem, start=start, robot=None, grasp=None)


def chains_of(problem: Problem) -> list[ZeroTimeEdge]:
    return [edge for edge in with_zero_time_transitions(problem).automaton.edges if isinstance(edge, ZeroTimeEdge)]


def test_only_what_can_happen_at_one_instant_is_a_chain() -> None:
    assert [(c.name, c.through) for c in chains_of(stapler(0.2))] == [
        ("free -> surface", ("line",)),
        ("free -> rigid", ("line", "surface")),
    ]
    for problem in (door_problem(0.2, 1.0), planar_problem(), load_problem(PROBLEMS / "drawer_behind_door.yaml")):
        assert with_zero_time_transitions(problem) is problem
    once = with_zero_time_transitions(stapler(0.2))
    assert with_zero_time_transitions(once) is once


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stapler_on_books", "stapler_in_shaft"])
def test_a_chain_is_what_the_transition_logic_does_at_one_instant(name: str) -> None:
    """From where its guard is met, an input into it takes all its transitions, and leads where its reset says."""
    problem = stapler(0.5, name=name)
    automaton, rng, seen = problem.automaton, np.random.default_rng(0), 0
    low, high = np.array([automaton.mode("free").interval(i) for i in range(automaton.n)]).T
    for chain in chains_of(problem):
        assert len(stds_of(chain)) == len(chain.guard.half_spaces)
        (crossed,) = front_of(chain)
        a = np.array(crossed.a)
        into = automaton.mode("free").B.T @ a
        for x in low + rng.random((2000, automaton.n)) * (high - low):
            x[:3] += a[:3] * (crossed.c - a @ x) / float(a[:3] @ a[:3])
            others = [h.margin(x, np.zeros(automaton.m)) for h in chain.guard.half_spaces if h is not crossed]
            inside = automaton.mode("free").invariant.contains(x, np.zeros(automaton.m), 1e-9)
            if not inside or min(others) < 1e-4:
                continue
            done = step(automaton, "free", x, 1e-9 * into)
            if any(event.target == "collided" for event in done.events):
                continue
            modes = [event.target for event in done.events if event.source != event.target]
            passed = [*chain.through, chain.target]
            assert modes[: len(passed)] == passed
            behind = chain.reset.apply(x, np.zeros(automaton.m))
            for pin in automaton.mode(chain.target).pins:
                behind[pin.coordinate] = pin.value
            np.testing.assert_allclose(done.events[len(passed) - 1].x_after, behind, atol=1e-6)
            seen += 1
    assert seen > 20


@pytest.mark.slow
@pytest.mark.parametrize(("theta", "std"), [(0.45, 0.03), (0.5, 0.03), (0.55, 0.02), (0.5, 0.1)])
def test_an_almost_shut_stapler_is_shut_and_placed(theta: float, std: float) -> None:
    problem = stapler(theta, std)
    plan = solve(problem)
    assert plan.outcome == "solved", plan.reason
    assert plan.mode_sequence[0] == "free"
    assert plan.mode_sequence[-1] == "rigid"
    assert plan_text(plan, problem)  # reads it again: transitions at one instant are no contradiction


@pytest.mark.slow
def test_what_remains_of_a_plan_with_a_chain_is_found_again() -> None:
    problem = stapler(0.5)
    trajectory = solve(problem).trajectory
    assert trajectory is not None
    chained = with_zero_time_transitions(problem)
    sequence, steps = rest_of(chained.automaton, trajectory, 0)
    taken = chained.automaton.edges[sequence.edges[0]]
    assert isinstance(taken, ZeroTimeEdge)
    assert taken.target == "surface"
    again = RecedingHorizon(problem, trajectory)
    modes = len(problem.automaton.modes)
    belief = HybridBelief(
        np.eye(modes)[0],
        np.tile(trajectory.means[1], (modes, 1)),
        np.tile(trajectory.factors[1], (modes, 1, 1)),
    )
    rest = again(belief, trajectory, 1)
    assert rest is not None
    assert sum(steps) - 1 == int((~rest.is_transition).sum())
