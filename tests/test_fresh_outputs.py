"""What a command writes, the others read: every fresh output passes `check`, `show`, `diff` and the next command."""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path
from typing import Any

import pytest
from shell import exit_code

ROOT = Path(__file__).resolve().parents[1]

# In the order in which they can be given; {here} is the folder of the outputs.
WRITING = (
    "learn examples/demonstrations/drawer.csv -o {here}/model.yaml --html {here}/learned.html",
    "solve problems/drawer_open.yaml --model {here}/model.yaml -o {here}/plan.json --html {here}/planned.html",
    "execute {here}/plan.json --trials 3 -o {here}/runs.csv --html {here}/executed.html",
    "predict {here}/model.yaml {here}/runs.csv --html {here}/predicted.html",
    "calibrate {here}/model.yaml {here}/runs.csv -o {here}/improved.yaml --html {here}/calibrated.html",
    "explore problems/explore_handle.yaml -o {here}/explored.yaml --html {here}/explored.html",
    "execute problems/experiments/drawer.yaml -o {here}/experiment_runs.csv",
    "sweep problems/sweeps/drawer.yaml --workers 1 --dry-run",
    "new problem {here}/of_model --model {here}/model.yaml",
    "new problem {here}/started",
    "new robot {here}/with_robot",
    "new sweep {here}/swept",
    "convert {here}/runs.csv {here}/runs.npz",
    "convert {here}/model.yaml {here}/model.urdf",
    "convert {here}/model.urdf {here}/of_urdf.yaml",
    "learn {here}/runs.csv -o {here}/learned_again.yaml",
)
FOLLOWING = (
    "learn {here}/runs.npz -o {here}/learned_of_npz.yaml",
    "solve {here}/of_model/problem.yaml -o {here}/plan_of_new.json",
    "solve problems/drawer_open.yaml --model {here}/improved.yaml -o {here}/plan_of_improved.json",
    "predict {here}/improved.yaml {here}/runs.csv",
    "predict {here}/model.yaml {here}/experiment_runs.csv",
    "diff {here}/model.yaml {here}/improved.yaml",
    "diff {here}/model.yaml {here}/learned_again.yaml",
    "explain {here}/plan.json",
    "show {here}/model.yaml -o {here}/model.html",
    "show {here}/explored.yaml -o {here}/explored_model.html",
    "show {here}/plan.json -o {here}/plan.html",
    "show {here}/runs.csv -o {here}/runs.html",
    "show {here}/plan.json {here}/runs.csv -o {here}/both.html",
)


def _given(line: str, here: Path) -> tuple[int, dict[str, Any], str]:
    """Exit code, JSON and stderr of a command line, given in this process."""
    said, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(errors), contextlib.chdir(ROOT):
        code = exit_code(*line.format(here=here).split(), "--json")
    return code, json.loads(said.getvalue()), errors.getvalue()


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a fresh output of every command that writes."""
    folder = tmp_path_factory.mktemp("fresh")
    for line in WRITING:
        code, found, _ = _given(line, folder)
        assert code == 0, (line, found)
    return folder


@pytest.mark.slow
def test_fresh_files_pass_check_without_a_warning(here: Path) -> None:
    read = {".yaml", ".json", ".csv", ".npz"}
    files = sorted(path for path in here.rglob("*.*") if path.suffix in read and path.stem.count(".") == 0)
    assert {"plan.json", "runs.csv", "improved.yaml", "explored.yaml", "sweep.yaml"} <= {path.name for path in files}
    for file in files:
        code, found, _ = _given(f"check {file}", here)
        assert (code, found["faults"], found["files"][0]["warnings"]) == (0, 0, []), found


@pytest.mark.slow
@pytest.mark.parametrize("line", FOLLOWING)
def test_fresh_files_go_into_the_next_command(here: Path, line: str) -> None:
    code, found, errors = _given(line, here)
    assert (code, "error" in errors) == (0, False), found
    assert found


@pytest.mark.slow
def test_a_fresh_plan_that_was_changed_is_refused(here: Path, tmp_path: Path) -> None:
    """The neighbour of those that pass."""
    text = (here / "plan.json").read_text(encoding="utf-8")
    (tmp_path / "plan.json").write_text(text.replace('"seed": 0', '"seed": 1'), encoding="utf-8")
    code, found, _ = _given(f"check {tmp_path}/plan.json", here)
    assert (code, found["faults"]) == (2, 1)
    assert "was changed or damaged" in found["files"][0]["faults"][0]["problem"]
