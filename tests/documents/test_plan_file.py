"""Plan files: what is written reads back, and what was changed or damaged afterwards is told."""

from __future__ import annotations

import hashlib
import itertools
import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from any_automaton import automata
from attempts import attempt, told
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.documents.plan import (
    StoredPlan,
    load_plan,
    plan_text,
    require_executable,
    timings_path,
    write_plan,
    write_timings,
)
from micah_plan.errors import InputError
from micah_plan.task.goal import Goal
from micah_plan.task.plan import Candidate, Finding, Plan, Trajectory
from micah_plan.task.problem import Problem
from micah_plan.task.settings import PlannerSettings
from micah_plan.task.start import Start

WHERE = ("revolute", 3, "x", 0.1, 0.2, 0.3, "m")


def covariances_in(random: np.random.Generator, knots: int, n: int) -> NDArray[np.float64]:
    drawn = random.normal(size=(knots, n, n))
    return drawn @ drawn.swapaxes(1, 2) + np.eye(n)


def trajectory_in(modes: tuple[str, ...], n: int, m: int) -> Trajectory:
    random, knots = np.random.default_rng(0), len(modes)
    return Trajectory(
        modes=modes,
        means=random.normal(size=(knots, n)),
        factors=np.linalg.cholesky(covariances_in(random, knots, n)),
        inputs=random.normal(size=(knots - 1, m)),
        gains=random.normal(size=(knots - 1, m, n)),
        is_transition=np.array([a != b for a, b in itertools.pairwise(modes)], dtype=bool),
    )


def door_trajectory() -> Trajectory:
    """One step of the door, and the transition at its end."""
    drawn = trajectory_in(("revolute", "revolute", "rigid"), 1, 1)
    means, factors = np.array([[1.17], [1.21], [1.2]]), np.array([[[0.03]], [[0.02]], [[0.004]]])
    return replace(drawn, means=means, factors=factors, inputs=np.array([[0.04], [0.0]]))


@pytest.fixture
def problem(door: HybridAutomaton) -> Problem:
    return Problem(
        door,
        Start((0.1,), (0.03,)),
        Goal(((0, 1.2, 0.03),), ("rigid",)),
        PlannerSettings(max_step=(0.05,), confidence=0.9),
        {"mass": 1.5},
        "some/where/p.yaml",
        {"problem": "ab" * 32, "model": "cd" * 32},
    )


@pytest.fixture
def plan() -> Plan:
    return Plan(
        "solved",
        "It works.",
        door_trajectory(),
        (Candidate(("revolute", "rigid"), 1.5, 0.25, "optimal"), Candidate(("revolute",), 2.0, None, "no")),
        0.25,
        0.0,
        0.004,
        0.985,
        200,
        7,
        {"total": 1.25, "search": 0.5},
        (0.957, 0.995),
        (
            Finding("optimisation", "too_little_room", "too narrow", "widen it", ("revolute",), *WHERE),
            Finding("search", "not_connected", "nothing connects", "look again"),
        ),
        warnings=("It leaves out the wind.",),
    )


def rewrite(path: Path, data: dict) -> None:
    """Write a plan whose digest is right, as somebody who knows how it is made could."""
    content = {key: value for key, value in data.items() if key != "digest"}
    digest = hashlib.sha256(json.dumps(content, separators=(",", ":")).encode()).hexdigest()
    path.write_text(json.dumps({**content, "digest": digest}))


def assert_same(stored: StoredPlan, plan: Plan, problem: Problem) -> None:
    for item in fields(Plan):
        if item.name not in ("trajectory", "timings"):
            assert getattr(stored.plan, item.name) == getattr(plan, item.name)
    assert (stored.plan.trajectory is None) == (plan.trajectory is None)
    if plan.trajectory is not None and stored.plan.trajectory is not None:
        for item in fields(Trajectory):
            np.testing.assert_array_equal(
                getattr(stored.plan.trajectory, item.name), getattr(plan.trajectory, item.name)
            )
    assert replace(stored.problem, source="") == replace(problem, source="")


def test_a_plan_reads_back_with_its_problem(plan: Plan, problem: Problem, tmp_path: Path) -> None:
    write_plan(plan, problem, tmp_path / "plan.json")
    stored = load_plan(tmp_path / "plan.json")
    assert_same(stored, plan, problem)
    assert stored.problem.source == "p.yaml"
    assert stored.automaton == problem.automaton
    assert require_executable(stored) is stored.plan.trajectory
    assert plan_text(stored.plan, stored.problem) == (tmp_path / "plan.json").read_text()


