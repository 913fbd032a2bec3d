"""A scene constrains every plan: what slides keeps clear of it also where no hand is modelled."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from micah_plan.automaton.hybrid import Primitive
from micah_plan.documents.problem import load_problem
from micah_plan.planning.around_bodies import unchecked_parts_warning, with_scene
from micah_plan.planning.roll_outs import draw_chances, roll_out
from micah_plan.planning.solver import solve
from micah_plan.task.body import Body
from micah_plan.task.problem import Problem

MODEL = """\
format: micah-plan/model/1
coordinates: {x: m, y: m, z: m}
inputs: {x: m, y: m, z: m}
links:
  - {parent: base, child: gantry, coordinate: x}
  - {parent: gantry, child: carriage, coordinate: y}
  - {parent: carriage, child: jar, coordinate: z}
parts:
  jar: {shapes: [{kind: box, size: [0.08, 0.08, 0.12]}]}
noise: {process_std: {x: 0.001, y: 0.001, z: 0.001}, observation_std: {x: 0.003, y: 0.003, z: 0.003}}
modes:
  held:
    joints:
      gantry: {kind: prismatic, position: [0, 0, 0], axis: [1, 0, 0]}
      carriage: {kind: prismatic, position: [0, 0, 0], axis: [0, 1, 0]}
      jar: {kind: prismatic, position: [0, 0, 0], axis: [0, 0, 1]}
    step: {x: input x, y: input y, z: input z}
    invariant: [x >= -0.5, x <= 0.5, y >= -0.5, y <= 0.5, z >= 0.06, z <= 0.8]
transitions: []
"""
PROBLEM = """\
format: micah-plan/problem/1
model: model.yaml
start: {mean: {x: 0.25, y: 0.0, z: 0.6}, std: {x: 0.003, y: 0.003, z: 0.003}}
goal: {target: {x: {value: 0.25, tolerance: 0.02}, z: {value: 0.1, tolerance: 0.02}}}
planner: {max_step: {x: 0.05, y: 0.05, z: 0.05}}
scene:
  board: {shapes: [{kind: box, size: [0.4, 0.6, 0.03]}], position: [0.25, 0.0, 0.34]}
"""
HALF = np.array([0.04, 0.04, 0.06])


@pytest.fixture
def problem(tmp_path: Path) -> Problem:
    (tmp_path / "model.yaml").write_text(MODEL, encoding="utf-8")
    (tmp_path / "problem.yaml").write_text(PROBLEM, encoding="utf-8")
    return load_problem(tmp_path / "problem.yaml")


def clearance(problem: Problem, places: np.ndarray) -> float:
    """The least distance, along the axes of the body, between the jar's box and the first body of the scene [m]."""
    (body, *_) = problem.scene
    half = np.array(body.shapes[0].size) / 2
    turned = Rotation.from_quat(body.quaternion).as_matrix()
    apart = np.abs((places - np.array(body.position)) @ turned) - half - np.abs(turned.T) @ HALF
    return float(apart.max(axis=-1).min())


def along(means: np.ndarray) -> np.ndarray:
    """Places between the knots, too."""
    return np.concatenate([a + np.linspace(0, 1, 11)[:, None] * (b - a) for a, b in pairwise(means)])


@pytest.mark.sweep
@pytest.mark.parametrize("turned", [0.0, 0.4])
def test_what_slides_goes_around_a_body(problem: Problem, turned: float) -> None:
    body = replace(problem.scene[0], quaternion=tuple(Rotation.from_euler("z", turned).as_quat().tolist()))
    problem = replace(problem, scene=(body,))
    found = solve(problem)
    assert found.outcome == "solved", found.reason
    assert clearance(problem, along(found.trajectory.means)) > 0.0
    assert found.warnings == ()
    alone = solve(replace(problem, scene=()))
    assert clearance(problem, along(alone.trajectory.means)) < 0.0


def test_roll_outs_that_hit_a_body_fail(problem: Problem) -> None:
    blind = solve(replace(problem, scene=()))
    walled = with_scene(problem)
    ends = roll_out(walled, blind.trajectory, draw_chances(walled, blind.trajectory, 50, 0))
    assert {walled.automaton.modes[int(mode)].name for mode in ends.modes} == {"collided"}


def test_a_goal_inside_a_body_has_no_plan(problem: Problem) -> None:
    wide = (Primitive("box", (0.4, 1.2, 0.03)),)
    inside = replace(problem.scene[0], shapes=wide, position=(0.25, 0.0, 0.1))
    assert solve(replace(problem, scene=(inside,)), advise=False).outcome != "solved"


def test_what_it_stands_on_at_the_start_is_no_obstacle(problem: Problem) -> None:
    shelf = Body("stand", (Primitive("box", (0.3, 0.3, 0.1)),), (0.25, 0.0, 0.49))
    with_stand = replace(problem, scene=(*problem.scene, shelf))
    assert solve(with_stand).outcome == "solved"


def test_a_body_that_is_never_met_changes_nothing(problem: Problem) -> None:
    far = replace(problem, scene=(replace(problem.scene[0], position=(0.25, 3.0, 0.34)),))
    assert solve(far).cost == pytest.approx(solve(replace(problem, scene=())).cost, rel=1e-4)
    assert with_scene(replace(problem, scene=())) == replace(problem, scene=())


def test_parts_that_turn_are_named(repository: Path) -> None:
    door = load_problem(repository / "problems" / "microwave_close.yaml")
    body = Body("shelf", (Primitive("box", (0.3, 0.3, 0.1)),), (0.0, 0.0, 0.49))
    (line,) = unchecked_parts_warning(replace(door, scene=(body,)))
    assert "'door'" in line
    assert unchecked_parts_warning(door) == ()
