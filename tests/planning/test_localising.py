"""Plans that go where they can find out where they are: walls to bump into, light to see in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from planning_examples import planar_problem, with_settings
from scipy.sparse import csr_array
from single_gaussian import one_at_a_time
from single_gaussian import reference as gaussian

from micah_plan.documents.problem import load_problem
from micah_plan.execution.trials import run_trials
from micah_plan.planning.limits import limits_of
from micah_plan.planning.pomdp_hd import plan
from micah_plan.planning.roll_outs import Chances, draw_chances, roll_out
from micah_plan.planning.search.mode_search import ModeSequence, search_modes
from micah_plan.planning.search.path_beliefs import PathBeliefs, steps_to_correct_start
from micah_plan.planning.search.roadmap import JoinedRoadmap
from micah_plan.planning.solver import solve
from micah_plan.planning.verification import verify
from micah_plan.task.plan import Plan
from micah_plan.task.problem import Problem

PROBLEMS = Path(__file__).resolve().parents[2] / "problems"
TRUE_START = np.array([35.0, 20.0])


@pytest.fixture(scope="module")
def walls() -> Problem:
    return load_problem(PROBLEMS / "walled_domain.yaml")


@pytest.fixture(scope="module")
def bumping(walls: Problem) -> Plan:
    return plan(walls)


@pytest.fixture(scope="module")
def dark() -> Problem:
    return load_problem(PROBLEMS / "light_dark.yaml")


def precise(problem: Problem, std: float) -> Problem:
    """The same problem with a sensor that is as good everywhere."""
    noise = replace(problem.automaton.noise, observation_std=(std, std), light=None)
    return replace(problem, automaton=replace(problem.automaton, noise=noise))


def found(problem: Problem, seed: int = 0) -> tuple[ModeSequence, ...]:
    mode = problem.start.mode or problem.automaton.modes[0].name
    return search_modes(problem, limits_of(problem), mode, seed).sequences


def true_errors(problem: Problem, found: Plan, trials: int, seed: int, start: np.ndarray | None = None) -> np.ndarray:
    """(trials,) distance of the true state from the goal at the end, from the given or from drawn true starts."""
    assert found.trajectory is not None
    chances = draw_chances(problem, found.trajectory, trials, seed)
    if start is not None:
        starts = np.tile(start, (trials, 1))
        chances = Chances(chances.objects, starts, chances.process, chances.observation)
    ends = roll_out(problem, found.trajectory, chances)
    return np.asarray(np.linalg.norm(ends.states - [value for _, value, _ in problem.goal.target], axis=1))


def test_the_setting_is_that_of_the_paper(walls: Problem) -> None:
    automaton = walls.automaton
    variance = {
        mode.name: np.square(automaton.sensing(mode).std_at(np.array([3.0, -7.0]))).tolist() for mode in automaton.modes
    }
    assert variance == {"free": [400, 400], "wall_x": [1, 400], "wall_y": [400, 1], "corner": [1, 1]}
    assert walls.start.mean == (50.0, 50.0)
    assert np.square(walls.start.std) == pytest.approx(1150, rel=1e-5)
    assert walls.goal.target == ((0, 0.0, 2.0), (1, 0.0, 2.0))


def test_the_way_through_the_walls_is_found_and_chosen(bumping: Plan) -> None:
    assert bumping.outcome == "solved"
    assert bumping.mode_sequence[0] == bumping.mode_sequence[-1] == "free"
    assert "corner" in bumping.mode_sequence
    trajectory = bumping.trajectory
    assert trajectory is not None
    stds = np.linalg.norm(trajectory.factors, axis=2)
    for axis, wall in enumerate(("wall_x", "wall_y")):
        touching = [i for i, mode in enumerate(trajectory.modes) if mode in (wall, "corner")]
        # Contact: from metres to a decimetre, at the wall.
        assert stds[touching[0] - 1, axis] > 2.0
        assert stds[touching, axis].max() < 0.11
        assert trajectory.means[touching, axis] == pytest.approx(-20.0, abs=1e-6)
    assert stds[-1].max() < 0.7
    assert np.abs(trajectory.inputs).max() <= 5.0 + 1e-6


def test_the_true_robot_arrives(walls: Problem, bumping: Plan) -> None:
    assert (true_errors(walls, bumping, 100, 77, TRUE_START) < 2.0).sum() >= 95


@pytest.mark.slow
def test_the_true_robot_arrives_from_anywhere_and_in_closed_loop(walls: Problem) -> None:
    solved = solve(walls)
    assert solved.success_probability is not None
    near = (true_errors(walls, solved, 1000, 78) < 2.0).mean()
    assert near >= 0.95
    assert abs(near - solved.success_probability) < 0.03
    assert (true_errors(walls, solved, 1000, 79, TRUE_START) < 2.0).mean() >= 0.95
    done = run_trials(walls, solved, trials=20, seed=5)
    assert done.successes >= 18, done.failures


def test_without_the_walls_there_is_no_way(walls: Problem) -> None:
    """A sequence that may not come back into the open cannot use a wall; what is left does not hold."""
    ahead = with_settings(walls, revisits=0)
    assert {sequence.modes for sequence in found(ahead)} == {("free",)}
    refused = verify(ahead, plan(ahead), trials=200)
    assert refused.outcome == "not_verified"
    assert refused.success_probability is not None
    assert refused.success_probability < 0.4


def test_with_precise_sensing_the_walls_are_left_alone(walls: Problem) -> None:
    sees = precise(walls, 0.3)
    straight = verify(sees, plan(sees), trials=200)
    assert straight.outcome == "solved"
    assert straight.mode_sequence == ("free",)
    assert straight.success_probability is not None
    assert straight.success_probability > 0.95
    assert found(sees)[0].modes == ("free",)


def test_into_the_light_only_if_it_is_dark(dark: Problem) -> None:
    solved = verify(dark, plan(dark), trials=400)
    assert solved.outcome == "solved"
    assert solved.trajectory is not None
    assert 4.0 < solved.trajectory.means[:, 0].max() < 6.0
    assert (true_errors(dark, solved, 100, 3, np.array([2.5, 0.0])) < 0.5 * np.sqrt(2)).sum() >= 95
    (straight,) = found(precise(dark, 0.1))
    np.testing.assert_allclose(straight.waypoints[0], [[2.0, 2.0], [0.0, 0.0]], atol=1e-9)
    sees = plan(precise(dark, 0.1))
    assert sees.trajectory is not None
    assert sees.trajectory.means[:, 0].max() < 2.1


@pytest.mark.parametrize("revisits", [0, 1, 2])
def test_no_mode_is_revisited_more_often_than_allowed(walls: Problem, revisits: int) -> None:
    sequences = found(with_settings(walls, revisits=revisits, candidates=12))
    most = max(sequence.modes.count(mode) for sequence in sequences for mode in sequence.modes)
    assert most == 1 + revisits


def test_sequences_are_ranked_by_length_and_uncertainty_the_same_every_time(walls: Problem) -> None:
    first, again = found(walls), found(walls)
    totals = [sequence.total for sequence in first]
    assert totals == sorted(totals)
    assert [sequence.modes for sequence in first] == [sequence.modes for sequence in again]
    for one, other in zip(first, again, strict=True):
        assert (one.cost, one.uncertainty) == (other.cost, other.uncertainty)
        for left, right in zip(one.waypoints, other.waypoints, strict=True):
            np.testing.assert_array_equal(left, right)


def test_waypoints_join_and_keep_to_their_modes(walls: Problem) -> None:
    automaton, nothing = walls.automaton, np.zeros(2)
    for sequence in found(with_settings(walls, candidates=8)):
        assert len(sequence.edges) == len(sequence.modes) - 1 == len(sequence.waypoints) - 1
        for number, name in enumerate(sequence.modes):
            points = sequence.waypoints[number]
            assert automaton.mode(name).invariant.contains(points, np.tile(nothing, (len(points), 1)), 1e-9).all()
            if number:
                edge = automaton.edges[sequence.edges[number - 1]]
                assert (edge.source, edge.target) == (sequence.modes[number - 1], name)
                np.testing.assert_allclose(points[0], sequence.waypoints[number - 1][-1], atol=1e-9)


def test_a_start_that_nothing_can_correct_takes_no_more_steps_than_a_plan(dark: Problem) -> None:
    """An effect may take nearly all of an input; the search went through 10^15 steps, past its time limit."""
    far = replace(dark, start=replace(dark.start, std=(1e15, 1e15)))
    assert steps_to_correct_start(far, limits_of(far), far.automaton.modes[0]) == far.settings.max_knots


def test_the_predicted_variance_is_that_of_the_filter(dark: Problem) -> None:
    """Along one straight motion through uneven light, against the filter step by step."""
    points = np.array([[2.0, 2.0], [5.0, -1.0]])
    nothing = np.zeros(0, dtype=np.int64)
    roadmap = JoinedRoadmap(
        {"floor": csr_array(np.zeros((2, 2)))}, {}, {}, ("floor", 0), {"floor": nothing}, {"floor": np.zeros(0)}
    )
    beliefs = PathBeliefs(dark, limits_of(dark), roadmap, {"floor": points})
    variance, overshoot, least = beliefs.hop(np.array([[5.0, 2.0]]), np.array([0]), np.array([1]))
    assert overshoot == 0
    assert least == pytest.approx(6.0)  # 3 m at 0.5 m per step
    mean, factor, steps = points[0], np.diag(np.sqrt([5.0, 2.0])), 10
    mode = dark.automaton.modes[0]
    for _ in range(steps):
        mean, factor = gaussian.predict(mean, factor, (points[1] - points[0]) / steps, (0.03, 0.03))
        mean, factor, _ = one_at_a_time.update(mean, factor, mean, dark.automaton.sensing(mode).std_at(mean))
    np.testing.assert_allclose(variance[0], np.square(np.diag(factor)), rtol=1e-9)


def test_contact_in_the_predicted_variance(walls: Problem) -> None:
    """Into a wall: k standard deviations of overshoot, then the pin; out of it: nothing is lost."""
    open_, wall = np.array([[-20.0, 7.0]]), np.array([[-20.0, 7.0]])
    empty = {name: csr_array(np.zeros((1, 1))) for name in ("free", "wall_x")}
    exits = {0: np.array([[0, 0]]), 4: np.array([[0, 0]])}
    nothing = {name: np.zeros(0, dtype=np.int64) for name in empty}
    roadmap = JoinedRoadmap(
        empty,
        exits,
        {0: ("free", "wall_x"), 4: ("wall_x", "free")},
        ("free", 0),
        nothing,
        {n: np.zeros(0) for n in empty},
    )
    beliefs = PathBeliefs(walls, limits_of(walls), roadmap, {"free": open_, "wall_x": wall})
    touched, overshoot, steps = beliefs.hop(np.array([[16.0, 9.0]]), np.array([0]), np.array([1]))
    np.testing.assert_allclose(touched, [[0.01, 9.0]])
    assert overshoot == pytest.approx(1.6448536 * 4.0 / 5.0)
    assert steps == overshoot
    left, overshoot, _ = beliefs.hop(touched, np.array([1]), np.array([0]))
    np.testing.assert_allclose(left, touched)
    assert overshoot == 0


def test_the_final_variance_costs_what_the_optimisation_makes_of_it(walls: Problem) -> None:
    point = {"free": np.zeros((1, 2))}
    goals = {"free": np.array([0])}
    roadmap = JoinedRoadmap({"free": csr_array(np.zeros((1, 1)))}, {}, {}, ("free", 0), goals, {"free": np.zeros(1)})
    beliefs = PathBeliefs(walls, limits_of(walls), roadmap, point)
    settings, at = walls.settings, np.zeros(2, dtype=np.int64)
    variance = np.array([[0.04, 0.09], [25.0, 16.0]])
    now = beliefs.ending(variance, at, np.zeros(2))
    np.testing.assert_allclose(now, variance.sum(axis=1) / 4.0 * settings.weight_covariance / settings.weight_effort)
    later = beliefs.ending(variance, at, np.full(2, 10.0))
    assert later[0] == now[0]  # narrow enough: no need to wait
    assert later[1] < now[1]


def test_where_nothing_is_to_be_gained_the_shortest_way_is_taken() -> None:
    problem = planar_problem()
    (first, *_) = found(replace(problem, start=replace(problem.start, mode="left")))
    assert first.modes == ("left", "right")
    assert len(first.waypoints[0]) <= 4


@pytest.mark.slow
def test_what_is_hardly_known_of_the_world_is_touched_first_and_followed() -> None:
    """A parameter is a coordinate that no input moves; a plan that trusts its mean misses what the touch finds."""
    key = load_problem(PROBLEMS / "key_by_touch.yaml")
    trusting = plan(replace(key, start=replace(key.start, std=(*key.start.std[:2], 5e-4))))
    assert "edge" not in trusting.mode_sequence
    missed = verify(key, trusting, trials=300)
    assert missed.success_probability is not None
    assert missed.success_probability < 0.2
    touching = plan(key)
    assert touching.mode_sequence == ("before", "beside", "edge", "before", "keyhole")
    found = verify(key, touching, trials=300)
    assert found.outcome == "solved"
    assert found.success_probability is not None
    assert found.success_probability > 0.95