@pytest.mark.slow
@settings(max_examples=20, suppress_health_check=list(HealthCheck))
@given(automaton=automata(), knots=st.integers(1, 4), data=st.data())
def test_plans_of_any_automaton_read_back(
    automaton: HybridAutomaton, knots: int, data: st.DataObject, tmp_path: Path
) -> None:
    n, m = automaton.n, automaton.m
    names = [mode.name for mode in automaton.modes]
    modes = tuple(data.draw(st.lists(st.sampled_from(names), min_size=knots, max_size=knots)))
    problem = Problem(automaton, Start((0.0,) * n, (0.1,) * n, names[0]), Goal(((n - 1, 1e3, 0.1),)))
    plan = Plan("not_verified", "Maybe.", trajectory_in(modes, n, m), success_probability=0.5, verification_trials=2)
    write_plan(plan, problem, tmp_path / "plan.json")
    assert_same(load_plan(tmp_path / "plan.json"), plan, problem)


def test_times_are_next_to_the_plan_and_not_in_it(plan: Plan, problem: Problem, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    write_plan(plan, problem, path)
    write_timings(plan, path)
    assert timings_path(path) == tmp_path / "plan.timings.json"
    assert json.loads((tmp_path / "plan.timings.json").read_text()) == {"total": 1.25, "search": 0.5}
    write_timings(plan, path)  # its own times are replaced
    (tmp_path / "mine.timings.json").write_text('{"total": "all I have"}')
    with pytest.raises(InputError, match=r"mine\.timings\.json: would be replaced by the times of the plan"):
        write_timings(plan, tmp_path / "mine.json")
    assert (tmp_path / "mine.timings.json").read_text() == '{"total": "all I have"}'
    slower = replace(plan, timings={"total": 99.0})
    assert plan_text(slower, problem) == plan_text(plan, problem) == path.read_text()


def test_the_folder_of_the_problem_file_does_not_matter(plan: Plan, problem: Problem) -> None:
    assert plan_text(plan, replace(problem, source="/elsewhere/p.yaml")) == plan_text(plan, problem)


def test_a_plan_of_a_version_that_knew_no_interval_is_read(plan: Plan, problem: Problem, tmp_path: Path) -> None:
    data = json.loads(plan_text(plan, problem))
    del data["success_interval"], data["findings"], data["digest"]
    digest = hashlib.sha256(json.dumps(data, separators=(",", ":")).encode()).hexdigest()
    (tmp_path / "old.json").write_text(json.dumps({**data, "digest": digest}))
    assert_same(load_plan(tmp_path / "old.json"), replace(plan, success_interval=None, findings=()), problem)


def test_a_plan_of_a_version_that_called_findings_obstacles_is_read(
    plan: Plan, problem: Problem, tmp_path: Path
) -> None:
    found = replace(plan, findings=(Finding("search", "not_connected", "there is no way", "make one"),))
    data = json.loads(plan_text(found, problem))
    data["obstacles"] = data.pop("findings")
    del data["digest"]
    digest = hashlib.sha256(json.dumps(data, separators=(",", ":")).encode()).hexdigest()
    (tmp_path / "old.json").write_text(json.dumps({**data, "digest": digest}))
    assert load_plan(tmp_path / "old.json").plan.findings == found.findings


@pytest.mark.parametrize("outcome", ["no_plan", "not_verified"])
def test_only_a_solved_plan_is_executable(plan: Plan, problem: Problem, tmp_path: Path, outcome: str) -> None:
    failed = replace(plan, outcome=outcome, reason="the corridor is too narrow")
    failed = replace(failed, trajectory=None) if outcome == "no_plan" else failed
    write_plan(failed, problem, tmp_path / "plan.json")
    stored = load_plan(tmp_path / "plan.json")
    assert stored.plan.outcome == outcome
    line = told(require_executable, stored)
    assert f"plan has outcome {outcome}: the corridor is too narrow; only a solved plan can be executed" in line


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"seed": 7', '"seed": 8'),
        ('"outcome": "solved"', '"outcome": "not_verified"'),
        ("0.985", "0.999"),
        ('"tolerance": 0.03', '"tolerance": 0.3'),
        ("door < 1.2", "door < 1.3"),
        ('"mass": 1.5', '"mass": NaN'),
    ],
)
def test_an_edited_plan_is_reported(plan: Plan, problem: Problem, tmp_path: Path, old: str, new: str) -> None:
    text = plan_text(plan, problem)
    assert old in text
    (tmp_path / "plan.json").write_text(text.replace(old, new, 1))
    line = told(load_plan, tmp_path / "plan.json")
    assert "key 'digest': the content does not match its digest" in line
    assert "solve the problem again" in line


