"""Closed-loop execution: it reaches goals on both plants, stops for the right reason, replans, and logs what it did."""

from dataclasses import replace

import numpy as np
import pytest
from execution_objects import SHUT, closing, door, drawer, opening, pulling, straight
from extras import requires

from micah_plan.automaton.hybrid import Noise
from micah_plan.automaton.tracks import tracks
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.execution.checked_plant import make_plant
from micah_plan.execution.closed_loop import Episode, execute_episode
from micah_plan.execution.pilot import PlanFollower, Replanning
from micah_plan.recording.csv_file import read_csv, write_csv
from micah_plan.robot.tool_path import ArmFailure
from micah_plan.task.goal import Goal
from micah_plan.task.path import PathConstraint, Require, path_function, remove_path_function
from micah_plan.task.problem import Problem
from micah_plan.task.settings import PlannerSettings
from micah_plan.task.start import Start

TRACKER = {"position_noise": 0.003, "rotation_noise": 0.03}

CLOSE = Problem(door(0.3), Start((0.0,), (0.05,)), Goal(((0, SHUT, 0.03),), ("shut",)), plant=TRACKER)
OPEN = Problem(door(0.3), Start((SHUT,), (0.001,), "shut"), Goal(((0, 0.4, 0.04),)), plant=TRACKER)
PULL = Problem(drawer(), Start((0.02,), (0.01,)), Goal(((0, 0.25, 0.008),)), plant=TRACKER)
TASKS = [(CLOSE, closing()), (OPEN, opening()), (PULL, pulling())]


def run(problem, trajectory, kind="nominal", seed=0, **options):
    asked = {name: options.pop(name) for name in ("replan", "continue_plan", "ask_arm") if name in options}
    episode = Episode(problem, trajectory, replanning=Replanning(**asked), **options)
    return execute_episode(episode, make_plant(problem, kind), np.random.default_rng(seed))


def quiet(problem):
    n = problem.automaton.n
    noise = Noise((1e-9,) * n, (1e-9,) * n)
    return replace(problem, automaton=replace(problem.automaton, noise=noise), start=replace(problem.start, std=(0.0,)))


@pytest.mark.parametrize("kind", ["nominal", pytest.param("mujoco", marks=requires("sim"))])
@pytest.mark.parametrize(("problem", "trajectory"), TASKS, ids=["close", "open", "pull"])
def test_the_goal_is_reached(problem, trajectory, kind):
    result = run(problem, trajectory, kind)
    assert result.success, result.reason
    assert result.final_error <= problem.goal.target[0][2]
    assert result.confidence >= problem.settings.confidence
    assert len(result.beliefs) == result.steps + 1


def test_a_start_in_the_goal_needs_no_step():
    problem = replace(PULL, start=Start((0.25,), (0.001,)))
    result = run(problem, pulling())
    assert result.steps == 0
    assert result.success
    assert len(result.recording) == 1
    assert np.isnan(result.recording.action).all()


def test_a_wide_goal_is_entered_up_to_where_the_plan_aims():
    problem = replace(PULL, goal=Goal(((0, 0.25, 0.1),)))
    result = run(problem, pulling())
    assert result.success
    assert result.final_error < 0.01
    assert result.steps == 8


def test_it_stops_where_the_steps_end_with_its_probability():
    result = run(PULL, pulling(), max_steps=3)
    assert result.steps == 3
    assert not result.success
    assert "the 3 allowed steps ended with 0 % probability of the goal, but drawer is" in result.reason


def test_a_tolerance_below_the_noise_is_never_believed_reached():
    problem = replace(PULL, goal=Goal(((0, 0.25, 1e-4),)))
    result = run(problem, pulling())
    assert result.steps == 2 * 8 + 20
    assert result.confidence < 0.5


@pytest.mark.parametrize(("problem", "trajectory"), TASKS, ids=["close", "open", "pull"])
def test_without_noise_measured_positions_follow_the_logged_actions(problem, trajectory):
    problem = quiet(problem)
    recording = run(problem, trajectory).recording
    moved = np.diff(recording.position, axis=0)
    asked = recording.action[:-1]
    held = np.array([mode == "shut" for mode in recording.extra["mode"]])
    free = ~(held[:-1] & held[1:])
    # Where the door runs into its end the action asks for more than there is.
    free &= ~np.isclose(np.array(recording.extra["true_" + problem.automaton.coordinates[0].name][1:], float), SHUT)
    assert free.sum() >= 7
    np.testing.assert_allclose(moved[free], asked[free], atol=1e-6)


