"""The functions that users import: paths or values in, results out that say in a few lines what came out."""

from __future__ import annotations

import pickle
import re
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from extras import requires

import micah_plan
from micah_plan import (
    HybridAutomaton,
    InputError,
    Recording,
    calibrate,
    execute,
    learn,
    load,
    predict,
    save,
    show,
    solve,
)
from micah_plan.api.execution import RunsResult
from micah_plan.api.learning import LearningResult
from micah_plan.api.planning import PlanningResult
from micah_plan.api.result import Page
from micah_plan.documents.model import load_model, model_data
from micah_plan.learning.settings import LearnSettings
from micah_plan.task.problem import Problem


@pytest.fixture(scope="module")
def learned(repository: Path) -> LearningResult:
    shapes = repository / "models" / "parts" / "microwave.yaml"
    return learn(repository / "examples" / "demonstrations" / "microwave.csv", parts=shapes)


@pytest.fixture(scope="module")
def solved(repository: Path, learned: LearningResult) -> PlanningResult:
    return solve(repository / "problems" / "microwave_close.yaml", model=learned, verification_trials=300)


@pytest.fixture(scope="module")
def runs(solved: PlanningResult) -> RunsResult:
    return execute(solved, trials=4)


def test_the_loop_in_five_lines(learned: LearningResult, solved: PlanningResult, runs: RunsResult) -> None:
    assert (learned.success, learned.outcome, learned.reason) == (True, "learned", "")
    assert (solved.success, solved.outcome, solved.mode_sequence) == (True, "solved", ("revolute", "rigid"))
    assert (runs.success, runs.outcome, runs.successes) == (True, "reached", 4)
    predicted = predict(learned, runs)
    assert (predicted.success, predicted.outcome) == (True, "noise")
    found = calibrate(learned, runs)
    assert (found.success, found.outcome) == (True, "none")
    assert found.automaton == learned.automaton


@pytest.mark.slow
def test_paths_and_values_give_the_same(
    repository: Path, tmp_path: Path, learned: LearningResult, solved: PlanningResult, runs: RunsResult
) -> None:
    file = repository / "examples" / "demonstrations" / "microwave.csv"
    again = learn(load(file), parts=load(repository / "models" / "parts" / "microwave.yaml"))
    assert again.automaton == learned.automaton
    learned.save(tmp_path / "model.yaml")
    problem = repository / "problems" / "microwave_close.yaml"
    planned = solve(str(problem), model=str(tmp_path / "model.yaml"), verification_trials=300)
    planned.save(tmp_path / "by_path.json")
    solved.save(tmp_path / "by_value.json")
    assert (tmp_path / "by_path.json").read_bytes() == (tmp_path / "by_value.json").read_bytes()
    stored = load(tmp_path / "by_path.json")
    assert isinstance(stored, PlanningResult)
    executed = execute(tmp_path / "by_path.json", trials=4)
    assert executed.recording.digest() == runs.recording.digest()
    save(runs, tmp_path / "runs.csv")
    # The ending says the format, as in `convert`.
    for ending, begin in (("urdf", "<robot"), ("sdf", "<sdf"), ("xml", "<mujoco"), ("yml", "format: ")):
        learned.save(tmp_path / f"model.{ending}")
        save(learned.automaton, tmp_path / f"again.{ending}")
        assert begin in (tmp_path / f"model.{ending}").read_text()
        assert (tmp_path / f"again.{ending}").exists()
    with pytest.raises(InputError, match=r"no model can be written to a '\.txt' file; choose one that ends in \.yaml"):
        learned.save(tmp_path / "model.txt")
    assert not (tmp_path / "model.txt").exists()
    assert predict(tmp_path / "by_path.json", tmp_path / "runs.csv").outcome == "noise"
    assert isinstance(load(problem), Problem)


def every_result(learned: LearningResult, solved: PlanningResult, runs: RunsResult) -> list[Any]:
    return [learned, solved, runs, predict(learned, runs), calibrate(learned, runs)]


@pytest.mark.slow
def test_values_and_results_print_in_a_few_lines(
    learned: LearningResult, solved: PlanningResult, runs: RunsResult
) -> None:
    values = [learned.recording, learned.automaton, solved.problem, solved.plan]
    for value in (*every_result(learned, solved, runs), *values):
        text = str(value)
        assert text == repr(value) == value.summary()
        assert len(text) < 1200
        assert 1 <= len(text.splitlines()) <= 15
        assert not re.search(r"0\.000\b", text)
        assert text.splitlines()[0].replace("&", "&amp;").replace(">", "&gt;") in value._repr_html_()


