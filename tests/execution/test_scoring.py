"""Goal probabilities against sampling, and the truth in the model's terms."""

from dataclasses import replace

import numpy as np
import pytest
from execution_objects import SHUT, arm, closing, door

from micah_plan.belief.filter import initial_belief
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.execution.closed_loop import Episode, goal_probability, true_state
from micah_plan.execution.nominal import NominalPlant
from micah_plan.execution.plant import Truth
from micah_plan.task.goal import Goal
from micah_plan.task.problem import Problem
from micah_plan.task.start import Start


def test_in_one_dimension_the_probability_is_exact():
    belief = initial_belief(door(), [0.5], [0.02], "swinging")
    assert goal_probability(door(), Goal(((0, 0.52, 0.03),)), belief) == pytest.approx(0.6853, abs=1e-4)
    assert goal_probability(door(), Goal(((0, 0.52, 0.03),), ("shut",)), belief) == 0.0


def test_in_two_dimensions_it_is_never_overstated():
    automaton = arm()
    rng = np.random.default_rng(0)
    goal = Goal(((0, 0.1, 0.1), (1, 0.0, 0.05)))
    for correlation in (-0.95, 0.0, 0.95):
        factor = np.diag([0.05, 0.02]) @ np.linalg.cholesky([[1.0, correlation], [correlation, 1.0]])
        belief = HybridBelief(np.ones(1), np.array([[0.13, 0.01]]), factor[None])
        samples = belief.means[0] + rng.standard_normal((40000, 2)) @ factor.T
        inside = (abs(samples[:, 0] - 0.1) <= 0.1) & (abs(samples[:, 1]) <= 0.05)
        claimed = goal_probability(automaton, goal, belief)
        assert inside.mean() - 0.1 < claimed < inside.mean() + 0.005


def test_modes_that_do_not_count_are_left_out():
    automaton = door()
    belief = HybridBelief(np.array([0.3, 0.7]), np.full((2, 1), SHUT), np.full((2, 1, 1), 1e-3))
    assert goal_probability(automaton, Goal(((0, SHUT, 0.05),)), belief) == pytest.approx(1.0)
    assert goal_probability(automaton, Goal(((0, SHUT, 0.05),), ("shut",)), belief) == pytest.approx(0.7)
    assert goal_probability(automaton, Goal((), ("shut",)), belief) == pytest.approx(0.7)


def test_the_error_is_that_of_the_worst_coordinate():
    goal = Goal(((0, 0.5, 0.1), (1, 0.0, 0.01)), ("moving",))
    assert goal.error(np.array([0.45, 0.02])) == pytest.approx(0.05)
    assert goal.error(np.array([0.5, -0.02])) == pytest.approx(0.02)
    assert Goal((), ("moving",)).error(np.zeros(2)) == 0.0


@pytest.mark.parametrize("held", [False, True])
def test_a_plant_without_modes_is_read_by_what_it_holds(held):
    # At the threshold both modes fit by configuration; only the latch tells them apart.
    automaton = door()
    plant = NominalPlant(automaton, Start((SHUT,), (0.0,), "shut"))
    plant.reset(np.random.default_rng(0))
    known = plant.truth()
    truth = Truth(None, known.x + 0.5, known.position, known.quaternion, np.array([held]))
    mode, x = true_state(automaton, truth)
    assert mode == ("shut" if held else "swinging")
    np.testing.assert_allclose(x, [SHUT], atol=1e-9)


def test_a_collision_is_no_success_though_the_model_has_no_mode_for_it():
    automaton = door()
    problem = Problem(automaton, Start((SHUT,), (0.0,), "shut"), Goal(((0, SHUT, 0.05),)))
    plant = NominalPlant(automaton, problem.start)
    episode, seen, known = Episode(problem, closing()), plant.reset(np.random.default_rng(0)), plant.truth()
    arrived = replace(known, mode="collided", incident="it hit 'wall' at 0.1 s")
    assert true_state(automaton, arrived)[0] == "collided"
    belief = initial_belief(automaton, [SHUT], [1e-3], "shut")
    assert episode.decide(belief, seen, arrived) is None
    result = episode.result()
    assert not result.success
    assert result.final_mode == "collided"
    assert "but it hit 'wall' at 0.1 s" in result.reason
