"""Plans for objects that react late: what is commanded when, verification, files, and closed loops with the truth."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.tracks import displacements
from micah_plan.documents.plan import load_plan, write_plan
from micah_plan.documents.problem import load_problem
from micah_plan.execution.closed_loop import Episode, execute_episode
from micah_plan.execution.nominal import NominalPlant
from micah_plan.execution.pilot import Replanning
from micah_plan.execution.plant import Command
from micah_plan.execution.pose import command
from micah_plan.execution.trials import run_trials
from micah_plan.planning.input_memories import after_memories_run_out, linear_step, steps_of_memory, with_input_memory
from micah_plan.planning.limits import limits_of
from micah_plan.planning.receding_horizon import RecedingHorizon
from micah_plan.planning.replanning import replan
from micah_plan.planning.roll_outs import draw_chances, roll_out
from micah_plan.planning.solver import solve
from micah_plan.view.plan_page import plan_page

EFFECTS = {
    "delay": Effect("delay", "drawer", (("steps", 2.0),)),
    "lag": Effect("lag", "drawer", (("steps", 2.0),)),
    "backlash": Effect("backlash", "drawer", (("width", 0.15), ("side", -1.0))),
}


@pytest.fixture(scope="module")
def drawer(repository):
    problem = load_problem(repository / "problems" / "drawer_open.yaml")
    return replace(problem, settings=replace(problem.settings, verification_trials=200))


def problem_with(problem, *effects):
    return replace(problem, automaton=with_effect(problem.automaton, *effects))


@pytest.fixture(scope="module")
def plans(drawer):
    return {name: solve(problem_with(drawer, effect)) for name, effect in EFFECTS.items()}


@pytest.mark.slow
@pytest.mark.parametrize("name", EFFECTS)
def test_plans_are_solved_and_come_to_rest_in_the_goal(drawer, plans, name) -> None:
    plan, ((index, target, tolerance),) = plans[name], drawer.goal.target
    assert plan.outcome == "solved"
    assert plan.warnings == ()
    whole = with_input_memory(problem_with(drawer, EFFECTS[name])).automaton
    end = after_memories_run_out(whole, plan.trajectory.modes[-1], plan.trajectory.means[-1])
    assert abs(end[index] - target) < 0.5 * tolerance
    assert abs(plan.trajectory.means[-1, index] - target) < 0.5 * tolerance


def test_of_a_delay_the_last_inputs_are_given_so_many_steps_early(plans) -> None:
    inputs = plans["delay"].trajectory.inputs[:, 0]
    np.testing.assert_allclose(inputs[-2:], 0.0, atol=1e-4)
    assert np.all(inputs[:-2] > 0.01)


def test_a_late_start_is_corrected_by_what_is_not_yet_on_its_way(plans) -> None:
    gains = plans["delay"].trajectory.gains[3, 0]
    np.testing.assert_allclose(gains, gains[0], rtol=1e-5)
    assert gains[0] < -0.1


@pytest.mark.sweep
@pytest.mark.parametrize("name", ["delay", "backlash"])
def test_a_held_door_is_pulled_until_the_pull_arrives(repository, name) -> None:
    problem = load_problem(repository / "problems" / "microwave_open.yaml")
    values = (("steps", 2.0),) if name == "delay" else (("width", 0.1), ("side", 1.0))
    plan = solve(problem_with(problem, Effect(name, "door", values)))
    assert plan.outcome == "solved"
    assert plan.mode_sequence == ("rigid", "revolute")
    assert plan.trajectory.modes.count("rigid") >= 2
    assert plan.trajectory.inputs[0, 0] < 0


def test_steps_of_memory(drawer) -> None:
    def steps(name):
        return steps_of_memory(with_input_memory(problem_with(drawer, EFFECTS[name])).automaton, np.array([0.05]))

    assert steps("delay") == (2, 2)
    assert steps("backlash") == (3, 0)  # the third step of 5 cm takes up the last of 15 cm and arrives with the fourth
    felt, gone = steps("lag")
    assert (felt, gone) == (1, 7)  # 1 - exp(-2 / 2) > 0.5; exp(-8 / 2) < 0.02
    assert steps_of_memory(drawer.automaton, np.array([0.05])) == (0, 0)


def test_a_linear_step_is_the_step(drawer) -> None:
    whole = with_input_memory(problem_with(drawer, EFFECTS["delay"], EFFECTS["lag"])).automaton
    A, B = linear_step(whole, "prismatic", np.zeros(whole.n), np.zeros(1), np.array([0.03]))
    kept = np.exp(-0.5)
    expected = [[1, 0, 1 - kept, kept], [0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1 - kept, kept]]
    np.testing.assert_allclose(A, expected, atol=1e-9)
    np.testing.assert_allclose(B, [[0], [1], [0], [0]], atol=1e-9)


def test_verification_finds_out_a_plan_that_does_not_know_the_delay(drawer, plans) -> None:
    late, nominal = problem_with(drawer, EFFECTS["delay"]), solve(drawer)
    ends = {}
    for name, plan in (("nominal", nominal), ("own", plans["delay"])):
        chances = draw_chances(late, plan.trajectory, 100, 0)
        ends[name] = np.abs(roll_out(late, plan.trajectory, chances).states[:, 0] - drawer.goal.target[0][1]).mean()
    assert ends["nominal"] > 5 * ends["own"]


def test_a_plan_with_memory_is_written_read_and_shown(drawer, plans, tmp_path) -> None:
    late = problem_with(drawer, EFFECTS["delay"])
    write_plan(plans["delay"], late, tmp_path / "plan.json")
    stored = load_plan(tmp_path / "plan.json")
    np.testing.assert_array_equal(stored.plan.trajectory.means, plans["delay"].trajectory.means)
    assert stored.automaton.n == 1
    assert "SOLVED" in plan_page(stored.plan, stored.problem)
    assert run_trials(stored.problem, stored.plan, trials=2).successes == 2


def test_replanning_knows_what_is_on_its_way(drawer, plans) -> None:
    late = problem_with(drawer, EFFECTS["delay"])
    plant, rng = NominalPlant(late.automaton, late.start), np.random.default_rng(0)
    result = execute_episode(Episode(late, plans["delay"].trajectory, max_steps=6), plant, rng)
    belief = result.beliefs[-1]
    assert np.all(belief.means[0, 1:] > 0.01)
    planned = plans["delay"].trajectory
    for fresh in (replan(late, belief), RecedingHorizon(late, planned)(belief, planned, 6)):
        np.testing.assert_allclose(fresh.means[0], belief.means[0], atol=1e-6)
        pushed = fresh.inputs.sum() + belief.means[0, 1:].sum()
        assert fresh.means[-1, 0] - fresh.means[0, 0] == pytest.approx(pushed, abs=2e-3)


def settled_error(problem, plan, truth, seed):
    """The goal's error after an execution, when everything that was commanded has arrived, and the steps it took."""
    plant = NominalPlant(truth, replace(problem.start, mode=plan.trajectory.modes[0]))
    rng = np.random.default_rng(seed)
    episode = Episode(problem, plan.trajectory, replanning=Replanning(partial(replan, problem)))
    steps = execute_episode(episode, plant, rng).steps
    nothing = np.zeros((len(truth.links), 3))
    for _ in range(20):
        plant.apply(Command(np.zeros(truth.m), nothing, nothing))
    return problem.goal.error(plant.truth().x), steps


