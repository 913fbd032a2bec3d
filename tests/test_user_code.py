"""`--code FILE.py`: path functions and effects of a user on the command line, registered by the file that is named."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from micah_plan.cli.application import COMMANDS, app
from micah_plan.errors import OF_YOUR_OWN, TAKE_CODE

GENTLE = '''
from micah_plan.task.path import Require, path_function


@path_function
def gently(ops, step, *, largest):
    """Close to its latch the door moves by at most `largest` per step, further away by more."""
    away = ops.maximum(0.0, 1.0 - step.x["door"])
    return [Require("gentle at the latch", largest + 0.2 * away - ops.abs(step.u["door"]), step.unit["door"])]
'''
PATH = """
path:
  - name: gently
    arguments: {largest: 0.03}
"""


@pytest.fixture(scope="module")
def folder(repository, tmp_path_factory):
    place = tmp_path_factory.mktemp("code")
    (place / "gentle.py").write_text(GENTLE)
    problem = (repository / "problems" / "microwave_close.yaml").read_text()
    problem = problem.replace("../models/", f"{repository}/models/")
    (place / "problem.yaml").write_text(problem + PATH)
    return place


def run(folder, *words):
    command = [sys.executable, "-W", "error", "-m", "micah_plan", *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def one_line(done):
    assert done.returncode == 2, done.stderr
    (line,) = done.stderr.splitlines()
    return line


def test_the_commands_that_messages_name_take_code_and_no_others() -> None:
    names = [command.__name__ for command in COMMANDS]
    helps = {name: CliRunner().invoke(app, [name, "--help"]).stdout for name in names}
    assert {name for name in names if "--code" in helps[name]} == set(TAKE_CODE)


def test_a_path_function_of_ones_own_is_planned_with_checked_executed_and_shown(folder) -> None:
    code = ("--code", "gentle.py")
    solved = run(folder, "solve", "problem.yaml", "-o", "plan.json", *code, "--json")
    assert solved.returncode == 0, solved.stderr
    for words in (
        ("check", "problem.yaml", "plan.json"),
        ("explain", "plan.json"),
        ("execute", "plan.json", "--trials", "2", "-o", "runs.csv"),
        ("show", "plan.json", "-o", "plan.html"),
    ):
        done = run(folder, *words, *code)
        assert done.returncode == 0, (words, done.stderr)
    inputs = json.loads((folder / "plan.json").read_text())["trajectory"]["inputs"]
    assert max(abs(u) for (u,) in inputs[-6:]) < 0.05


def test_without_the_file_the_message_names_the_option(folder) -> None:
    line = one_line(run(folder, "solve", "problem.yaml", "-o", "none.json"))
    assert "unknown path constraint 'gently'; choose one of stay_above" in line
    assert OF_YOUR_OWN in line
    assert run(folder, "check", "problem.yaml").returncode == 2


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (None, "gone.py: the file does not exist; give --code as FILE.py"),
        ("1 / 0\n", "division by zero"),
        ("def f(:\n", "SyntaxError"),
        (GENTLE + GENTLE, "exists already"),
    ],
    ids=["no file", "an error", "no Python", "twice"],
)
def test_a_file_that_cannot_be_loaded_is_one_line(folder, content, expected) -> None:
    (folder / "gone.py").unlink(missing_ok=True)
    if content is not None:
        (folder / "gone.py").write_text(content)
    assert expected in one_line(run(folder, "check", "problem.yaml", "--code", "gone.py"))


def test_a_file_may_hold_a_machine_as_well(folder) -> None:
    machine = "\nfrom micah_plan.execution.nominal import NominalPlant\n\nMine = NominalPlant.of\n"
    (folder / "both.py").write_text(GENTLE + machine)
    run(folder, "solve", "problem.yaml", "-o", "plan.json", "--code", "both.py")
    done = run(folder, "execute", "plan.json", "--plant", "both.py:Mine", "--code", "both.py", "-o", "own.csv")
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_an_effect_of_ones_own_is_calibrated_and_read_again(folder, repository) -> None:
    run(folder, "new", "effect", "mine")
    code = ("--code", "mine/effect.py")
    name = "speed_drag"
    source = (folder / "mine" / "effect.py").read_text()
    assert f'name = "{name}"' in source
    for words in (
        ("solve", f"{repository}/problems/drawer_open.yaml", "-o", "open.json"),
        ("execute", "open.json", "--trials", "6", "-o", "open.csv"),
    ):
        assert run(folder, *words).returncode == 0
    done = run(
        folder, "calibrate", f"{repository}/models/drawer.yaml", "open.csv", "-o", "better.yaml", *code, "--json"
    )
    assert done.returncode == 0, done.stderr
    model = (repository / "models" / "drawer.yaml").read_text()
    effect = f"effects:\n  - name: {name}\n    coordinate: drawer\n    parameters: {{drag: 2.0}}\n"
    (folder / "dragged.yaml").write_text(model.replace("parts:\n", effect + "parts:\n", 1))
    assert run(folder, "check", "dragged.yaml", *code).returncode == 0
    assert OF_YOUR_OWN in one_line(run(folder, "predict", "dragged.yaml", "open.csv"))
