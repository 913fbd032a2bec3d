"""The blocks scene, robot and grasp of a problem file, and the arm's trajectory in a plan file."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from attempts import told

from micah_plan.automaton.hybrid import HybridAutomaton, Primitive
from micah_plan.documents.model import dump_model
from micah_plan.documents.plan import load_plan, plan_text, write_plan
from micah_plan.documents.problem import load_problem
from micah_plan.errors import InputError
from micah_plan.task.body import Body, Hull
from micah_plan.task.plan import ArmTrajectory, Plan, Trajectory
from micah_plan.task.problem import Problem
from micah_plan.task.robot_description import Grasp, RobotDescription

TEXT = """\
format: micah-plan/problem/1
model: door.yaml
start: {mean: {door: 0.0}, std: {door: 0.03}}
goal: {target: {door: {value: 1.2, tolerance: 0.03}}}
scene:
  table:
    shapes:
      - {kind: box, size: [1, 2, 0.1], position: [0, 0, -0.05], color: "#102030"}
      - {kind: cylinder, size: [0.1, 0.5]}
    position: [0.5, 0, 0]
  stone:
    shapes:
      - {kind: mesh, path: meshes/stone.obj, scale: [0.1, 0.1, 0.1], quaternion: [0, 0, 0.6, 0.8]}
robot:
  path: arm.urdf
  tool: hand
  position: [0, 1, 0]
  held: {finger: 0.01}
  rest: {elbow: -1.5}
  packages: {pkg: some/where}
  srdf: arm.srdf
grasp:
  part: door
  position: [0, 0.05, 0]
  quaternion: [0.5, 0.5, 0.5, 0.5]
