"""`micah-plan doctor`: it names every library of the package, sees what is missing or broken, and says what to do."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from micah_plan import environment
from micah_plan.environment import LIBRARIES, Environment, Found, Library, examine
from micah_plan.planning.nlp import can_solve

ROOT = Path(__file__).resolve().parents[1]
NOT_LIBRARIES_TO_TRY = {"micah-plan", "mypy", "ruff"}


def test_every_library_that_the_package_declares_is_tried() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    declared = {(name, "") for name in project["dependencies"]}
    declared |= {(name, extra) for extra, names in project["optional-dependencies"].items() for name in names}
    plain = {(re.split(r"[\[><=]", name)[0], extra) for name, extra in declared}
    assert {(library.name, library.extra) for library in LIBRARIES} == {
        (name, extra) for name, extra in plain if name not in NOT_LIBRARIES_TO_TRY
    }


def test_the_solvers_are_those_that_can_be_tried() -> None:
    assert "mumps" in environment.LINEAR_SOLVERS
    assert can_solve("mumps")


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """A package that needs little, of which some is not there."""
    libraries = (
        Library("numpy", "numpy", "compute"),
        Library("pytest", "json.no_such_part", "test"),
        Library("no-such-thing", "none", "dream"),
        Library("never-heard-of", "none", "wonder", "more"),
        Library("scipy", "", "compute", "more"),
    )
    monkeypatch.setattr(environment, "LIBRARIES", libraries)
    monkeypatch.setattr(environment, "LINEAR_SOLVERS", ("mumps", "no_such_solver"))
    monkeypatch.setattr(environment, "BROWSERS", ("no-such-browser",))


@pytest.mark.usefixtures("few")
def test_missing_or_broken_parts_are_reported_with_a_remedy() -> None:
    told: list[float] = []
    found = examine(lambda _, fraction: told.append(fraction))
    assert [item.state for item in found.libraries] == ["works", "broken", "missing", "missing", "works"]
    assert "No module named 'json.no_such_part'" in found.libraries[1].message
    assert found.linear_solvers == ("mumps",)
    assert found.browser is None
    assert not found.complete
    assert told == sorted(told)
    advice = "\n".join(found.advice)
    assert "pytest does not load" in advice
    assert "to dream: pip install no-such-thing" in advice
    assert "to use more (wonder): pip install never-heard-of" in advice
    assert "apt-get install chromium" in advice


def test_a_crash_is_found_and_not_suffered() -> None:
    works, message = environment._runs("import os; os.abort()")
    assert not works
    assert message


@pytest.mark.parametrize(
    ("extra", "solvers", "complete"), [("", ("mumps",), False), ("sim", ("mumps",), True), ("sim", (), False)]
)
def test_an_extra_that_is_missing_leaves_planning_whole(extra: str, solvers: tuple[str, ...], complete: bool) -> None:
    missing = Found(Library("x", "x", "y", extra), "missing", None)
    assert Environment("", "", "", (missing,), solvers, None, ()).complete is complete


@pytest.mark.slow
def test_this_environment_is_complete() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "micah_plan", "doctor", "--json"], capture_output=True, text=True, check=True
    )
    found = json.loads(done.stdout)
    assert found["complete"]
    assert {item["name"] for item in found["libraries"]} == {library.name for library in LIBRARIES}
    assert done.stderr == ""
