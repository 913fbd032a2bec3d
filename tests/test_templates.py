"""What `micah-plan new` writes works as it is: the problems solve, the effect conforms, editors find the schemas."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import jsonschema
import pytest

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.checking import check_file
from micah_plan.cli.console import title_of
from micah_plan.documents.model import load_model
from micah_plan.documents.problem import load_problem
from micah_plan.documents.sweep import load_sweep
from micah_plan.documents.yaml_lines import read_yaml
from micah_plan.errors import InputError
from micah_plan.planning.solver import solve
from micah_plan.sweep.run import run_sweep
from micah_plan.templates.first_problem import first_problem
from micah_plan.templates.write import write_template


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("kind", "modes", "has_arm"), [("problem", ("shut", "slides"), False), ("robot", ("slides",), True)]
)
def test_the_problem_solves_as_it_is(tmp_path: Path, kind: str, modes: tuple[str, ...], has_arm: bool) -> None:
    write_template(kind, tmp_path / "mine")  # type: ignore[arg-type]
    plan = solve(load_problem(tmp_path / "mine" / "problem.yaml"))
    assert plan.outcome == "solved"
    assert tuple(dict.fromkeys(plan.mode_sequence)) == modes
    assert (plan.arm is not None) is has_arm


@pytest.mark.slow
def test_the_sweep_runs_as_it_is(tmp_path: Path) -> None:
    write_template("sweep", tmp_path)
    with ThreadPoolExecutor(1) as executor:
        done = run_sweep(load_sweep(tmp_path / "sweep.yaml"), tmp_path / "results.csv", executor=executor)
    assert len(done.results) == 12
    assert {result.outcome for result in done.results} == {"solved"}
    assert sum(result.successes or 0 for result in done.results) > 50


def test_what_the_comment_on_the_guard_says_is_so(tmp_path: Path) -> None:
    """A harder pull is planned where the magnet holds more, and none is found where it holds more than a step."""
    write_template("problem", tmp_path)
    model = tmp_path / "model.yaml"

    def pull(release: str) -> tuple[str, float]:
        model.write_text(re.sub(r"input drawer > [\d.]+", f"input drawer > {release}", model.read_text()))
        plan = solve(load_problem(tmp_path / "problem.yaml"))
        return plan.outcome, 0.0 if plan.trajectory is None else float(plan.trajectory.inputs.max())

    assert pull("0.02")[0] == "solved"
    assert pull("0.02")[1] > 0.02
    assert pull("0.05")[0] == "no_plan"


def test_the_effect_conforms_and_runs(tmp_path: Path) -> None:
    write_template("effect", tmp_path)
    done = subprocess.run([sys.executable, "effect.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    first, without, dragged = done.stdout.splitlines()
    assert first == "speed_drag conforms"
    ends = [float(line.rstrip("]").split()[-1]) for line in (without, dragged)]
    assert ends[0] == pytest.approx(0.05 + 5 * 0.04)
    assert ends[1] == pytest.approx(0.05 + 5 * 0.04 / 1.4, abs=1e-4)


@pytest.mark.sweep
@pytest.mark.parametrize("kind", ["problem", "effect", "robot", "sweep", "tags"])
def test_every_yaml_file_is_good_and_names_a_schema_that_reports_it(tmp_path: Path, kind: str) -> None:
    written = write_template(kind, tmp_path / kind)  # type: ignore[arg-type]
    assert sorted((tmp_path / kind).iterdir()) == sorted(written)
    found = [path for path in written if path.suffix == ".yaml"]
    assert found
    for path in found:
        assert check_file(path).faults == ()
        comment = path.read_text().splitlines()[0]
        described = json.loads((path.parent / comment.removeprefix("# yaml-language-server: $schema=")).read_text())
        jsonschema.validate(read_yaml(path.read_bytes(), str(path)).data, described)


@pytest.mark.slow
def test_the_command_writes_and_never_overwrites(tmp_path: Path) -> None:
    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "micah_plan", "new", *arguments]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)

    done = run("problem", "mine", "--json")
    assert json.loads(done.stdout)["files"][0] == "mine/problem.yaml"
    (tmp_path / "mine" / "problem.yaml").write_text("my own")
    (tmp_path / "mine" / "model.schema.json").unlink()
    refused = run("robot", "mine")
    assert refused.returncode == 2
    assert refused.stderr == "error: mine/problem.yaml: is there already; name another folder\n"
    assert (tmp_path / "mine" / "problem.yaml").read_text() == "my own"
    assert not (tmp_path / "mine" / "robot.urdf").exists()


@pytest.mark.sweep
@pytest.mark.parametrize("name", ["cabinet", "stapler"])
def test_a_problem_for_a_learned_model_solves_as_it_is(tmp_path: Path, repository: Path, name: str) -> None:
    written = write_template("problem", tmp_path / "mine", model=repository / "models" / f"{name}.yaml")
    assert [check_file(path).faults for path in written if path.suffix == ".yaml"] == [(), ()]
    assert solve(load_problem(written[0])).outcome == "solved"


@pytest.mark.parametrize(
    ("file", "title"),
    [("mine/problem.yaml", "mine"), ("mine/model.yaml", "mine"), ("a/drawer_open.yaml", "drawer_open")],
)
def test_a_page_is_called_after_the_folder_where_the_file_has_a_common_name(file: str, title: str) -> None:
    assert title_of(Path(file)) == title


def test_only_a_problem_is_made_for_a_model(tmp_path: Path, repository: Path) -> None:
    with pytest.raises(InputError, match="a robot is not made from a model"):
        write_template("robot", tmp_path / "mine", model=repository / "models" / "drawer.yaml")
    with pytest.raises(InputError, match="nothing in this model can be moved"):
        first_problem(held_still(repository))
    assert not (tmp_path / "mine").exists()


def held_still(repository: Path) -> HybridAutomaton:
    drawer = load_model(repository / "models" / "drawer.yaml")
    return replace(drawer, modes=tuple(replace(mode, input_matrix=((0.0,),)) for mode in drawer.modes))


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for place in (tmp_path / "no" / "such", tmp_path / "file"):
        with pytest.raises(InputError, match="cannot be made"):
            write_template("effect", place)
    with pytest.raises(InputError, match="choose one of problem, effect, robot, sweep"):
        write_template("page", tmp_path)  # type: ignore[arg-type]