def test_formatting_is_not_content(plan: Plan, problem: Problem, tmp_path: Path) -> None:
    (tmp_path / "plan.json").write_text(json.dumps(json.loads(plan_text(plan, problem)), indent=4))
    assert_same(load_plan(tmp_path / "plan.json"), plan, problem)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "not valid JSON, damaged or cut short"),
        (b"\xff\xfe{}", "found bytes that are no text"),
        (
            b"[1, 2]",
            "expected a plan, found a list of 2; a plan file is a mapping of keys to values and says 'format: ",
        ),
        (b"{}", "missing key 'format'; a plan file says 'format: micah-plan/plan/1'"),
        (b'{"format": "micah-plan/model/1"}', "expected a plan file, found a model file"),
        (b'{"format": "micah-plan/plan/9"}', "expected micah-plan/plan/1, found 'micah-plan/plan/9'"),
        (b'{"format": "micah-plan/plan/1"}', "does not match its digest"),
        (b"[" * 100_000, "not a plan: nested too deep"),
        (b'{"a": ' * 60 + b"1" + b"}" * 60, "not a plan: nested too deep"),
        (b'{"a": ' + b"9" * 5000 + b"}", "a number too long"),
    ],
)
def test_what_is_no_plan_is_one_line(tmp_path: Path, content: bytes, expected: str) -> None:
    (tmp_path / "plan.json").write_bytes(content)
    line = told(load_plan, tmp_path / "plan.json")
    assert line.startswith(f"{tmp_path}/plan.json")
    assert expected in line


@pytest.mark.slow
@settings(max_examples=60)
@given(data=st.data())
def test_a_damaged_plan_is_never_read_as_another(
    plan: Plan, problem: Problem, tmp_path: Path, data: st.DataObject
) -> None:
    content = plan_text(plan, problem).encode()
    start = data.draw(st.integers(0, len(content) - 1))
    end = data.draw(st.integers(start, len(content)))
    piece = data.draw(st.binary(max_size=4) | st.text('0123456789.e-+[]{}",: ', max_size=4).map(str.encode))
    (tmp_path / "plan.json").write_bytes(content[:start] + piece + content[end:])
    result = attempt(load_plan, tmp_path / "plan.json")
    if isinstance(result, StoredPlan):
        assert_same(result, plan, problem)
    else:
        assert len(result.splitlines()) == 1


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"means": np.zeros((2, 1))}, "key 'trajectory.means': expected shape (3, 1), found (2, 1)"),
        ({"gains": np.zeros((2, 1, 2))}, "key 'trajectory.gains': expected shape (2, 1, 1), found (2, 1, 2)"),
        ({"modes": ("revolute", "open", "rigid")}, "key 'trajectory.modes.1': unknown mode 'open'"),
        ({"inputs": np.array([[np.nan], [0.0]])}, "plan.trajectory.inputs.0.0 is not finite"),
    ],
)
def test_what_does_not_agree_is_not_written(plan: Plan, problem: Problem, change: dict, expected: str) -> None:
    assert plan.trajectory is not None
    assert expected in told(plan_text, replace(plan, trajectory=replace(plan.trajectory, **change)), problem)