"""
STONE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nv 0.2 0.2 0.2\n"


@pytest.fixture
def folder(door: HybridAutomaton, tmp_path: Path) -> Path:
    dump_model(door, tmp_path / "door.yaml")
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "stone.obj").write_text(STONE)
    (tmp_path / "arm.urdf").write_text("<robot/>")
    (tmp_path / "arm.srdf").write_text("<robot name='s'/>")
    (tmp_path / "p.yaml").write_text(TEXT)
    return tmp_path


def test_the_blocks_become_values(folder: Path) -> None:
    problem = load_problem(folder / "p.yaml")
    corners = {(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1)}
    table, stone = problem.scene
    assert table == Body(
        "table",
        (Primitive("box", (1.0, 2.0, 0.1), (0.0, 0.0, -0.05), color="#102030"), Primitive("cylinder", (0.1, 0.5))),
        (0.5, 0.0, 0.0),
    )
    (hull,) = stone.shapes
    assert isinstance(hull, Hull)
    assert set(hull.vertices) == corners
    assert hull.quaternion == (0.0, 0.0, 0.6, 0.8)
    assert problem.robot == RobotDescription(
        "arm.urdf",
        "<robot/>",
        "hand",
        (0.0, 1.0, 0.0),
        locked=(("finger", 0.01),),
        rest=(("elbow", -1.5),),
        packages=(("pkg", "some/where"),),
        srdf="<robot></robot>",
    )
    assert problem.robot.folder == problem.robot.root == str(folder)
    assert problem.grasp == Grasp("door", (0.0, 0.05, 0.0), (0.5, 0.5, 0.5, 0.5))
    assert set(problem.digests) == {"problem", "model", "robot"}


def test_of_an_srdf_only_the_pairs_are_taken(folder: Path) -> None:
    pair = '<disable_collisions link1="a" link2="b"'
    (folder / "arm.srdf").write_text(f"<robot name='s'><group name='secret'/>{pair} reason='never'/>text</robot>")
    robot = load_problem(folder / "p.yaml").robot
    assert robot is not None
    assert robot.srdf == f"<robot>{pair}></disable_collisions></robot>"
    (folder / "arm.srdf").write_text("<keys><key>secret</key></keys>")
    assert "expected an SRDF with the root <robot>, found <keys>" in told(load_problem, folder / "p.yaml")


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "size: [1, 2, 0.1]",
            "size: [1, 2]",
            "line 8, column 21, key 'scene.table.shapes.0.size': expected 3 sizes of a box",
        ),
        ("size: [0.1, 0.5]", "radius: 1", "line 9, column 26, key 'scene.table.shapes.1.radius': unknown key 'radius'"),
        (
            "{kind: cylinder, size: [0.1, 0.5]}",
            "{kind: sphere}",
            "line 9, column 9, key 'scene.table.shapes.1': missing",
        ),
        ("kind: box", "kind: boxx", "did you mean 'box'?"),
        ("kind: box", "kind: mesh", "expected either 'path' or 'vertices' of a mesh"),
        (
            "scale: [0.1, 0.1, 0.1]",
            "size: [1]",
            "line 13, column 46, key 'scene.stone.shapes.0.size': a mesh has no size",
        ),
        ("path: meshes/stone.obj", "path: ../stone.obj", "leaves its folder"),
        ("path: meshes/stone.obj", "path: /etc/passwd", "expected a relative path"),
        ("path: meshes/stone.obj", "path: meshes/no.obj", "key 'scene.stone.shapes.0.path': there is no file"),
        ("path: meshes/stone.obj", "path: arm.urdf", "expected an .stl or .obj mesh"),
        ("path: meshes/stone.obj", "vertices: [[0, 0, 0], [1, 0, 0]]", "at least four corners"),
        ("scale: [0.1, 0.1, 0.1]", "scale: [0.1, 0, 0.1]", "that span a volume"),
        ("quaternion: [0, 0, 0.6, 0.8]", "quaternion: [0, 0, 1, 1]", "expected unit length, found length 1.41421"),
        ("path: arm.urdf", "path: no.urdf", "line 15, column 3, key 'robot.path'"),
        ("srdf: arm.srdf", "srdf: no.srdf", "line 21, column 3, key 'robot.srdf'"),
        ("tool: hand", "tol: hand", "line 16, column 3, key 'robot.tol': unknown key 'tol'"),
        ("part: door", "part: dor", "line 23, column 3, key 'grasp.part': unknown part 'dor'; did you mean 'door'?"),
        (TEXT[TEXT.index("robot:") : TEXT.index("grasp:")], "", "key 'grasp': a grasp without a robot"),
        (TEXT[TEXT.index("grasp:") :], "", "key 'robot': a robot without a grasp"),
        ("  stone:\n", "  table:\n", "duplicate key 'table'"),
    ],
)
def test_mistakes_are_reported_with_line_and_key(folder: Path, old: str, new: str, expected: str) -> None:
    assert old in TEXT
    (folder / "p.yaml").write_text(TEXT.replace(old, new, 1))
    assert expected in told(load_problem, folder / "p.yaml")


def planned(problem: Problem, change: dict[str, object] | None = None) -> Plan:
    trajectory = Trajectory(
        modes=("revolute", "revolute"),
        means=np.array([[0.0], [0.1]]),
        factors=np.full((2, 1, 1), 0.01),
        inputs=np.full((1, 1), 0.1),
        gains=np.zeros((1, 1, 1)),
        is_transition=np.zeros(1, dtype=bool),
    )
    arm = ArmTrajectory(
        joints=("a", "b", "c"),
        positions=np.arange(6.0).reshape(2, 3) / 7,
        manipulability=np.array([0.1, 0.2]),
        clearance=(0.01, None),
        least_clearance=0.005,
        closest_pair=("hand", "table"),
        closest_knot=1,
        deviation=1e-3,
    )
    return Plan("not_verified", "found", trajectory, seed=problem.automaton.n, arm=replace(arm, **(change or {})))


def test_a_plan_carries_scene_robot_and_arm_without_further_files(folder: Path, tmp_path: Path) -> None:
    problem = load_problem(folder / "p.yaml")
    plan = planned(problem)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    write_plan(plan, problem, elsewhere / "plan.json")
    for file in (folder / "arm.urdf", folder / "arm.srdf", folder / "meshes" / "stone.obj"):
        file.unlink()
    stored = load_plan(elsewhere / "plan.json")
    assert replace(stored.problem, source=problem.source) == problem
    assert plan.arm is not None
    assert stored.plan.arm is not None
    for key, value in vars(plan.arm).items():
        assert np.array_equal(np.asarray(getattr(stored.plan.arm, key)), np.asarray(value)), key
    assert (
        plan_text(stored.plan, replace(stored.problem, source=problem.source)) == (elsewhere / "plan.json").read_text()
    )


def test_a_plan_without_a_robot_does_not_mention_one(folder: Path) -> None:
    (folder / "p.yaml").write_text(TEXT[: TEXT.index("scene:")])
    problem = load_problem(folder / "p.yaml")
    data = json.loads(plan_text(replace(planned(problem), arm=None), problem))
    assert {"scene", "robot", "grasp"}.isdisjoint(data["problem"])
    assert "arm" not in data


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"positions": np.zeros((1, 3))}, "expected 2 knots, found 1"),
        ({"positions": np.zeros((2, 4))}, "expected 3 joints, found 4"),
        ({"clearance": (0.1,)}, "expected 2 knots, found 1"),
        ({"closest_knot": 2}, "closest pair and knot are none of the plan"),
        ({"manipulability": np.array([0.1, np.nan])}, "not finite"),
    ],
)
def test_an_arm_that_does_not_agree_with_its_plan_is_not_written(folder: Path, change: dict, expected: str) -> None:
    problem = load_problem(folder / "p.yaml")
    with pytest.raises(InputError, match=expected):
        plan_text(planned(problem, change), problem)
