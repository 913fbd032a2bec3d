"""README's commands, the Makefile and the gate are the same lines, and tests that need an extra follow one rule."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from extras import ALL_EXTRAS_EXPECTED, IN_QUICK_SUITE, distributions_of_extras, is_installed

ROOT = Path(__file__).resolve().parents[1]


def recipe(target: str) -> list[str]:
    """The lines that a target of the Makefile runs, with its variables filled in, the environment's creation first."""
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    variables = dict(re.findall(r"^(\w+) \??:?= (.+)$", text, re.MULTILINE))
    rules = dict(re.findall(r"^([^\s:#][^:=\n]*):[^=\n]*\n((?:\t.+\n)+)", text, re.MULTILINE))
    lines = rules["$(BIN)/python"].splitlines() + rules[target].splitlines()
    return [re.sub(r"\$\((\w+)\)", lambda match: variables[match[1]], line).strip() for line in lines]


def plain_lines_of_readme() -> list[str]:
    """The commands that README says `make` wraps, without their comments."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    block = re.search(r"`make` only wraps these lines:\n\n```bash\n(.*?)```", text, re.DOTALL)
    assert block, "README.md shows what make wraps"
    return [line.partition("  #")[0].strip() for line in block[1].splitlines()]


def test_readme_shows_the_lines_of_the_makefile() -> None:
    demo, test = recipe("demo"), recipe("test")
    assert plain_lines_of_readme() == demo + test[1:]


def test_the_gate_begins_with_the_commands_of_readme() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    gate = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    commands = re.findall(r"^make \w+", readme, re.MULTILINE)
    assert commands == ["make demo", "make test"]
    stages = re.findall(r"^stage (?:'[^']+'|\w+) (.+)$", gate, re.MULTILINE)
    assert stages[:2] == [f"as_new_user {command}" for command in commands]
    assert gate.index(stages[1]) < gate.index("pip install"), "nothing else is installed before them"


def test_make_test_installs_the_extras_that_the_quick_suite_needs() -> None:
    assert f".[{','.join(IN_QUICK_SUITE)}]" in " ".join(recipe("test"))


def test_the_gate_installs_every_extra() -> None:
    gate = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    installed = re.search(r"pip install --quiet -e '\.\[(.+)\]'", gate)
    assert installed
    extras = distributions_of_extras()
    reached = frozenset[str]().union(*(extras[name] for name in installed[1].split(",")))
    assert reached == frozenset[str]().union(*extras.values())
    assert "MICAH_ALL_EXTRAS" in gate


@pytest.mark.skipif(not ALL_EXTRAS_EXPECTED, reason="only in the gate's environment, which sets MICAH_ALL_EXTRAS")
@pytest.mark.slow
def test_no_extra_is_missing_in_the_gate() -> None:
    assert [extra for extra in distributions_of_extras() if not is_installed(extra)] == []


MISSING = """
import pytest
from extras import requires

@requires("sim")
def test_needs_it():
    import mujoco

def test_needs_nothing():
    pass
"""


@pytest.mark.sweep
@pytest.mark.parametrize(("expected", "outcome"), [(False, "1 passed, 1 skipped"), (True, "1 passed, 1 error")])
def test_a_missing_extra_skips_or_fails_where_all_are_expected(tmp_path: Path, expected: bool, outcome: str) -> None:
    """A project of its own, whose extra no machine can install."""
    for name in ("extras.py", "conftest.py"):
        (tmp_path / "tests").mkdir(exist_ok=True)
        (tmp_path / "tests" / name).write_text((ROOT / "tests" / name).read_text(encoding="utf-8"))
    (tmp_path / "pyproject.toml").write_text(
        '[project.optional-dependencies]\nsim = ["no-such-distribution>=1"]\n'
        '[tool.pytest.ini_options]\nmarkers = ["requires_extra(name): x"]\n'
    )
    (tmp_path / "tests" / "test_one.py").write_text(MISSING)
    environment = {name: value for name, value in os.environ.items() if name != "MICAH_ALL_EXTRAS"}
    environment |= {"MICAH_ALL_EXTRAS": "1"} if expected else {}
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-rs", "tests"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert outcome in done.stdout, done.stdout
    assert "needs the extra 'sim'" in done.stdout
