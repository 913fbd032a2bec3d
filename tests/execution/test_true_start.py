"""A true start apart from the believed one: in the problem file, on the command line and in Python."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from micah_plan.api.execution import execute
from micah_plan.api.planning import PlanningResult
from micah_plan.cli.planning import starts_of
from micah_plan.documents.plan import load_plan, write_plan
from micah_plan.documents.problem import load_problem
from micah_plan.errors import InputError
from micah_plan.execution.nominal import NominalPlant
from micah_plan.execution.trials import run_trials
from micah_plan.planning.solver import solve
from micah_plan.task.start import sample_start

PROBLEMS = Path(__file__).resolve().parents[2] / "problems"
LIGHT = PROBLEMS / "light_dark.yaml"


def first_state(problem, seed: int = 0):
    plant = NominalPlant.of(problem)
    plant.reset(np.random.default_rng(seed))
    truth = plant.truth()
    return truth.mode, truth.x


def test_named_coordinates_start_there_and_others_as_believed() -> None:
    problem = load_problem(LIGHT, {"start.true": {"x": 2.5}})
    drawn = first_state(load_problem(LIGHT))[1]
    for seed in (0, 1):
        assert first_state(problem, seed)[1][0] == 2.5
    np.testing.assert_array_equal(first_state(problem)[1][1:], drawn[1:])


@pytest.mark.slow
def test_the_belief_does_not_know_of_it_and_the_plan_is_the_same() -> None:
    problem, elsewhere = load_problem(LIGHT), load_problem(LIGHT, {"start.true": {"x": 2.5, "y": 0.0}})
    plan = solve(elsewhere, advise=False)
    np.testing.assert_array_equal(plan.trajectory.inputs, solve(problem, advise=False).trajectory.inputs)
    statistics = run_trials(elsewhere, plan, trials=10)
    assert statistics.successes >= 8
    assert {row.extra["true_x"][0] for row in (result.recording for result in statistics.results)} == {"2.5"}


def test_a_plan_file_keeps_it(tmp_path: Path) -> None:
    problem = load_problem(LIGHT, {"start.true": {"y": 0.0}})
    write_plan(solve(problem, advise=False), problem, tmp_path / "plan.json")
    assert load_plan(tmp_path / "plan.json").problem.start.true == ((1, 0.0),)


def test_the_command_line_adds_to_the_file() -> None:
    problem = load_problem(LIGHT, {"start.true": {"x": 1.0, "y": 1.0}})
    runs = execute(PlanningResult(solve(problem), problem), start=starts_of(problem, ["y=0.5"]))
    assert runs.planned.problem.start.true == ((0, 1.0), (1, 0.5))


@pytest.mark.parametrize(
    ("entry", "words"),
    [("z=1", "no coordinate 'z'"), ("x", "found ''"), ("x=nan", "found 'nan'"), ("x=1e99", "expected a number")],
)
def test_other_entries_are_refused(entry: str, words: str) -> None:
    with pytest.raises(InputError, match="--start") as refused:
        starts_of(load_problem(LIGHT), [entry])
    assert words in str(refused.value)


def test_a_start_that_no_mode_allows_is_refused() -> None:
    problem = load_problem(PROBLEMS / "drawer_open.yaml")
    beyond = replace(problem, start=replace(problem.start, true=((0, 9.0),)))
    with pytest.raises(InputError, match="the true start"):
        sample_start(beyond.automaton, beyond.start, np.random.default_rng(0))


def test_a_start_in_another_mode_is_in_that_mode() -> None:
    problem = load_problem(PROBLEMS / "walled_domain.yaml")
    names = problem.automaton.mode_names
    seen = set()
    for x in np.linspace(-3.0, 3.0, 25):
        moved = replace(problem, start=replace(problem.start, true=((0, float(x)),)))
        try:
            mode, state = sample_start(moved.automaton, moved.start, np.random.default_rng(0))
        except InputError:
            continue
        assert mode in names
        assert problem.automaton.mode(mode).invariant.margins(state, np.zeros(problem.automaton.m)).min() >= -1e-6
        seen.add(mode)
    assert seen
