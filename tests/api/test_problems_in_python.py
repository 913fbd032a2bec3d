"""Problems without a file: by the names of coordinates and modes, and as data with the keys of a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from micah_plan import HybridAutomaton, InputError, execute, load, show, solve
from micah_plan.documents.plan import load_plan
from micah_plan.task.problem import Problem

FEW = {"verification_trials": 100}


@pytest.fixture(scope="module")
def microwave(repository: Path) -> HybridAutomaton:
    model = load(repository / "models" / "microwave.yaml")
    assert isinstance(model, HybridAutomaton)
    return model


@pytest.fixture(scope="module")
def close(repository: Path) -> Problem:
    problem = load(repository / "problems" / "microwave_close.yaml")
    assert isinstance(problem, Problem)
    return problem


def test_a_problem_by_name_is_that_of_the_file(microwave: HybridAutomaton, close: Problem, tmp_path: Path) -> None:
    found = solve(
        microwave,
        start={"door": (0.4, 0.05)},
        goal={"door": (1.2, 0.03)},
        modes=["rigid"],
        noise={"process_std": {"door": 0.005}, "observation_std": {"door": 0.01}},
        max_step={"door": 0.1},
        **FEW,
    )
    assert found.success
    assert (found.problem.start, found.problem.goal) == (close.start, close.goal)
    assert found.problem.automaton.noise == close.automaton.noise
    found.save(tmp_path / "plan.json")
    assert load_plan(tmp_path / "plan.json").problem.goal == close.goal
    assert execute(found, trials=3).successes == 3


def test_what_is_not_named_stays(close: Problem) -> None:
    assert close.replace() == close
    again = close.replace(start={"door": 0.2})
    assert (again.start.mean, again.start.std) == ((0.2,), close.start.std)
    assert again.goal == close.goal
    # Another target asks for no mode, and a value alone keeps the tolerance.
    assert close.replace(goal={"door": 0.7}).goal.target == ((0, 0.7, 0.03),)
    assert close.replace(goal={"door": 0.7}).goal.modes == ()
    assert close.replace(modes="rigid").goal == close.goal
    assert close.replace(goal={}, modes=["rigid"]).goal.target == ()
    assert close.replace(start_mode="revolute").start.mode == "revolute"
    quiet = close.replace(noise={"observation_std": {"door": 0.002}}).automaton.noise
    assert quiet.observation_std == (0.002,)
    assert quiet.process_std == close.automaton.noise.process_std


def test_an_object_that_is_held_has_not_arrived_where_it_collides(repository: Path) -> None:
    problem = load(repository / "problems" / "stapler_in_shaft.yaml")
    assert isinstance(problem, Problem)
    names = problem.automaton.mode_names
    assert "collided" in names
    index = problem.goal.target[0][0]
    name = problem.automaton.coordinate_names[index]
    assert "collided" not in problem.replace(goal={name: 0.1}).goal.modes
    assert problem.replace(goal={name: 0.1}).goal.modes


def test_coordinates_that_follow_start_where_they_follow() -> None:
    tied = _scissors()
    problem = solve(tied, advise=False, time_limit_s=0.01).problem
    for start in (0.1, 0.25):
        followed = problem.replace(start={"left": start}).start.mean
        assert followed[1] == pytest.approx(-start)
    assert problem.replace(start={"left": 0.1, "right": 0.3}).start.mean[1] == 0.3


def _scissors() -> HybridAutomaton:
    """Two blades of which one turns as far as the other, the other way."""
    turning = {"kind": "revolute", "axis": [0, 0, 1], "center": [0, 0, 0], "position": [0.1, 0, 0]}
    model = load(
        {
            "coordinates": {"left": "rad", "right": "rad"},
            "inputs": {"left": "rad"},
            "links": [
                {"parent": "base", "child": "left", "coordinate": "left"},
                {"parent": "base", "child": "right", "coordinate": "right"},
            ],
            "noise": {
                "process_std": {"left": 0.001, "right": 0.001},
                "observation_std": {"left": 0.002, "right": 0.002},
            },
            "modes": {
                "cuts": {
                    "joints": {"left": turning, "right": turning},
                    "step": {"left": "input left", "right": "-input left"},
                    "invariant": ["left >= 0", "left <= 0.5"],
                    "ties": {"right": "-left"},
                },
            },
            "transitions": [],
        }
    )
    assert isinstance(model, HybridAutomaton)
    return model


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"goal": {"dor": 0.7}}, "goal: no coordinate 'dor'; did you mean 'door'?"),
        ({"goal": {"door": 3.0}}, "the nearest possible value is 1.20609 rad"),
        ({"goal": {"door": "shut"}}, "goal of door: expected a number or (value, tolerance), found 'shut'"),
        ({"goal": {"door": (0.7, 0.0)}}, "a tolerance of 0 is never met; give a larger one"),
        ({"goal": {"door": (0.7, 0.1, 0.2)}}, "expected a number or (value, tolerance)"),
        ({"goal": 0.7}, "goal: expected values by name, found 0.7; give a dict"),
        ({"goal": {}}, "the goal is empty; give a target, modes to end in, or both"),
        ({"start": {"door": (0.4, -0.1)}}, "start of door: expected a number or (value, std)"),
        ({"start": {"door": float("nan")}}, "start of door: expected a number"),
        ({"start": {"door": True}}, "start of door: expected a number"),
        ({"start": {"door": 5.0}}, "the start door = 5 rad lies in no mode's invariant; allowed: revolute"),
        ({"start_mode": "rigid"}, "mode 'rigid' does not allow the start door = 0.4 rad; start there in revolute"),
        ({"start_mode": "open"}, "start mode: no mode 'open'; choose one of revolute, rigid"),
        ({"modes": ["rigit"]}, "goal modes: no mode 'rigit'; did you mean 'rigid'?"),
        ({"noise": {"process": {"door": 0.1}}}, "noise has no 'process'; "),
        ({"noise": {"process_std": {"door": -1}}}, "process_std of door: expected a standard deviation, found -1"),
        ({"noise": {"process_std": 0.1}}, "noise, process_std: expected values by name, found 0.1"),
    ],
)
def test_impossible_requests_are_reported(close: Problem, changes: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as refused:
        solve(close, **changes)
    assert said in str(refused.value)


def test_a_goal_without_a_tolerance(close: Problem) -> None:
    bare = close.replace(goal={}, modes="rigid")
    with pytest.raises(InputError, match=r"door has no tolerance; give it, as in \{'door': \(0.7, 0.01\)\}"):
        bare.replace(goal={"door": 0.7})


def test_data_with_the_keys_of_a_problem_file(repository: Path, microwave: HybridAutomaton) -> None:
    data = {
        "start": {"mean": {"door": 0.4}, "std": {"door": 0.05}},
        "goal": {"target": {"door": {"value": 0.8, "tolerance": 0.03}}},
    }
    assert solve(data, model=microwave, **FEW).success
    problem = load({"model": str(repository / "models" / "microwave.yaml"), **data})
    assert isinstance(problem, Problem)
    assert np.isclose(problem.goal.target[0][1], 0.8)
    with pytest.raises(InputError, match=r"problem, key 'goal\.target\.dor'"):
        solve(data | {"goal": {"target": {"dor": {"value": 0.8, "tolerance": 0.03}}}}, model=microwave)
    with pytest.raises(InputError, match="missing key 'start'"):
        solve({"goal": data["goal"]}, model=microwave)
    held = yaml.safe_load((repository / "problems" / "stapler_on_books.yaml").read_text())
    held = {key: value for key, value in held.items() if key not in ("robot", "grasp")}  # files beside the problem's
    stapler = load(repository / "models" / "stapler.yaml")
    same = solve(held, model=stapler, advise=False, time_limit_s=0.01).problem
    assert same.goal == load(repository / "problems" / "stapler_on_books.yaml").goal  # type: ignore[union-attr]
    held["release"]["support"] = "shelf"  # 140 mm higher than the goal
    with pytest.raises(InputError, match=r"key 'release': goal\.target\.z: released on 'shelf', .* write 0\.4"):
        solve(held, model=stapler)
    with pytest.raises(InputError, match="missing key 'model'"):
        load(data)


@pytest.mark.parametrize("name", ["microwave_close", "stapler_on_books", "carry_tray"])
def test_a_problem_has_a_page_before_it_is_solved(repository: Path, tmp_path: Path, name: str) -> None:
    problem = load(repository / "problems" / f"{name}.yaml")
    page = show(problem, tmp_path / "page.html").text
    assert (tmp_path / "page.html").read_text(encoding="utf-8") == page
    assert "NOT SOLVED YET" in page
    assert all(
        f"{problem.automaton.coordinate_names[index]} " in page.split('class="task">')[1].split("</p>")[0]
        for index, _, _ in problem.goal.target
    )
    with pytest.raises(InputError, match="there is no page of a Goal; give a recording, model, problem or result"):
        show(problem.goal, tmp_path / "other.html")