@pytest.mark.slow
@pytest.mark.parametrize("name", EFFECTS)
def test_closed_loop_with_the_memory_against_without(drawer, plans, name) -> None:
    noise = replace(drawer.automaton.noise, process_std=(2e-4,))
    truth = with_effect(replace(drawer.automaton, noise=noise), EFFECTS[name])
    nominal = np.array([settled_error(drawer, solve(drawer), truth, seed) for seed in range(3)])
    late = problem_with(drawer, EFFECTS[name])
    own = np.array([settled_error(late, plans[name], truth, seed) for seed in range(3)])
    assert own[:, 0].max() < 0.01
    if name == "backlash":  # feedback takes the play up, step by step; whoever knows of it does so at once
        assert own[:, 1].mean() < nominal[:, 1].mean() - 2
    else:  # who does not know of it stops too early or, surprised on the way, waits and corrects
        assert nominal[:, 0].max() > 0.02 or own[:, 1].mean() < nominal[:, 1].mean() - 2


@pytest.mark.sweep
@pytest.mark.parametrize(("name", "values"), [("sensor_scale", (0.7,)), ("drift", (0.01,))])
def test_execution_reads_its_sensors_as_the_model_says(drawer, name, values) -> None:
    wrong = problem_with(drawer, Effect(name, "drawer", (("scale" if name == "sensor_scale" else "rate", values[0]),)))
    plan = solve(drawer)
    errors = {}
    for key, problem in (("not known", drawer), ("known", wrong)):
        plant = NominalPlant(wrong.automaton, replace(drawer.start, mode="prismatic"))
        results = [
            execute_episode(Episode(problem, plan.trajectory), plant, np.random.default_rng(seed)) for seed in range(3)
        ]
        errors[key] = max(result.final_error for result in results)
    assert errors["known"] < 0.01
    assert errors["not known"] > 0.02


