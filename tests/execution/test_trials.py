"""Statistics over trials: reproducible, independent of order, honest about failures."""

import numpy as np
import pytest
from execution_objects import drawer, pulling
from extras import requires

from micah_plan.errors import InputError
from micah_plan.execution.checked_plant import make_plant
from micah_plan.execution.trials import run_trials
from micah_plan.task.goal import Goal
from micah_plan.task.plan import Plan
from micah_plan.task.problem import Problem
from micah_plan.task.start import Start

PULL = Problem(drawer(), Start((0.02,), (0.01,)), Goal(((0, 0.25, 0.004),)))
PLAN = Plan("solved", "", pulling())


def test_the_same_seed_gives_the_same_log():
    first, second = (run_trials(PULL, PLAN, trials=3, seed=5) for _ in range(2))
    assert first.recording.digest() == second.recording.digest()
    assert first.recording.digest() != run_trials(PULL, PLAN, trials=3, seed=6).recording.digest()


@pytest.mark.parametrize("kind", ["nominal", pytest.param("mujoco", marks=requires("sim"))])
def test_a_trial_does_not_depend_on_those_before_it(kind):
    many = run_trials(PULL, PLAN, plant=kind, trials=3, seed=5)
    few = run_trials(PULL, PLAN, plant=kind, trials=1, seed=5)
    assert many.recording.select(run=0).digest() == few.recording.digest()
    positions = [many.recording.select(run=run).position[0, 0] for run in (0, 1, 2)]
    assert len(set(positions)) == 3


def test_counts_errors_and_failures_agree():
    statistics = run_trials(PULL, PLAN, trials=12, seed=1)
    errors = np.array([abs(result.final_x[0] - 0.25) for result in statistics.results])
    assert statistics.trials == 12
    assert statistics.successes == (errors <= 0.004).sum() == 12 - len(statistics.failures)
    assert statistics.final_error.mean == pytest.approx(errors.mean())
    assert statistics.final_error.std == pytest.approx(errors.std())
    assert statistics.final_error.max == pytest.approx(errors.max())
    assert statistics.recording.runs == tuple(range(12))


def test_failures_carry_trial_and_reason():
    impossible = Problem(drawer(), PULL.start, Goal(((0, 0.25, 1e-9),)))
    statistics = run_trials(impossible, PLAN, trials=2, seed=1, max_steps=2)
    assert [trial for trial, _ in statistics.failures] == [0, 1]
    assert all("the 2 allowed steps ended" in reason for _, reason in statistics.failures)


def test_progress_ends_at_one():
    seen = []
    run_trials(PULL, PLAN, trials=2, progress=lambda text, share: seen.append((text, share)))
    assert [share for _, share in seen] == [0.5, 1.0]
    assert "trial 2 of 2" in seen[-1][0]


def test_a_plan_that_is_not_verified_is_executed_anyway_in_simulation_only():
    doubtful = Plan("not_verified", "fails often", pulling())
    assert run_trials(PULL, doubtful, trials=2, anyway=True).trials == 2
    with pytest.raises(
        InputError, match="a plan that is not verified moves no machine; choose plant nominal or mujoco"
    ):
        run_trials(PULL, doubtful, plant=lambda problem: make_plant(problem, "nominal"), anyway=True)
    with pytest.raises(InputError, match="plan has outcome no_plan: too narrow; only a solved plan"):
        run_trials(PULL, Plan("no_plan", "too narrow"), anyway=True)


def test_only_solved_plans_are_executed():
    with pytest.raises(InputError, match="plan has outcome no_plan: too narrow; only a solved plan can be executed"):
        run_trials(PULL, Plan("no_plan", "too narrow"))
    with pytest.raises(InputError, match=r"plan has outcome not_verified: .*`execute --anyway`"):
        run_trials(PULL, Plan("not_verified", "fails often", pulling()))
    with pytest.raises(InputError, match="trials must be at least 1"):
        run_trials(PULL, PLAN, trials=0)
    with pytest.raises(InputError, match="choose nominal or mujoco"):
        make_plant(PULL, "clay")