@pytest.mark.slow
def test_results_draw_and_show_themselves(
    tmp_path: Path, learned: LearningResult, solved: PlanningResult, runs: RunsResult
) -> None:
    for number, result in enumerate(every_result(learned, solved, runs)):
        assert result.plot().axes
        page = result.show(tmp_path / f"{number}.html")
        assert isinstance(page, Page)
        assert (tmp_path / f"{number}.html").read_text(encoding="utf-8") == page.text
        assert "<iframe" in page._repr_html_()
    for number, value in enumerate((learned.recording, learned.automaton)):
        assert show(value, tmp_path / f"value_{number}.html").text.startswith("<!DOCTYPE html>")


def test_settings_are_arguments(repository: Path, solved: PlanningResult) -> None:
    drawer = repository / "examples" / "demonstrations" / "drawer.csv"
    kinds = {segment.joint.kind for segment in learn(drawer, kinds=("rigid", "revolute")).graph.edges[0].segments}
    assert kinds <= {"rigid", "revolute"}
    assert learn(drawer, settings=LearnSettings(kinds=("rigid", "prismatic"))).automaton is not None
    surer = solve(solved, confidence=0.99, max_step=0.05, verification_trials=100, advise=False)
    assert surer.problem.settings.confidence == 0.99
    assert surer.problem.settings.max_step == (0.05,)
    assert surer.problem.settings.verification_trials == 100


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"confidense": 0.9}, "unknown key 'confidense'; did you mean 'confidence'"),
        ({"confidence": 1.9}, "key 'confidence': expected a number < 1, found 1.9"),
        ({"max_step": {"drawer": 0.1}}, "drawer"),
        ({"candidates": 2.5}, "expected an integer"),
    ],
)
def test_a_setting_that_is_none_is_reported(changes: dict[str, Any], message: str, solved: PlanningResult) -> None:
    with pytest.raises(InputError, match=message):
        solve(solved, **changes)


def test_an_unknown_setting_of_learning_is_reported(learned: LearningResult) -> None:
    with pytest.raises(InputError, match="unknown setting 'kind'; did you mean 'kinds'"):
        learn(learned, kind=("rigid",))


def test_no_plan_is_a_result_with_its_reason(repository: Path) -> None:
    refused = solve(repository / "problems" / "microwave_close.yaml", max_knots=2, advise=False)
    assert not refused.success
    assert refused.outcome in {"no_plan", "not_verified"}
    assert refused.reason in str(refused)
    with pytest.raises(InputError, match="only a solved plan can be executed"):
        execute(refused)


def test_runs_of_a_plan_that_is_not_verified_never_look_like_those_of_a_good_one(
    repository: Path, solved: PlanningResult
) -> None:
    doubtful = replace(solved, plan=replace(solved.plan, outcome="not_verified", reason="too few roll-outs succeed"))
    with pytest.raises(InputError, match="only a solved plan can be executed"):
        execute(doubtful)
    runs = execute(doubtful, trials=2, anyway=True)
    assert runs.successes == 2  # in truth it is a good plan
    assert not runs.success
    assert runs.outcome == "partly"
    first = str(runs).splitlines()[0]
    assert first == "this plan is not verified, and was executed anyway: too few roll-outs succeed"
    assert runs.json()["plan_outcome"] == "not_verified"
    assert "NOT VERIFIED, 2 of 2 runs reached the goal" in runs.page()
    good = execute(solved, trials=2, anyway=True)
    assert good.success
    assert "plan_outcome" not in good.json()
    with pytest.raises(InputError, match="anyway is for plans, this is an experiment"):
        execute(repository / "problems" / "experiments" / "drawer.yaml", anyway=True)


@pytest.mark.slow
@requires("sim")
def test_failed_trials_give_the_reason(solved: PlanningResult) -> None:
    stuck = execute(solved, plant="mujoco", trials=2, plant_parameters={"friction": 500.0})
    assert stuck.outcome == "missed"
    assert stuck.reason.startswith("trial 0: ")
    assert stuck.failures[1][1] in str(stuck)


