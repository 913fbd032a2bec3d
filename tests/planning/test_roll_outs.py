"""Roll-outs of all trials at once against one roll-out after the other by the scalar transition and filter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planning_examples import (
    DOOR_SHUT,
    door_automaton,
    door_problem,
    drawer_problem,
    one_dimensional,
    planar_problem,
    with_settings,
)
from reference.hybrid_step import step

from micah_plan.automaton.drawn_thresholds import threshold_stds, with_boundaries
from micah_plan.automaton.hybrid import HybridAutomaton, Noise, Reset
from micah_plan.automaton.sensing import Light
from micah_plan.belief.filter import initial_belief, predict_belief, update
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.planning.feedback import feedback_input, time_knots
from micah_plan.planning.limits import limited_input, limits_of
from micah_plan.planning.pomdp_hd import plan
from micah_plan.planning.roll_outs import Chances, are_in_goal, draw_chances, roll_out
from micah_plan.task.goal import Goal
from micah_plan.task.plan import Trajectory
from micah_plan.task.problem import Problem
from micah_plan.task.settings import PlannerSettings
from micah_plan.task.start import Start

TRIALS = 40


def blurred(automaton: HybridAutomaton, std: float) -> HybridAutomaton:
    """The automaton with thresholds known to `std`."""
    edges = (edge if edge.is_self_transition else replace(edge, threshold_std=std) for edge in automaton.edges)
    return replace(automaton, edges=tuple(edges))


def noisy(automaton: HybridAutomaton, process: float, observation: float) -> HybridAutomaton:
    return replace(automaton, noise=Noise((process,) * automaton.n, (observation,) * automaton.n))


def one_roll_out(
    problem: Problem, trajectory: Trajectory, chances: Chances, trial: int
) -> tuple[str, np.ndarray, HybridBelief]:
    """Alone: the true mode and state at the end, and the belief."""
    automaton, limits = problem.automaton, limits_of(problem)
    certain = not threshold_stds(automaton).size
    truth = automaton if certain else with_boundaries(automaton, chances.objects.shifts[trial])
    mode, x = trajectory.modes[0], chances.starts[trial]
    belief = initial_belief(automaton, problem.start.mean, problem.start.std, mode)
    for number, knot in enumerate(time_knots(trajectory)):
        estimate = belief.means[belief.most_likely]
        wanted = feedback_input(trajectory, int(knot), estimate)
        u = limited_input(automaton.modes[belief.most_likely], estimate, wanted, limits.max_step)
        after = step(truth, mode, x, u, chances.process[number, trial])
        mode, x = after.mode, after.x
        predicted = predict_belief(automaton, belief, u)
        std = automaton.sensing(automaton.mode(mode)).std_at(x)
        belief = update(automaton, predicted, x + std * chances.observation[number, trial])
    return mode, x, belief


def crossing_back_and_forth() -> Problem:
    """A wide belief at a threshold, with clamps at both ends close by."""
    automaton = noisy(one_dimensional(0.0, 0.1, 0.2), 0.02, 0.05)
    return Problem(automaton, Start((0.05,), (0.05,)), Goal(((0, 0.15, 0.05),)), PlannerSettings(samples_per_mode=40))


def turned_back(returns: bool) -> Problem:
    """Behind the threshold the same input leads back to it; with a wide belief, which often misses the step across."""
    automaton = noisy(one_dimensional(0.0, 0.3, 0.6), 0.01, 0.02)
    first, second = automaton.modes
    edges = automaton.edges if returns else (automaton.edges[0], *automaton.edges[2:])
    automaton = replace(automaton, modes=(first, replace(second, input_matrix=((-1.0,),))), edges=edges)
    settings = PlannerSettings(samples_per_mode=40, max_step=(0.06,))
    return Problem(automaton, Start((0.1,), (0.03,)), Goal(((0, 0.45, 0.05),)), settings)


def thrown_back() -> Problem:
    """Latching moves the door's coordinate elsewhere."""
    automaton = noisy(door_automaton(), 0.01, 0.02)
    latch = replace(automaton.edges[0], reset=Reset(A=((0.5,),), B=((0.25,),), c=(0.3,)))
    automaton = replace(automaton, edges=(latch, *automaton.edges[1:]))
    return door_problem(1.0, DOOR_SHUT, automaton=automaton, goal_modes=("shut",), tolerance=0.4)


