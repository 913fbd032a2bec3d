"""Problem files: what they say becomes the problem, and every mistake is one line with file, line, key and remedy."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import pytest
from attempts import attempt, told
from hypothesis import given, settings
from hypothesis import strategies as st

from micah_plan.automaton.hybrid import HybridAutomaton, Noise
from micah_plan.automaton.region import Region, above, box
from micah_plan.documents.kind import kind_of
from micah_plan.documents.model import dump_model
from micah_plan.documents.planner import PlannerDocument, PlantDocument
from micah_plan.documents.problem import load_problem
from micah_plan.errors import InputError
from micah_plan.execution.mujoco.parameters import defaults
from micah_plan.task.goal import Goal
from micah_plan.task.problem import Problem
from micah_plan.task.settings import PlannerSettings
from micah_plan.task.start import Start, start_mode

TEXT = """\
format: micah-plan/problem/1
model: models/door.yaml      # relative to this file
start:
  mean: {door: 0.0}
  std: {door: 0.03}
  mode: revolute
goal:
  target:
    door: {value: 1.2, tolerance: 0.03}
  modes: [rigid]
noise:
  process_std: {door: 0.005}
confidence: 0.9
planner:
  max_step: {door: 0.05}
  candidates: 2
plant: {mass: 2.0, friction: 1}
"""


@pytest.fixture
def folder(door: HybridAutomaton, tmp_path: Path) -> Path:
    (tmp_path / "models").mkdir()
    dump_model(door, tmp_path / "models" / "door.yaml")
    (tmp_path / "p.yaml").write_text(TEXT)
    return tmp_path


def message(folder: Path, old: str, new: str) -> str:
    assert old in TEXT
    (folder / "p.yaml").write_text(TEXT.replace(old, new, 1))
    return told(load_problem, folder / "p.yaml").removeprefix(f"{folder}/")


def test_the_problem_is_what_the_file_says(folder: Path, door: HybridAutomaton) -> None:
    problem = load_problem(folder / "p.yaml")
    assert problem.automaton == replace(door, noise=Noise((0.005,), (0.02,)))
    assert problem.start == Start((0.0,), (0.03,), "revolute")
    assert problem.goal == Goal(((0, 1.2, 0.03),), ("rigid",))
    assert problem.settings == PlannerSettings(confidence=0.9, max_step=(0.05,), candidates=2)
    assert problem.plant == {"mass": 2.0, "friction": 1.0}
    assert problem.source == str(folder / "p.yaml")
    assert set(problem.digests) == {"problem", "model"}
    assert all(len(digest) == 64 for digest in problem.digests.values())


def test_optional_blocks_may_be_left_out(folder: Path, door: HybridAutomaton) -> None:
    text = TEXT[: TEXT.index("noise:")].replace("  mode: revolute\n", "").replace("  modes: [rigid]\n", "")
    (folder / "p.yaml").write_text(text)
    problem = load_problem(folder / "p.yaml")
    assert problem.automaton == door
    assert problem.settings == PlannerSettings()
    assert (problem.start.mode, problem.goal.modes, problem.plant) == (None, (), {})


def test_digests_follow_the_content(folder: Path) -> None:
    before = load_problem(folder / "p.yaml").digests
    (folder / "p.yaml").write_text(TEXT + "# a remark\n")
    after = load_problem(folder / "p.yaml").digests
    assert before["model"] == after["model"]
    assert before["problem"] != after["problem"]


def test_settings_and_plant_parameters_are_all_there() -> None:
    assert {f.name for f in fields(PlannerSettings)} - {"confidence"} == set(PlannerDocument.model_fields) - {"method"}
    assert {*defaults(held=False), *defaults(held=True)} == set(PlantDocument.model_fields)
    assert PlannerSettings(**PlannerDocument().model_dump(exclude={"method"})) == PlannerSettings()


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "goal:",
            "gaol:",
            "p.yaml, line 7, column 1, key 'gaol': unknown key 'gaol' (and 1 more error); did you mean 'goal'?",
        ),
        ("door.yaml", "dor.yaml", "models/dor.yaml: the file does not exist; check the path"),
        ("models/door.yaml", "models", "expected a file, found a directory"),
        ("models/door.yaml", "p.yaml", "key 'format': expected a model file, found a problem file"),
        ("models/door.yaml", "3", "line 2, column 1, key 'model': expected text, found 3"),
        ("problem/1", "model/1", "line 1, column 1, key 'format': expected a problem file, found a model file"),
        ("problem/1", "problem/7", "expected micah-plan/problem/1, found 'micah-plan/problem/7'"),
        (
            "value: 1.2",
            "value: 2.5",
            "p.yaml, line 9, column 12, key 'goal.target.door.value': expected a value that mode rigid can reach, "
            "1.2 rad, found 2.5; the nearest possible value is 1.2 rad",
        ),
        (
            "door: {value",
            "dor: {value",
            "line 9, column 5, key 'goal.target.dor': unknown coordinate 'dor'; did you mean 'door'?",
        ),
        ("[rigid]", "[rigd]", "line 10, column 11, key 'goal.modes.0': unknown mode 'rigd'; did you mean 'rigid'?"),
        ("tolerance: 0.03", "tolerance: 0", "key 'goal.target.door.tolerance': expected a number > 0, found 0"),
        (
            "std: {door: 0.03}",
            "std: {door: 0.0}",
            "line 5, column 9, key 'start.std.door': expected a number > 0, found 0.0",
        ),
        ("std: {door: 0.03}", "std: {door: yes}", "key 'start.std.door': expected a number, found 'yes'"),
        ("std: {door: 0.03}", "std: {door: true}", "key 'start.std.door': expected a number, found True"),
        ("mean: {door: 0.0}", "mean: {}", "line 4, column 3, key 'start.mean': missing value of coordinate 'door'"),
        ("mean: {door: 0.0}", "mean: {door: 0, lid: 1}", "unknown coordinate 'lid'; choose one of door"),
        ("mean: {door: 0.0}", "mean: {door: 1e-3x}", "expected a number, found '1e-3x'"),
        (
            "mode: revolute",
            "mode: revolt",
            "line 6, column 3, key 'start.mode': unknown mode 'revolt'; did you mean 'revolute'?",
        ),
        (
            "mode: revolute",
            "mode: rigid",
            "line 6, column 3, key 'start.mode': mode 'rigid' does not allow the start door = 0 rad; "
            "start there in revolute",
        ),
        (
            "confidence: 0.9",
            "confidence: 0.5",
            "line 13, column 1, key 'confidence': expected a number > 0.5, found 0.5",
        ),
        ("confidence: 0.9", "confidence: 1", "line 13, column 1, key 'confidence': expected a number < 1, found 1"),
        ("max_step: {door", "max_step: {dor", "line 15, column 14, key 'planner.max_step.dor': unknown input 'dor'"),
        (
            "candidates: 2",
            "candidates: 2.5",
            "line 16, column 3, key 'planner.candidates': expected an integer, found 2.5",
        ),
        ("candidates: 2", "candidates: 0", "key 'planner.candidates': expected a number >= 1, found 0"),
        ("mass: 2.0", "mas: 2.0", "line 17, column 9, key 'plant.mas': unknown key 'mas'; did you mean 'mass'?"),
        ("friction: 1", "friction: -1", "key 'plant.friction': expected a number >= 0, found -1"),
        (
            "process_std: {door: 0.005}",
            "process_std: {lid: 1}",
            "key 'noise.process_std.lid': unknown coordinate 'lid'",
        ),
    ],
)
def test_a_mistake_is_one_line(folder: Path, old: str, new: str, expected: str) -> None:
    assert expected in message(folder, old, new)


def test_a_start_in_no_mode_lists_what_is_allowed(folder: Path) -> None:
    line = message(
        folder, "mean: {door: 0.0}\n  std: {door: 0.03}\n  mode: revolute", "mean: {door: -0.5}\n  std: {door: 0.1}"
    )
    assert line == (
        "p.yaml, line 4, column 3, key 'start.mean': the start door = -0.5 rad lies in no mode's invariant; "
        "allowed: revolute (door >= 0, door < 1.2); rigid (door = 1.2, door >= 1.2)"
    )


def test_a_start_outside_init_is_refused(folder: Path, door: HybridAutomaton) -> None:
    limited = replace(door, init=(("revolute", Region((above(0, 0.5, 1, 1, name="door"),))),))
    dump_model(limited, folder / "models" / "door.yaml")
    assert "allowed: revolute (door >= 0, door < 1.2, door >= 0.5)" in told(load_problem, folder / "p.yaml")


@pytest.mark.slow
def test_a_start_is_refused_exactly_where_the_planner_finds_no_mode(folder: Path, door: HybridAutomaton) -> None:
    limited = replace(door, init=(("revolute", Region((above(0, 0.5, 1, 1, name="door"),))),))
    refused, accepted = set(), set()
    for model in (door, limited):
        dump_model(model, folder / "models" / "door.yaml")
        for mode in (None, "revolute", "rigid"):
            for mean in (-0.5, -0.1, -0.08, 0.0, 0.4, 0.45, 0.6, 1.1, 1.2, 1.28, 1.3):
                named = "" if mode is None else f"\n  mode: {mode}"
                text = TEXT.replace("mean: {door: 0.0}", f"mean: {{door: {mean}}}").replace("\n  mode: revolute", named)
                (folder / "p.yaml").write_text(text)
                found = attempt(load_problem, folder / "p.yaml")
                planned = start_mode(model, Start((mean,), (0.03,), mode))[0]
                assert isinstance(found, Problem) == (planned is not None)
                (accepted if planned else refused).add((mode, mean, bool(model.init)))
                if not planned:
                    assert "p.yaml, line 4" in found or "p.yaml, line 6" in found
    assert (None, -0.08, False) in accepted
    assert (None, 0.4, False) in accepted
    assert (None, 0.4, True) in refused
    assert (None, 0.45, True) in accepted
    assert ("rigid", 1.2, False) in accepted
    assert ("rigid", 1.2, True) in refused


LIMIT = 0.291520903568


def test_limits_copied_from_messages_are_accepted(folder: Path, door: HybridAutomaton) -> None:
    swings = replace(door.modes[0], invariant=box([0.0], [LIMIT], 1, ["door"]))
    dump_model(replace(door, modes=(swings,), edges=()), folder / "models" / "door.yaml")
    text = TEXT.replace("  modes: [rigid]\n", "").replace("tolerance: 0.03", "tolerance: 1e-9")
    text = text.replace("std: {door: 0.03}", "std: {door: 1e-9}")

    def load(start: str, goal: str) -> object:
        written = text.replace("mean: {door: 0.0}", f"mean: {{door: {start}}}").replace("value: 1.2", f"value: {goal}")
        (folder / "p.yaml").write_text(written)
        return attempt(load_problem, folder / "p.yaml")

    assert f"allowed: revolute (door >= 0, door <= {LIMIT})" in load("0.4", "0.1")
    line = load("0.1", "0.4")
    assert f"can reach, 0 to {LIMIT} rad, found 0.4; the nearest possible value is {LIMIT} rad" in line
    for value in (str(LIMIT), "0.291521"):
        assert isinstance(load(value, value), Problem)
    assert isinstance(load("0.29153", "0.1"), str)
    assert isinstance(load("0.1", "0.29153"), str)


def test_an_empty_goal_is_refused(folder: Path) -> None:
    line = message(folder, "target:\n    door: {value: 1.2, tolerance: 0.03}\n  modes: [rigid]", "modes: []")
    assert "the goal is empty; give a target, modes to end in, or both" in line


def test_a_goal_within_tolerance_of_the_range_is_accepted(folder: Path) -> None:
    (folder / "p.yaml").write_text(TEXT.replace("value: 1.2", "value: 1.22"))
    assert load_problem(folder / "p.yaml").goal.target == ((0, 1.22, 0.03),)


def test_ranges_join_what_modes_allow(door: HybridAutomaton) -> None:
    assert door.ranges(0) == [(0.0, 1.2)]
    assert door.ranges(0, door.modes[1:]) == [(1.2, 1.2)]
    free = replace(door.modes[1], pins=(), invariant=Region((above(0, 2.0, 1, 1, name="door"),)))
    assert door.ranges(0, (free, door.modes[0])) == [(0.0, 1.2), (2.0, float("inf"))]
    assert door.ranges(0, (replace(free, invariant=Region()),)) == [(-float("inf"), float("inf"))]


def test_overrides_replace_values(folder: Path) -> None:
    changes = {"goal.target.door.value": 0.6, "goal.modes": [], "planner.samples_per_mode": 7, "confidence": 0.8}
    problem = load_problem(folder / "p.yaml", changes)
    assert problem.goal == Goal(((0, 0.6, 0.03),), ())
    assert (problem.settings.samples_per_mode, problem.settings.confidence) == (7, 0.8)
    assert "key 'planner.sample': unknown key" in told(load_problem, folder / "p.yaml", {"planner.sample": 1})
    assert "'confidence' has no keys" in told(load_problem, folder / "p.yaml", {"confidence.x": 1})


def test_a_problem_that_does_not_exist(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.yaml: the file does not exist"):
        load_problem(tmp_path / "none.yaml")


@settings(max_examples=100)
@given(data=st.data())
def test_a_damaged_file_raises_only_input_errors(folder: Path, data: st.DataObject) -> None:
    content = TEXT.encode()
    start = data.draw(st.integers(0, len(content)))
    end = data.draw(st.integers(start, min(len(content), start + 30)))
    piece = data.draw(st.binary(max_size=6) | st.text(":-[]{}#&*!|>'\"%@`\n ,?0e./", max_size=6).map(str.encode))
    (folder / "q.yaml").write_bytes(content[:start] + piece + content[end:])
    result = attempt(load_problem, folder / "q.yaml")
    assert isinstance(result, Problem) or len(result.splitlines()) == 1


def test_shipped_problems_load(repository: Path) -> None:
    for path in sorted((repository / "problems").glob("*.yaml")):
        if kind_of(path) == "scene":
            continue
        assert load_problem(path).automaton.modes
