"""What a machine measures is looked at again where the belief excludes it, before anything is done or claimed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hostile_plants import Hostile

from micah_plan.api.learning import learn
from micah_plan.belief.filter import innovations
from micah_plan.documents.experiment import load_experiment
from micah_plan.documents.problem import load_problem
from micah_plan.execution.closed_loop import Episode, TrialResult
from micah_plan.execution.messages import contradicted_in_a_row
from micah_plan.execution.nominal import NominalPlant
from micah_plan.execution.open_loop import carry_out
from micah_plan.execution.pose import configuration
from micah_plan.execution.trials import run_trials
from micah_plan.execution.watch import Watch
from micah_plan.planning.solver import solve

PROBLEMS = Path(__file__).resolve().parents[2] / "problems"
LONGEST = 46  # steps that are allowed


@pytest.fixture(scope="module")
def drawer():
    return load_problem(PROBLEMS / "drawer_open.yaml")


@pytest.fixture(scope="module")
def plan(drawer):
    return solve(drawer)


class Executed:
    """One execution on a plant with a fault, which it is not told."""

    def __init__(self, problem, plan, kind: str, seed: int = 0, at: int = 4) -> None:
        self.plant = Hostile(problem, kind, at)
        (result,) = run_trials(problem, plan, plant=self.plant, seed=seed).results
        self.result: TrialResult = result
        truth = self.plant.plant.truth()
        self.is_there = problem.goal.contains(str(truth.mode), truth.x)


@pytest.fixture(scope="module")
def healthy(drawer, plan) -> Executed:
    return Executed(drawer, plan, "none")


def test_a_healthy_machine_is_not_measured_twice(healthy, plan) -> None:
    assert healthy.result.success
    assert healthy.is_there
    assert healthy.result.steps == len(plan.trajectory.inputs)


@pytest.mark.parametrize(("kind", "more"), [("nan once", 1), ("leap", 2)])
def test_one_bad_answer_costs_a_look(drawer, plan, healthy, kind, more) -> None:
    found = Executed(drawer, plan, kind)
    assert found.result.success
    assert found.is_there
    assert found.result.steps >= healthy.result.steps + more


def test_a_leap_into_the_goal_is_no_success(drawer, plan) -> None:
    """The drawer is measured, once, exactly where the goal is."""

    class LeapsToTheGoal(Hostile):
        def lied(self, position, quaternion):
            if self.step != 5:
                return position, quaternion
            along = position - self.start
            return self.start + 0.22 * along / np.linalg.norm(along), quaternion

        def told(self, seen):
            self.start = seen.position if self.step == 0 else self.start
            return super().told(seen)

    plant = LeapsToTheGoal(drawer, "none", 5)
    (result,) = run_trials(drawer, plan, plant=plant, seed=0).results
    assert result.success
    assert result.steps > 10
    truth = plant.plant.truth()
    assert drawer.goal.contains(str(truth.mode), truth.x)


def test_what_leaps_about_until_the_trial_ends_is_no_success_where_it_lands(drawer, plan) -> None:
    """From the fourth step on it is measured at the goal and at the start, in turn; the last look is at the goal."""

    class LeapsAbout(Hostile):
        def lied(self, position, quaternion):
            if self.step == 0:
                self.start = position
            if self.step < 4:
                return position, quaternion
            along = position - self.start
            way = 0.23 if (self.step - 4) % 2 else 0.0
            return self.start + way * along / np.linalg.norm(along), quaternion

    plant = LeapsAbout(drawer, "none", 4)
    (result,) = run_trials(drawer, plan, plant=plant, seed=0).results
    assert (result.reason.code, result.reason.values["failure"]) == ("stopped_by_watch", contradicted_in_a_row(4))
    assert result.steps == 7
    assert result.final_error < 0.01  # believed, at the end
    assert not result.success


def test_nothing_is_commanded_by_what_is_measured_in_millimetres(drawer, plan) -> None:
    found = Executed(drawer, plan, "millimetres")
    assert not found.result.success
    assert found.result.reason.values["failure"] == contradicted_in_a_row(4)
    assert found.plant.largest == 0.0


@pytest.mark.sweep
@pytest.mark.parametrize("kind", ["leap for good", "zeros", "frozen", "stuck", "backwards", "nan for good"])
def test_what_stays_excluded_or_unseen_ends_the_trial(drawer, plan, kind) -> None:
    found = Executed(drawer, plan, kind)
    assert not found.result.success
    assert found.result.steps < LONGEST
    assert ("nothing was seen for 10 steps" if kind == "nan for good" else "the model") in found.result.reason
    assert found.plant.largest <= 0.03


@pytest.mark.sweep
@pytest.mark.parametrize("kind", ["half way", "twice as far"])
def test_a_filter_that_is_behind_catches_up_before_it_claims(drawer, plan, kind) -> None:
    found = [Executed(drawer, plan, kind, seed) for seed in range(4)]
    assert all(one.result.success and one.is_there for one in found)


@pytest.mark.parametrize(("stds", "looks"), [(0.5, 2), (-1.9, 2), (2.1, 6), (np.nan, 6)])
def test_a_filter_that_was_behind_is_believed_after_calm_looks(drawer, plan, stds, looks) -> None:
    """What was not measured agrees with nothing."""
    automaton, belief = drawer.automaton, Episode(drawer, plan.trajectory).prior
    scale = 0.1 / innovations(automaton, belief, belief.mean + 0.1)[0]
    watch, asked = Watch(automaton), 0
    watch.looks_again(belief, is_lost=False, unseen=None, ends=False)
    watch.record_innovation(belief, belief.mean + 4.0 * scale)
    assert watch.is_biased
    while watch.looks_again(belief, is_lost=False, unseen=None, ends=True):
        asked += 1
        watch.record_innovation(belief, belief.mean + stds * scale)
    assert asked == looks
    assert not watch.failure


def test_the_log_of_a_blind_step_repeats_the_pose_and_can_be_learned_from(drawer, plan) -> None:
    recording = Executed(drawer, plan, "nan once").result.recording
    repeated = [i for i in range(1, len(recording)) if np.array_equal(recording.position[i], recording.position[i - 1])]
    assert repeated == [4]
    assert learn(recording).automaton is not None


@pytest.mark.slow
def test_a_dark_place_is_no_reason_to_wait() -> None:
    problem = load_problem(PROBLEMS / "light_dark.yaml")
    statistics = run_trials(problem, solve(problem), trials=10)
    assert statistics.successes == 10
    assert max(result.steps for result in statistics.results) < 45


@pytest.mark.parametrize(("hidden", "missing"), [(0, [0, 1]), (1, [1, 2]), (2, [2])])
def test_parts_that_hang_on_an_unseen_one_are_not_measured(hidden, missing) -> None:
    rule = load_problem(PROBLEMS / "folding_rule.yaml")
    seen, automaton = NominalPlant.of(rule).reset(np.random.default_rng(0)), rule.automaton
    unseen, near, mode = np.arange(3) == hidden, np.zeros(automaton.n), automaton.modes[0].name
    x = configuration(automaton, mode, seen.position, seen.quaternion, near, unseen)
    assert np.flatnonzero(np.isnan(x)).tolist() == missing


def test_an_experiment_goes_on_where_a_part_is_not_seen() -> None:
    experiment = load_experiment(PROBLEMS / "experiments" / "drawer.yaml")
    recording, failures = carry_out(experiment, plant=lambda problem: Hostile(problem, "nan often", 1))
    assert failures == ()
    repeated = (np.diff(recording.position, axis=0) == 0).all(axis=1) & (np.diff(recording.run) == 0)
    commanded = np.abs(recording.action[:-1]).max(axis=1) > 0.005
    assert (repeated & commanded).any()
    believed = recording.believed()
    assert believed is not None
    # Where nothing was seen the belief goes on by the command, instead of staying at the last pose.
    went = np.linalg.norm(np.diff(believed.position, axis=0), axis=1)
    assert (went[repeated & commanded] > 0.004).all()