def lit_door() -> Problem:
    """A door that is seen best at 0.7 rad, and precisely once it is shut."""
    automaton = noisy(door_automaton(), 0.01, 0.02)
    shut = replace(automaton.mode("shut"), observation_std=((0, 0.003),))
    light = Light(((0, 0.7),), (0.2,))
    automaton = replace(automaton, modes=(automaton.modes[0], shut), noise=replace(automaton.noise, light=light))
    return door_problem(0.9, DOOR_SHUT, automaton=automaton, goal_modes=("shut",))


PROBLEMS = {
    "latching": door_problem(0.9, DOOR_SHUT, automaton=noisy(door_automaton(), 0.01, 0.02), goal_modes=("shut",)),
    "unlatching": door_problem(DOOR_SHUT, 0.9, mode="shut"),
    "a clamp at the goal": drawer_problem(0.1, 0.0),
    "a gate of two half-spaces": planar_problem(),
    "a wide belief at a threshold": crossing_back_and_forth(),
    "a reset": thrown_back(),
    "a boundary that turns": turned_back(returns=True),
    "a boundary that mirrors": turned_back(returns=False),
    "sensing by mode and place": lit_door(),
    "thresholds that are not certain": door_problem(
        0.9, DOOR_SHUT, automaton=blurred(door_automaton(pin_std=0.04), 0.04), goal_modes=("shut",), tolerance=0.2
    ),
}


@pytest.mark.sweep
@pytest.mark.parametrize("name", PROBLEMS)
def test_all_at_once_is_one_after_the_other(name: str) -> None:
    problem = with_settings(PROBLEMS[name], confidence=0.8)
    trajectory = plan(problem).trajectory
    assert trajectory is not None
    chances = draw_chances(problem, trajectory, TRIALS, seed=3)
    ends = roll_out(problem, trajectory, chances)
    inside = are_in_goal(problem, ends)
    names = [mode.name for mode in problem.automaton.modes]
    for trial in range(TRIALS):
        mode, x, belief = one_roll_out(problem, trajectory, chances, trial)
        assert names[ends.modes[trial]] == mode
        np.testing.assert_allclose(ends.states[trial], x, rtol=0, atol=1e-9)
        np.testing.assert_allclose(ends.beliefs.weights[trial], belief.weights, rtol=1e-6, atol=1e-9)
        likely = belief.weights > 1e-6
        np.testing.assert_allclose(ends.beliefs.means[trial, likely], belief.means[likely], rtol=0, atol=1e-8)
        found, expected = (
            b @ b.transpose(0, 2, 1) for b in (ends.beliefs.factors[trial, likely], belief.factors[likely])
        )
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-10)
        assert inside[trial] == problem.goal.contains(mode, x)


def test_the_seed_decides_and_starts_are_possible() -> None:
    problem = PROBLEMS["thresholds that are not certain"]
    trajectory = plan(problem).trajectory
    assert trajectory is not None
    first, again, other = (draw_chances(problem, trajectory, 50, seed) for seed in (1, 1, 2))
    assert all(np.array_equal(getattr(first, key), getattr(again, key)) for key in ("starts", "process", "observation"))
    assert not np.array_equal(first.process, other.process)
    assert np.ptp(first.objects.shifts) > 0.05
    assert (first.starts[:, 0] < DOOR_SHUT + first.objects.shifts[:, 0]).all()


def test_what_is_not_measured_stays_unknown() -> None:
    problem = planar_problem()
    blind = replace(problem.automaton, noise=Noise((0.002, 0.002), (0.01, np.inf)))
    problem = replace(problem, automaton=blind)
    trajectory = plan(planar_problem()).trajectory
    assert trajectory is not None
    ends = roll_out(problem, trajectory, draw_chances(problem, trajectory, 20, seed=0))
    stds = np.linalg.norm(ends.beliefs.factors[np.arange(20), ends.beliefs.most_likely], axis=2)
    assert (stds[:, 1] > 2 * stds[:, 0]).all()
