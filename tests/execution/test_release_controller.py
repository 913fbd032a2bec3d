"""Releases, carried out: in the model, and in MuJoCo where fingers hold by friction, open, and leave what stands."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from extras import requires

from micah_plan.documents.problem import load_problem
from micah_plan.errors import InputError
from micah_plan.execution.nominal import NominalPlant
from micah_plan.execution.plant import Command
from micah_plan.execution.trials import run_trials
from micah_plan.planning.solver import solve

PROBLEM = Path(__file__).resolve().parents[2] / "problems" / "stapler_on_books.yaml"


@cache
def solved(*, arm: bool = False):
    problem = load_problem(PROBLEM)
    if not arm:
        problem = replace(problem, robot=None, grasp=None, release=replace(problem.release, fingers=()))
    return problem, solve(problem)


def command(u, **changes) -> Command:
    return Command(np.array(u), np.zeros((5, 3)), np.zeros((5, 3)), **changes)


@pytest.mark.slow
def test_in_the_model_most_trials_end_with_the_object_on_the_books() -> None:
    problem, plan = solved()
    statistics = run_trials(problem, plan, trials=20)
    assert statistics.released == statistics.successes >= 16  # 97.8 % are predicted; fewer have a chance of 1 in 10,000
    good = [result for result in statistics.results if result.released]
    np.testing.assert_allclose([result.final_x[2] for result in good], 0.26, atol=0.01)
    # The heights differ as the books do.
    assert 0.001 < np.std([result.final_x[2] for result in good]) < 0.003
    # What is logged ends where the hand begins to put the object down.
    last = good[0]
    assert last.recording.extra["mode"][-1] == "rigid"
    assert len(last.beliefs) == last.steps + 1 == len(set(last.recording.time.tolist()))


class Deaf(NominalPlant):
    """Does not measure forces."""

    def _measure(self, *arguments):
        return replace(super()._measure(*arguments), force=None)


class Numb(NominalPlant):
    """Feels nothing."""

    def _measure(self, *arguments):
        measured = super()._measure(*arguments)
        return replace(measured, force=np.zeros_like(measured.force))


@pytest.mark.slow
def test_a_hand_that_feels_nothing_does_not_let_go() -> None:
    problem, plan = solved()
    statistics = run_trials(problem, plan, plant=Numb.of)
    assert (statistics.released, statistics.successes) == (0, 0)
    assert "no contact was felt" in statistics.results[0].reason


@pytest.mark.slow
def test_a_plant_without_a_force_sensor_is_refused() -> None:
    problem, plan = solved()
    with pytest.raises(InputError, match=r"Measurement.force is None; measure it, or leave 'release' out"):
        run_trials(problem, plan, plant=Deaf.of)


@pytest.mark.slow
def test_without_a_referee_it_is_believed() -> None:
    problem, plan = solved()

    def blind(problem):
        plant = NominalPlant.of(problem)

        class Blind:
            reset, apply, close = plant.reset, plant.apply, plant.close

        return Blind()

    statistics = run_trials(problem, plan, plant=blind, trials=3)
    assert statistics.believed
    assert statistics.released == statistics.successes == 3


@pytest.mark.slow
def test_a_plan_for_keeping_hold_lets_nothing_go() -> None:
    problem = load_problem(PROBLEM, {"release": None, "goal.target.z.value": 0.288, "robot": None, "grasp": None})
    statistics = run_trials(problem, solve(problem), trials=3)
    assert statistics.released is None
    assert statistics.results[0].released is None


from micah_plan.execution.mujoco.held import HeldPlant

pytestmark = requires("sim")


@pytest.mark.slow
@pytest.mark.parametrize("arm", [False, pytest.param(True, marks=pytest.mark.evidence)])
def test_in_mujoco_the_stapler_stands_on_the_books(arm: bool) -> None:
    problem, plan = solved(arm=arm)
    statistics = run_trials(problem, plan, plant="mujoco", trials=2, seed=3)
    assert statistics.released == 2, statistics.failures
    for result in statistics.results:
        np.testing.assert_allclose(result.final_x[:3], [0.45, 0.0, 0.26], atol=0.01)


@pytest.fixture(scope="module")
def plant():
    machine = HeldPlant(solved()[0])
    yield machine
    machine.close()


def put_down(plant, **start) -> None:
    """Stand at the rest's place, latched, and a little above the books."""
    problem = plant.problem
    mean = tuple({**dict(zip("xyz", (0.45, 0.0, 0.29), strict=True)), "theta": 0.573, **start}.values())
    plant.problem = replace(problem, start=replace(problem.start, mean=mean, std=(1e-6,) * 4, mode="rigid"))
    plant.reset(np.random.default_rng(5))
    plant.problem = problem
    plant.apply(command([0.0, 0.0, 0.0]))


def test_the_hand_stops_where_it_feels_the_books(plant) -> None:
    put_down(plant)
    steps = 0
    while steps < 20:
        steps += 1
        measured = plant.apply(command([0.0, 0.0, -0.004], force_limit=3.0))
        if measured.force[3, 2] < -2.5:
            break
    assert 3 <= steps <= 10
    assert measured.force[3, 2] > -6.0
    assert plant.truth().x[2] > 0.2 + 0.06
    assert plant.truth().incident == ""


def test_a_hand_that_opens_in_the_air_drops_the_object(plant) -> None:
    put_down(plant, x=0.1, z=0.3)
    plant.apply(command([0.0, 0.0, 0.0], opens=True))
    for _ in range(3):
        plant.apply(command([0.0, 0.0, 0.03]))
    assert plant.truth().x[2] < 0.15  # it lies on the table
    assert plant._released.hand[2] > 0.35


def test_a_hand_that_has_not_left_still_touches(plant) -> None:
    put_down(plant)
    assert not plant.truth().stands


def test_the_books_are_as_high_as_drawn_and_stay_where_they_are(plant) -> None:
    put_down(plant)
    heights = []
    for seed in range(20):
        plant.reset(np.random.default_rng(seed))
        heights.append(plant.support.raised)
    for _ in range(5):
        plant.apply(command([0.0, 0.0, 0.0]))
    top = plant.model.body("scene/book_4").id
    np.testing.assert_allclose(plant.data.xpos[top], [0.475, 0.0, 0.175], atol=1e-4)
    assert 0.001 < np.std(heights) < 0.004