@pytest.mark.parametrize(("problem", "trajectory"), TASKS, ids=["close", "open", "pull"])
def test_the_log_is_a_recording_that_can_be_read_back_and_predicted(problem, trajectory, tmp_path):
    result = run(problem, trajectory, run=4)
    write_csv(result.recording, tmp_path / "run.csv")
    again = read_csv(tmp_path / "run.csv")
    np.testing.assert_array_equal(again.position, result.recording.position)
    assert again.runs == (4,)
    assert np.isnan(again.action[-1]).all()
    assert not np.isnan(again.action[:-1]).any()
    assert again.extra == result.recording.extra
    (track,) = tracks(problem.automaton, again)
    name = problem.automaton.coordinates[0].name
    believed, true = (np.array(again.extra[f"{column}_{name}"], float) for column in ("belief", "true"))
    std = np.array(again.extra[f"belief_std_{name}"], float)
    assert (std > 0).all()
    assert abs(true[-1] - result.final_x[0]) < 1e-8
    observation = problem.automaton.noise.observation_std[0]
    assert np.abs(track.x[:, 0] - true).max() < 5 * observation
    assert np.abs(believed - true).max() < 5 * observation


def test_a_belief_far_from_the_plan_requests_a_new_one():
    # The plan starts at 0.02, the drawer stands at 0.15, and the prior is wide enough to find out.
    problem = replace(PULL, start=Start((0.15,), (0.01,)))
    asked = []

    def replan(belief, _followed):
        asked.append(belief.mean[0])
        return straight(["sliding"] * 5, list(np.linspace(belief.mean[0], 0.25, 5)), 0.002)

    result = run(problem, pulling(), replan=replan)
    assert result.success, result.reason
    assert result.replans == len(asked) == 1
    assert asked[0] == pytest.approx(0.15, abs=0.02)
    assert result.steps <= 5


def test_a_plan_that_ends_short_of_the_goal_is_continued_by_a_new_one():
    asked = []

    def replan(belief, _followed):
        asked.append(belief.mean[0])
        return straight(["sliding"] * 5, list(np.linspace(belief.mean[0], 0.25, 5)), 0.002)

    short = straight(["sliding"] * 4, list(np.linspace(0.02, 0.12, 4)), 0.002)
    assert not run(PULL, short).success
    result = run(PULL, short, replan=replan)
    assert result.success, result.reason
    assert asked[0] == pytest.approx(0.12, abs=0.01)


def test_a_replan_without_result_keeps_the_old_plan_and_is_not_requested_for_ever():
    asked = []
    problem = replace(PULL, start=Start((0.15,), (0.01,)))
    result = run(problem, pulling(), replan=lambda belief, _: asked.append(belief))
    assert 1 <= len(asked) <= 5
    assert result.replans == 0


def test_a_new_plan_that_the_arm_cannot_follow_is_refused_and_reported():
    problem = replace(PULL, start=Start((0.15,), (0.01,)))
    ahead = straight(["sliding"] * 5, list(np.linspace(0.15, 0.25, 5)), 0.002)
    stuck = ArmFailure(2, "joint limit", ("elbow",), 0.1, "joint limit of 'elbow' (upper)", "")
    result = run(problem, pulling(), replan=lambda *_: ahead, ask_arm=lambda *_: stuck, max_steps=4)
    assert result.replans == 0
    assert set(result.refusals) == {"the arm cannot follow: joint limit of 'elbow' (upper)"}
    assert "the last because the arm cannot follow: joint limit of 'elbow' (upper)" in result.reason


def test_a_late_transition_is_waited_for():
    # The plan believes the door shut after 10 knots, but it starts 0.3 rad further open than planned.
    problem = quiet(replace(CLOSE, start=Start((0.0,), (0.0,))))
    ahead = straight(["swinging"] * 10 + ["shut"], [*np.linspace(0.3, 1.22, 10), SHUT], 0.02, gain=0.0)
    result = run(problem, ahead)
    assert result.success, result.reason
    assert result.steps > 9


def test_an_early_transition_does_not_cut_the_plan_short():
    """Going on past the guard is what makes a transition sure; it was planned, and the roll-outs verified it."""
    problem = quiet(replace(CLOSE, start=Start((0.9,), (0.0,)), goal=Goal(((0, 0.6, 0.02),), ("swinging",))))
    there_and_back = straight(
        ["swinging"] * 10 + ["shut"] + ["swinging"] * 7,
        [*np.linspace(0.0, 1.22, 10), SHUT, *np.linspace(SHUT, 0.6, 7)],
        0.02,
        gain=0.0,
    )
    result = run(problem, there_and_back)
    assert result.success, result.reason
    assert result.steps == (~there_and_back.is_transition).sum()
    assert "shut" in result.recording.extra["mode"]


def test_inputs_stay_within_the_limits():
    problem = replace(PULL, settings=PlannerSettings(max_step=(0.01,)), goal=Goal(((0, 0.1, 0.01),)))
    result = run(problem, pulling(), max_steps=20)
    lengths = np.linalg.norm(result.recording.action[:-1], axis=1)
    assert lengths.max() <= 0.01 + 1e-12
    assert lengths.max() == pytest.approx(0.01)


def test_a_door_perhaps_not_shut_is_pressed_once_more():
    problem, trajectory = CLOSE, closing()
    follower = PlanFollower(problem, trajectory)
    shut = HybridBelief(np.array([0.0, 1.0]), np.array([[1.19], [SHUT]]), np.full((2, 1, 1), 0.005))
    steps = int((~trajectory.is_transition).sum())
    assert [follower.advise(shut).fit for _ in range(steps + 1)] == ["on_plan"] * steps + ["finished"]
    # Nothing to doubt: any pull would open the latch.
    np.testing.assert_array_equal(follower.advise(shut).u, [0.0])
    doubted = HybridBelief(np.array([0.1, 0.9]), shut.means, shut.factors)
    np.testing.assert_allclose(follower.advise(doubted).u, [1.22 - 1.19], atol=1e-12)