def test_commands_in_a_turned_frame_are_read_back_as_the_inputs(drawer) -> None:
    turn = Effect("frame_rotation", "drawer", (("rotation_1", 0.1), ("rotation_2", -0.4), ("rotation_3", 0.3)))
    turned = with_effect(drawer.automaton, turn)
    x, u = np.array([0.1]), np.array([0.02])
    order, plain = (command(automaton, "prismatic", x, u) for automaton in (turned, drawer.automaton))
    assert np.linalg.norm(order.handle - plain.handle) > 0.005
    np.testing.assert_allclose(np.linalg.norm(order.handle), np.linalg.norm(plain.handle))
    np.testing.assert_allclose(displacements(turned, x[None], order.origin[None])[0], u, atol=1e-12)


def test_no_more_is_commanded_than_a_saturation_lets_through(drawer) -> None:
    weak = problem_with(drawer, Effect("saturation", "drawer", (("largest", 0.013),)))
    assert limits_of(weak).max_step[0] == pytest.approx(0.013, abs=1e-9)
    assert limits_of(problem_with(drawer, Effect("gain", "drawer", (("gain", 0.5),)))).max_step[0] == 0.03
    plan = solve(weak)
    assert plan.outcome == "solved"
    assert len(plan.trajectory.inputs) > 0.22 / 0.013


def test_steps_and_feedback_count_with_what_arrives(drawer) -> None:
    weak = problem_with(drawer, Effect("gain", "drawer", (("gain", 0.5),)))
    plain, slow = (solve(problem).trajectory for problem in (drawer, weak))
    assert len(slow.inputs) > 1.8 * len(plain.inputs)
    assert slow.gains[0, 0, 0] < 1.1 * plain.gains[0, 0, 0] < 0.0
    place, largest = np.zeros(3), np.array([0.03])
    late = with_input_memory(problem_with(weak, EFFECTS["delay"])).automaton
    np.testing.assert_allclose(linear_step(weak.automaton, "prismatic", place[:1], place[:1], largest)[1], [[0.5]])
    A, B = linear_step(late, "prismatic", place, place[:1], largest)
    np.testing.assert_allclose(A[0], [1.0, 0.0, 0.5], atol=1e-9)
    np.testing.assert_allclose(B, [[0.0], [1.0], [0.0]], atol=1e-9)


def test_feedback_counts_with_what_arrives_after_the_last_knot(drawer) -> None:
    """Of a delay of 0.92 steps nearly all of the last input arrives too late to be seen at the end."""
    plan = solve(problem_with(drawer, Effect("delay", "drawer", (("steps", 0.92),))))
    assert plan.success_probability > 0.97
    assert np.abs(plan.trajectory.gains[:, 0, 0]).max() < 1.5