def drawer_by_hand(**changes: Any) -> dict[str, Any]:
    slides = {
        "joints": {"drawer": {"kind": "prismatic", "position": [0, 0, 0], "axis": [0, 1, 0]}},
        "step": {"drawer": "input drawer"},
        "invariant": ["drawer >= 0", "drawer <= 0.3"],
    }
    ends = [("drawer < 0", 0.0), ("drawer > 0.3", 0.3)]
    data = {
        "coordinates": {"drawer": "m"},
        "inputs": {"drawer": "m"},
        "links": [{"parent": "base", "child": "drawer", "coordinate": "drawer"}],
        "noise": {"process_std": {"drawer": 0.001}, "observation_std": {"drawer": 0.002}},
        "modes": {"slides": slides},
        "transitions": [
            {"source": "slides", "target": "slides", "guard": [guard], "reset": {"drawer": end}} for guard, end in ends
        ],
    }
    return data | changes


def test_an_automaton_by_hand_is_made_of_names(repository: Path) -> None:
    made = load(drawer_by_hand())
    assert isinstance(made, HybridAutomaton)
    assert made.ranges(0) == [(0.0, 0.3)]
    shipped = load_model(repository / "models" / "drawer.yaml")
    data = model_data(shipped)
    del data["format"]
    assert load(data) == shipped


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"coordinates": {"drawer": "mm"}}, r"key 'coordinates\.drawer': expected 'rad' or 'm', found 'mm'"),
        (
            {"noise": {"process_std": {"draw": 0.1}, "observation_std": {"drawer": 0.1}}},
            "unknown coordinate 'draw'; did you mean 'drawer'",
        ),
        ({"modes": {}}, "key 'modes'"),
    ],
)
def test_a_mistake_in_it_is_reported_by_name(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        load(drawer_by_hand(**changes))


def test_other_things_are_reported_as_other_things(tmp_path: Path) -> None:
    for call, given in ((learn, 3), (solve, None), (execute, [1]), (predict, 2.0)):
        with pytest.raises(InputError, match="found '"):
            call(given, *(["x"] if call is predict else []))  # type: ignore[operator]
    with pytest.raises(InputError, match="no page of a int"):
        show(3)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="no file for a int"):
        save(3, tmp_path / "x")


def test_quaternions_that_are_no_orientations_are_reported_and_not_guessed() -> None:
    time, turned = np.linspace(0.0, 3.0, 40), np.linspace(0.0, 1.2, 40)
    position = np.stack([0.3 * np.cos(turned), 0.3 * np.sin(turned), np.zeros(40)], axis=1)
    zeros = np.zeros((40, 4))
    with pytest.raises(InputError, match=r"row 0, column 'qx': expected a unit quaternion"):
        learn(Recording(time, position, zeros))
    scalar_first = np.stack([np.cos(turned / 2), np.zeros(40), np.zeros(40), np.sin(turned / 2)], axis=1)
    found = learn(Recording(time, position, scalar_first))
    assert any("scalar first" in warning for warning in found.warnings)
    assert "scalar first" in str(found)


def test_the_package_has_functions_after_any_import() -> None:
    code = (
        "import micah_plan.learning.settings, micah_plan.api.planning; from micah_plan import learn; "
        "import micah_plan; assert callable(learn) and micah_plan.learn is learn; "
        "from micah_plan.learning.settings import LearnSettings; print(LearnSettings().resolution, *dir(micah_plan))"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert sorted(said[1:]) == sorted(micah_plan.__all__)


@pytest.mark.slow
def test_results_go_from_process_to_process(
    repository: Path, learned: LearningResult, solved: PlanningResult, runs: RunsResult
) -> None:
    for result in every_result(learned, solved, runs):
        again = pickle.loads(pickle.dumps(result))  # noqa: S301  # our own bytes
        assert (str(again), again.json()) == (str(result), result.json())
        assert again.automaton == result.automaton
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        found = pool.submit(solve, repository / "problems" / "drawer_open.yaml").result()
    assert found.plan.outcome == "solved"
    assert pickle.loads(pickle.dumps(found)).plan.reason == found.plan.reason  # noqa: S301  # our own bytes


def test_the_automaton_and_the_recording_are_those_of_the_package(learned: LearningResult) -> None:
    assert isinstance(learned.automaton, HybridAutomaton)
    assert isinstance(learned.recording, Recording)