def test_a_receding_horizon_looks_ahead_every_so_many_steps():
    problem = replace(PULL, settings=replace(PULL.settings, replan_every=3))
    asked = []

    def onward(belief, trajectory, knot):
        asked.append((len(trajectory.modes) - knot, belief.mean[0]))
        rest = np.linspace(belief.mean[0], 0.25, len(trajectory.modes) - knot)
        return straight(["sliding"] * len(rest), list(rest), 0.002)

    result = run(problem, pulling(), continue_plan=onward)
    assert result.success, result.reason
    assert result.continuations == len(asked) > 1
    assert np.diff([left for left, _ in asked]).tolist() == [-3] * (len(asked) - 1)
    assert result.steps == run(PULL, pulling()).steps
    assert not run(PULL, pulling(), continue_plan=onward).continuations


def test_what_cannot_be_continued_is_followed_as_it_is():
    problem = replace(PULL, settings=replace(PULL.settings, replan_every=2))
    result = run(problem, pulling(), continue_plan=lambda *_: None)
    same = run(PULL, pulling())
    assert result.continuations == 0
    assert (result.steps, result.final_x.tolist()) == (same.steps, same.final_x.tolist())


def test_a_plan_goes_on_while_its_rest_still_leads_to_the_goal():
    """The belief lags behind the planned transition, but the feedback of the knots to come makes up for it."""
    modes, means = ["swinging"] * 10 + ["shut"] * 6, [*np.linspace(0.0, 1.22, 10), *[1.3] * 6]
    follower = PlanFollower(CLOSE, straight(modes, means, 0.02, gain=-0.5))
    shut = HybridBelief(np.array([0.0, 1.0]), np.array([[1.19], [SHUT]]), np.full((2, 1, 1), 0.005))
    for _ in range(9):
        follower.advise(shut)
    late = HybridBelief(np.array([1.0, 0.0]), np.array([[1.15], [SHUT]]), np.full((2, 1, 1), 0.005))
    assert follower.advise(late).fit == "on_plan"
    np.testing.assert_allclose(follower.advise(late).u, [0.5 * (1.3 - 1.15)], atol=1e-12)
    far = HybridBelief(np.array([1.0, 0.0]), np.array([[0.3], [SHUT]]), np.full((2, 1, 1), 0.005))
    assert follower.advise(far).fit == "lagging"


def test_without_a_new_plan_it_stops_with_the_reason():
    """The door is held: it never moves, and the plan to shut it is missed."""
    problem = quiet(replace(CLOSE, start=Start((0.0,), (0.0,)), settings=PlannerSettings(max_step=(1e-4,))))
    result = run(problem, closing(), replan=lambda *_: None, max_steps=200)
    assert not result.success
    assert result.steps < 100
    assert (result.reason.code, result.reason.values["mode"]) == ("off_plan", "swinging")


def test_an_execution_that_breaks_a_constraint_on_the_path_fails_and_names_it():
    def asking(largest):
        return replace(PULL, constraints=(PathConstraint("slowly", (("largest", largest),)),))

    @path_function
    def slowly(ops, step, *, largest):
        return [Require("slowly", largest - ops.abs(step.u["drawer"]), step.unit["drawer"])]

    try:
        most = max(abs(u) for u in pulling().inputs[:, 0])
        kept = run(asking(2.0 * most), pulling())
        broken = run(asking(0.5 * most), pulling())
    finally:
        remove_path_function("slowly")
    assert kept.success, kept.reason
    assert not broken.success
    assert broken.reason.code == "stopped_confident"
    assert broken.reason.values["missed"] == ("constraint_violated",)
    assert "'slowly'" in broken.reason
    assert broken.final_error == kept.final_error


def test_a_goal_that_is_reached_in_another_mode_is_reached():
    """Noise may leave a door, or a foot on a table, in the mode before the plan's last one: the goal asks for none."""
    problem = replace(CLOSE, goal=Goal(((0, SHUT, 0.03),)))

    def with_tested_remedies(x, mode):
        follower, factors = PlanFollower(problem, closing()), np.full((2, 1, 1), 0.001)
        shut = HybridBelief(np.array([0.0, 1.0]), np.array([[1.19], [SHUT]]), factors)
        for _ in range(int((~closing().is_transition).sum())):
            follower.advise(shut)
        weights = np.array([mode == "swinging", mode == "shut"], dtype=float)
        belief = HybridBelief(weights, np.array([[x], [SHUT]]), factors)
        return follower.is_finished(belief), follower.advise(belief).fit

    assert with_tested_remedies(1.19, "swinging") == (True, "finished")
    assert with_tested_remedies(1.0, "swinging") == (False, "lagging")
    assert with_tested_remedies(1.0, "shut") == (True, "finished")
