"""`micah-plan check`: every file that ships is good, every fault is one line with its place, nothing is solved."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from micah_plan.checking import check_file
from micah_plan.cli.checking import check_keys
from micah_plan.errors import InputError, together

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = {
    "models": "model",
    "models/parts": "parts",
    "problems": "problem",
    "problems/sweeps": "sweep",
    "problems/experiments": "experiment",
    "examples/demonstrations": "recording",
    "examples/logs": "recording",
    "examples/video": "tags",
}
OTHERS = {"explore_handle": "scene", "laboratory.conventions": "conventions"}
SHIPPED = [
    (OTHERS.get(file.stem, kind), file)
    for place, kind in FOLDERS.items()
    for file in sorted((ROOT / place).glob("*.*"))
    if file.suffix != ".mp4"
]


@pytest.mark.sweep
@pytest.mark.parametrize(("kind", "file"), SHIPPED, ids=[file.stem for _, file in SHIPPED])
def test_files_that_ship_can_be_used(kind: str, file: Path) -> None:
    found = check_file(file)
    assert (found.kind, found.faults, found.warnings) == (kind, (), ())


def test_all_faults_of_a_file_are_reported_in_the_order_of_the_file(tmp_path: Path) -> None:
    text = (ROOT / "problems" / "drawer_open.yaml").read_text()
    problem = tmp_path / "problem.yaml"
    problem.write_text(text.replace("tolerance", "tolerence").replace("0.002", "-2") + "x: 1\n")
    found = check_file(problem)
    assert [fault.problem for fault in found.faults] == [
        "unknown key 'tolerence'",
        "expected a number >= 0, found -2",
        "unknown key 'x'",
        "missing key 'tolerance'",
    ]
    for fault in found.faults[:3]:
        line, column = fault.position or (0, 0)
        key = str(fault.where).rpartition("'")[0].rpartition(".")[2].rpartition("'")[2]
        assert problem.read_text().splitlines()[line - 1][column - 1 :].startswith(key)
        assert f"line {line}, column {column}" in str(fault)
    assert "did you mean 'tolerance'? choose one of value, tolerance" in str(found.faults[0])


def test_a_problem_is_checked_with_its_model_and_its_robot(tmp_path: Path) -> None:
    for folder in ("models", "problems"):
        (tmp_path / folder).mkdir()
    text = (ROOT / "problems" / "microwave_close_by_arm.yaml").read_text()
    (tmp_path / "problems" / "p.yaml").write_text(text)
    (tmp_path / "models" / "robots").mkdir()
    (tmp_path / "models" / "robots" / "arm7.urdf").write_text((ROOT / "models/robots/arm7.urdf").read_text())
    model = (ROOT / "models" / "microwave.yaml").read_text()
    (tmp_path / "models" / "microwave.yaml").write_text(model)
    assert check_file(tmp_path / "problems" / "p.yaml").faults == ()
    (tmp_path / "models" / "robots" / "arm7.urdf").write_text("<robot name='none'/>")
    (fault,) = check_file(tmp_path / "problems" / "p.yaml").faults
    assert str(fault.source).endswith("arm7.urdf")
    (tmp_path / "models" / "microwave.yaml").write_text(model.replace("kind: revolute", "kind: round"))
    (fault, *_) = check_file(tmp_path / "problems" / "p.yaml").faults
    assert str(fault.source).endswith("microwave.yaml")
    assert fault.position is not None


@pytest.mark.parametrize(
    ("name", "content", "kind", "said"),
    [
        ("none.yaml", None, None, "does not exist"),
        ("none.csv", None, "recording", "does not exist"),
        ("f.yaml", "a: 1\n", None, "missing key 'format'; name the kind of file: one of micah-plan/model/1"),
        ("f.yaml", "format: micah-plan/problm/1\n", None, "did you mean 'micah-plan/problem/1'?"),
        ("f.yaml", "format: [1]\n", None, "unknown format"),
        ("f.yaml", "format: micah-plan/model/2\n", "model", "expected micah-plan/model/1"),
        ("f.json", "{}", "plan", "missing key 'format'"),
        ("f.txt", "t,x,y,z\n0,1,2,a\n", "recording", "line 2, column 'z'"),
        ("README.md", "# text\n", "recording", "the extension '.md'"),
    ],
)
def test_what_cannot_be_used_has_one_fault(
    tmp_path: Path, name: str, content: str | None, kind: str, said: str
) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    found = check_file(tmp_path / name)
    (fault,) = found.faults
    assert found.kind == kind
    assert said in str(fault)
    assert str(fault).startswith(str(tmp_path / name))


def test_a_recording_in_millimetres_is_warned_of(tmp_path: Path) -> None:
    rows = "".join(f"{i * 0.1},{i * 100},0,2000\n" for i in range(60))
    (tmp_path / "mm.csv").write_text("t,x,y,z\n" + rows)
    found = check_file(tmp_path / "mm.csv")
    assert not found.faults
    assert "millimetres" in found.warnings[0]


def test_modes_that_place_a_part_far_apart_are_warned_of(tmp_path: Path) -> None:
    text = (ROOT / "models" / "microwave.yaml").read_text()
    (tmp_path / "far.yaml").write_text(text.replace("position: [0.0697588", "position: [50.0697588"))
    found = check_file(tmp_path / "far.yaml")
    assert not found.faults
    assert found.warnings[0].startswith(
        "modes.rigid.joints.door: 50.1 m is farther than a room is wide; lengths are in m"
    )
    assert found.warnings[1].startswith(
        "transition revolute -> rigid: part door jumps by 50 m between the joints of it"
    )


def test_the_command_prints_the_same_for_people_and_programs(tmp_path: Path) -> None:
    bad, good = tmp_path / "bad.yaml", ROOT / "models" / "drawer.yaml"
    bad.write_text("format: micah-plan/problem/1\nmodl: x.yaml\nstart: 3\n")

    def run(*options: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "micah_plan", "check", str(bad), str(good), *options]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    told, data = run(), run("--json")
    assert (told.returncode, told.stderr, data.returncode, data.stderr) == (2, "", 2, "")
    found = json.loads(data.stdout)
    assert found == check_keys([check_file(bad), check_file(good)])
    messages = [f"error: {fault['message']}" for fault in found["files"][0]["faults"]]
    assert told.stdout.splitlines() == [*messages, f"{good}: a model that can be used"]
    assert found["faults"] == len(messages) == 4
    assert found["files"][0]["faults"][0]["line"] == 2


def test_errors_that_come_together_are_separated_again() -> None:
    first, second = InputError("a", where="line 1", position=(1, 2), remedy="r"), InputError("b")
    both = together([first, second])
    assert str(both) == "line 1: a (and 1 more error); r"
    assert [str(error) for error in both.located("f").each()] == ["f, line 1: a; r", "f: b"]
    assert both.each()[0].position == (1, 2)
    assert str(together([second])) == "b"


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("command", "said"),
    [
        (
            ["execute", "models/drawer.yaml", "-o", "x.csv"],
            "expected a plan (.json), found a YAML file; solve",
        ),
        (["explain", "examples/demonstrations/drawer.csv"], "expected a plan (.json), found a .csv file; solve the"),
        (
            ["predict", "examples/demonstrations/drawer.csv", "models/drawer.yaml"],
            "found a recording (.csv); give",
        ),
        (
            ["predict", "models/robots/arm7.urdf", "examples/demonstrations/drawer.csv"],
            "`micah-plan convert`",
        ),
        (["solve", "problems/explore_handle.yaml", "-o", "x.json"], "expected a problem file, found a scene file"),
        (["learn", "models/drawer.yaml", "-o", "x.yaml"], "expected a recording, found the extension '.yaml'"),
    ],
)
def test_a_file_of_another_kind_is_called_that(command: list[str], said: str, tmp_path: Path) -> None:
    arguments = [str(ROOT / word) if "/" in word else word.replace("x.", f"{tmp_path}/x.") for word in command]
    command = [sys.executable, "-m", "micah_plan", *arguments]
    refused = subprocess.run(command, capture_output=True, text=True, check=False)
    assert refused.returncode == 2
    assert said in refused.stderr
    assert not list(tmp_path.iterdir())
