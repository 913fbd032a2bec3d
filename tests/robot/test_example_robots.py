"""Arms that others describe, with meshes: Panda, Kinova and UR5 of example-robot-data (extra `robots`)."""

from __future__ import annotations

from importlib.metadata import distribution
from pathlib import Path

import numpy as np
import pytest
from extras import requires

from micah_plan import load, solve
from micah_plan.documents.problem import load_problem
from micah_plan.errors import InputError
from micah_plan.robot.arm import symbolic_forward
from micah_plan.robot.inverse_kinematics import next_pose
from micah_plan.robot.load_arm import describe_robot, load_arm
from micah_plan.templates.write import write_template

ARMS = {
    "panda_description/urdf/panda.urdf": ("panda_hand", 7),
    "kinova_description/robots/kinova.urdf": ("j2s6s200_end_effector", 6),
    "ur_description/urdf/ur5_robot.urdf": ("ee_link", 6),
}


@pytest.fixture(scope="module")
def robots() -> Path:
    return Path(str(distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots")))


def problem_with(folder: Path, robot: str) -> Path:
    """The template of a problem with a robot, with another one; returns its file."""
    write_template("robot", folder)
    file = folder / "problem.yaml"
    text = file.read_text().replace("path: robot.urdf", f"path: {robot}").replace("tool: tool ", "tool: panda_hand ")
    file.write_text(text)
    return file


@requires("robots")
def test_an_arm_is_known_by_its_name(robots: Path, tmp_path: Path) -> None:
    """Its meshes are found by the plan file too, wherever that lies."""
    problem = load_problem(problem_with(tmp_path, "panda"))
    assert problem.robot is not None
    assert Path(problem.robot.folder) == robots / "panda_description" / "urdf"
    (tmp_path / "elsewhere").mkdir()
    solve(problem).save(tmp_path / "elsewhere" / "plan.json")
    moved = load(tmp_path / "elsewhere" / "plan.json").problem.robot
    assert moved is not None
    assert (moved, moved.folder) == (problem.robot, problem.robot.folder)
    with pytest.raises(InputError, match="no robot of that name; did you mean 'panda'"):
        load_problem(problem_with(tmp_path / "wrong", "pnda"))


def test_without_the_extra_a_name_names_which_one_brings_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("micah_plan.documents.scene.named_robots", dict)
    with pytest.raises(
        InputError, match=r"line \d+.*no file 'panda' next to this one.*pip install 'example-robot-data"
    ):
        load_problem(problem_with(tmp_path / "a", "panda"))


@requires("robots")
@pytest.mark.parametrize("name", ARMS)
def test_an_arm_of_the_extra_moves_as_pinocchio_says_and_follows_its_tool(robots: Path, name: str) -> None:
    tool, joints = ARMS[name]
    arm = load_arm(describe_robot(robots / name, tool))
    assert arm.n == joints
    assert arm.geometry.ngeoms >= joints
    forward, rng = symbolic_forward(arm), np.random.default_rng(0)
    lower, upper = np.maximum(arm.lower, -np.pi), np.minimum(arm.upper, np.pi)
    for _ in range(5):
        q = rng.uniform(lower + 0.1, upper - 0.1)
        np.testing.assert_allclose(np.array(forward(q)), arm.matrix(q), atol=1e-12, rtol=0)
        near = np.clip(q + 0.02 * rng.standard_normal(arm.n), lower, upper)
        reached = next_pose(arm, arm.matrix(near), q, np.zeros(arm.n), (arm.lower, arm.upper))
        np.testing.assert_allclose(arm.matrix(reached.q), arm.matrix(near), atol=1e-4)
