"""`micah-plan demo`: what the project ships comes into a new folder, and nothing is overwritten."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from micah_plan.documents.problem import load_problem
from micah_plan.errors import InputError
from micah_plan.templates.shipped import FOLDERS, copy_shipped


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "micah_plan", "demo", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_the_copied_files_are_those_that_are_shipped_and_work_there(tmp_path: Path, repository: Path) -> None:
    written = copy_shipped(tmp_path / "new")
    assert {file.relative_to(tmp_path / "new").parts[0] for file in written} == {"examples", "models", "problems"}
    for file in written:
        assert file.read_bytes() == (repository / file.relative_to(tmp_path / "new")).read_bytes()
    load_problem(tmp_path / "new" / "problems" / "microwave_close.yaml")


def test_a_folder_with_something_in_it_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="is there already; name another folder"):
        copy_shipped(tmp_path)
    done = run(tmp_path, "--json")
    assert done.returncode == 2
    assert json.loads(done.stdout)["errors"][0]["remedy"] == "name another folder"
    assert [file.name for file in tmp_path.iterdir()] == ["mine.txt"]


def test_the_wheel_has_the_folders(repository: Path) -> None:
    built = tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["build"]
    included = built["targets"]["wheel"]["force-include"]
    assert included == {name: f"micah_plan/shipped/{name}" for name in FOLDERS}


@pytest.mark.slow
def test_only_copying_is_quick(tmp_path: Path) -> None:
    done = run(tmp_path / "new", "--copy-only", "--json")
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["files"] == len([file for file in (tmp_path / "new").rglob("*") if file.is_file()])


@pytest.mark.evidence  # every landing runs the same steps as examples/demo.py
def test_the_demo_runs_in_a_new_folder(tmp_path: Path) -> None:
    done = run(tmp_path / "new")
    assert done.returncode == 0, done.stderr
    assert "reached the goal" in done.stdout
    assert (tmp_path / "new" / "output" / "nominal.html").is_file()