def test_outcome_and_trajectory_must_agree(plan: Plan, problem: Problem) -> None:
    assert "outcome solved with no trajectory" in told(plan_text, replace(plan, trajectory=None), problem)
    assert "outcome no_plan with a trajectory" in told(plan_text, replace(plan, outcome="no_plan"), problem)


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        (
            "success_probability",
            0.0,
            "key 'success_interval': expected an interval that holds the share 0, found 0.957",
        ),
        ("success_probability", None, "key 'success_probability': expected the share of 200 roll-outs, found none"),
        ("success_probability", 7.0, "key 'success_probability': expected a number <= 1, found 7"),
        ("success_interval", [0.995, 0.957], "key 'success_interval': expected an interval that holds the share 0.985"),
        ("outcome", "no_plan", "key 'trajectory': outcome no_plan with a trajectory"),
        ("mode_sequence", ["rigid"], "key 'mode_sequence': does not agree with the trajectory's modes"),
    ],
)
def test_an_inconsistent_plan_is_reported_with_any_digest(
    plan: Plan, problem: Problem, tmp_path: Path, key: str, value: object, expected: str
) -> None:
    rewrite(tmp_path / "plan.json", json.loads(plan_text(plan, problem)) | {key: value})
    assert expected in told(load_plan, tmp_path / "plan.json")


def test_a_plan_is_solved_only_if_its_roll_outs_report_it(plan: Plan, problem: Problem, tmp_path: Path) -> None:
    data = json.loads(plan_text(plan, problem))
    rewrite(tmp_path / "plan.json", data | {"success_probability": 0.0, "success_interval": [0.0, 0.02]})
    line = told(load_plan, tmp_path / "plan.json")
    assert (
        "outcome solved, but its share of successes 0 is less than the 0.858 that the confidence 0.9 requires" in line
    )
    rewrite(tmp_path / "plan.json", data | {"success_probability": 0.86, "success_interval": None})
    assert load_plan(tmp_path / "plan.json").plan.success_probability == 0.86


@pytest.mark.parametrize(
    ("place", "value", "expected"),
    [
        (
            ("problem", "goal", "target", "door", "value"),
            1.0,
            "key 'goal_error': expected the distance 0.2 of the last",
        ),
        (("problem", "goal", "modes"), ["revolute"], "its last knot, in mode 'rigid', is not in the goal"),
        (("problem", "planner", "max_step", "door"), 0.01, "knot 0: an input of 0.04 is more than the largest step"),
        (("model", "modes", "revolute", "step", "door"), "0.5*input door", "step in mode 'revolute' does not lead to"),
        (
            ("model", "transitions", 0, "target"),
            "revolute",
            "knot 1: no transition of the model leads from 'revolute' to",
        ),
        (("trajectory", "is_transition"), [False, False], "from 'revolute' to 'rigid' without a transition"),
        (("trajectory", "means", 0, 0), 0.9, "knot 0: the model's step in mode 'revolute' does not lead to the next"),
    ],
)
def test_a_solved_plan_agrees_with_its_problem_and_model(
    plan: Plan, problem: Problem, tmp_path: Path, place: tuple[str | int, ...], value: object, expected: str
) -> None:
    data = json.loads(plan_text(plan, problem))
    *path, last = place
    inner = data
    for key in path:
        inner = inner[key]
    inner[last] = value
    rewrite(tmp_path / "plan.json", data)
    line = told(load_plan, tmp_path / "plan.json")
    assert expected in line
    assert line.endswith("solve the problem again")


def test_numbers_of_a_trajectory_are_those_of_something_physical(plan: Plan, problem: Problem, tmp_path: Path) -> None:
    data = json.loads(plan_text(plan, problem))
    data["trajectory"]["means"][1][0] = 1e300
    rewrite(tmp_path / "plan.json", data)
    line = told(load_plan, tmp_path / "plan.json")
    assert "key 'trajectory.means': expected numbers of at most 1e+09 in size, found 1e+300" in line


def test_a_key_that_is_there_twice_is_reported(plan: Plan, problem: Problem, tmp_path: Path) -> None:
    text = plan_text(plan, problem)
    (tmp_path / "plan.json").write_text(text.replace('"seed": 7', '"seed": 8, "seed": 7'))
    assert told(load_plan, tmp_path / "plan.json").endswith("the key 'seed' is given twice; solve the problem again")


def test_a_goal_that_the_file_cannot_hold_is_not_written(plan: Plan, problem: Problem) -> None:
    twice = replace(problem, goal=Goal(((0, 1.2, 0.03), (0, 1.1, 0.2))))
    assert "cannot be written exactly" in told(plan_text, replace(plan, outcome="not_verified"), twice)


def test_a_folder_that_does_not_exist(plan: Plan, problem: Problem, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be written"):
        write_plan(plan, problem, tmp_path / "none" / "plan.json")
    with pytest.raises(InputError, match="the file does not exist"):
        load_plan(tmp_path / "none" / "plan.json")
