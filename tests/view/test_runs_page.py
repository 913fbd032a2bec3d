"""Executed runs beside their plan, and measured beside predicted motion: what is said of them, and what pages hold."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from extras import skip_without
from view_objects import problem, solved

from micah_plan import execute, predict, show, solve
from micah_plan.api.execution import RunsResult
from micah_plan.api.planning import PlanningResult
from micah_plan.errors import InputError
from micah_plan.task.plan import Plan
from micah_plan.view.executed import ExecutedRun, executed_runs
from micah_plan.view.plan_page import plan_page
from micah_plan.view.runs_on_page import first_runs, runs_badge


@pytest.fixture(scope="module")
def planned(repository: Path) -> PlanningResult:
    return solve(repository / "problems" / "microwave_close.yaml")


@pytest.fixture(scope="module")
def good(planned: PlanningResult) -> RunsResult:
    return execute(planned, trials=30)


@pytest.fixture(scope="module")
def bad(planned: PlanningResult) -> RunsResult:
    skip_without("sim")
    return execute(planned, plant="mujoco", trials=2, plant_parameters={"friction": 60.0})


def runs_of(result: RunsResult, **changes: Any) -> tuple[ExecutedRun, ...]:
    given = {"failures": dict(result.failures)} | changes
    trajectory = result.planned.plan.trajectory
    assert trajectory is not None
    return executed_runs(result.planned.problem, trajectory, result.recording, **given)


def data_of(page: str) -> dict[str, Any]:
    found = re.search(r'id="page-data">(.*?)</script>', page, re.DOTALL)
    assert found
    return dict(json.loads(found[1]))


@pytest.mark.slow
def test_runs_of_the_model_itself_seldom_leave_the_plan(good: RunsResult) -> None:
    runs = runs_of(good)
    assert [run.reached for run in runs] == [trial not in dict(good.failures) for trial in range(30)]
    assert sum("left the plan" in run.leaving for run in runs) <= 3


@pytest.mark.slow
def test_runs_that_stick_leave_it_with_the_place_and_the_reason(bad: RunsResult) -> None:
    for run, (_, reason) in zip(runs_of(bad), bad.failures, strict=True):
        assert not run.reached
        assert run.ending == reason
        assert re.search(r"left the plan at step \d+: door .* from the mean, σ", run.leaving)
        assert run.words[0][0].isupper()


@pytest.mark.slow
def test_without_the_word_of_execution_success_is_judged_by_the_last_row(good: RunsResult, bad: RunsResult) -> None:
    assert all(run.reached for run in runs_of(good, failures=None))
    runs = runs_of(bad, failures=None)
    missed = [abs(run.x[-1, 0] - 1.2) > 0.03 for run in runs]
    assert any(missed), "friction of 60 N m keeps the door from its frame"
    assert [not run.reached for run in runs] == missed
    assert ["from its target (tolerance 0.03 rad" in run.ending for run in runs] == missed


def test_two_recordings_are_shown_side_by_side(planned: PlanningResult, good: RunsResult, tmp_path: Path) -> None:
    """Before and after a change: colours, counts and names of both; all runs are shown at first."""
    before = good.recording.select(run=good.recording.runs[:3][0])
    later = good.recording.rows(np.isin(good.recording.run, good.recording.runs[:2]))
    broken_off = before.rows(np.arange(3))
    page = plan_page(planned.plan, planned.problem, executed={"before.csv": broken_off, "after.csv": later})
    data = data_of(page)
    labels = re.findall(r"<option[^>]*>([^<]*)</option>", page)[:3]
    assert labels[0] == "before.csv, run 0, missed the goal"
    assert sorted(labels[1:]) == [f"after.csv, run {k}, reached the goal" for k in (0, 1)]
    assert '<option value="all" selected>' in page
    assert "before.csv: 0 of 1 run, after.csv: 2 of 2 runs reached the goal" in page
    assert "Pink: before.csv. Orange: after.csv." in page
    assert len({run["drawn"] for run in data["runs"]}) == 3
    shown = show(good, tmp_path / "page.html", before=broken_off)
    assert "before: 0 of 1 run, after:" in (tmp_path / "page.html").read_text()
    assert str(shown)
    with pytest.raises(InputError, match="what execute returned"):
        show(good, tmp_path / "page.html", before=planned)
    alone = plan_page(planned.plan, planned.problem, executed={"after.csv": later})
    assert "2 of 2 runs reached the goal" in alone
    assert "after.csv" not in alone
    assert "selected>all runs" not in alone


def test_runs_of_another_object_are_refused_by_their_name(planned: PlanningResult, good: RunsResult) -> None:
    other = replace(good.recording, part=("lid",) * len(good.recording))
    with pytest.raises(InputError, match="lid") as refused:
        plan_page(planned.plan, planned.problem, executed={"a.csv": good.recording, "b.csv": other})
    assert "b.csv" in str(refused.value)


@pytest.mark.slow
def test_poses_are_those_of_the_configurations_where_no_orientation_was_measured(good: RunsResult) -> None:
    bare = replace(good.recording, quaternion=None)
    trajectory = good.planned.plan.trajectory
    assert trajectory is not None
    with_turns, without = (
        executed_runs(good.planned.problem, trajectory, recording, {})[0] for recording in (good.recording, bare)
    )
    apart = with_turns.poses["door"].rotation * without.poses["door"].rotation.inv()
    assert np.quantile(apart.magnitude(), 0.9) < 0.15
    assert np.abs(with_turns.poses["door"].translation - without.poses["door"].translation).max() < 0.04


def test_the_page_has_a_ghost_a_curve_and_words_for_every_run(good: RunsResult) -> None:
    page = good.page()
    data = data_of(page)
    assert len(data["runs"]) == 20, "30 would make the page large"
    assert len({tuple(run["path"]) for run in data["runs"]}) == 20
    (drawn,) = re.findall(r'<div class="chart" [^>]*><script type="application/json">(.*?)</script>', page)
    curves = {mark.get("run") for panel in json.loads(drawn)["panels"] for mark in panel["marks"]} - {None}
    assert curves >= {run["drawn"] for run in data["runs"]}
    for run in data["runs"]:
        assert run["readouts"][0][1][0].startswith(f"run {run['drawn']} after 0 s")
        assert run["words"]
    assert f"{good.successes} of 30 runs reached the goal" in page
    assert "step, of 0.5 s each" in page
    assert len(page.encode()) < 4_000_000
    assert page == good.page()


def test_failed_runs_come_first(good: RunsResult) -> None:
    runs = runs_of(good)
    reached = tuple(replace(run, reached=True) for run in runs)
    worse = (*reached[:5], replace(reached[5], reached=False), *reached[6:])
    assert first_runs(worse)[0].run == 5
    assert runs_badge(worse) == ("29 of 30 runs reached the goal", "fair")
    assert runs_badge(reached) == ("30 of 30 runs reached the goal", "good")


def test_runs_of_another_object_or_without_a_plan_are_refused(good: RunsResult) -> None:
    with pytest.raises(InputError, match="no trajectory that runs could follow"):
        plan_page(Plan("no_plan", "nothing"), problem(), executed=good.recording)
    two = replace(good.recording, part=("lid", *["box"] * (len(good.recording) - 1)))
    with pytest.raises(InputError, match="expected the parts door"):
        plan_page(solved(), problem(), executed=two)


@pytest.mark.slow
def test_a_prediction_has_a_page_with_its_worst_run_first(planned: PlanningResult, bad: RunsResult) -> None:
    for runs, badge in ((execute(planned, trials=5), "errors look like noise"), (bad, "the model lacks something")):
        result = predict(runs.planned, runs)
        data, page = data_of(result.page()), result.page()
        assert badge in page
        sizes = [np.mean(run.rollout.position**2) for run in result.runs]
        assert data["runs"][0]["drawn"] == int(np.argmax(sizes))
        assert "measured, " in data["runs"][0]["readouts"][3][1][1]
        assert page == result.page()
