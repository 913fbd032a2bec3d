"""Joint trajectories along a path of the tool: exact, smooth, free and the same for the same seed; failures say why."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from robot_examples import arm7
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.automaton.hybrid import Part, Primitive
from micah_plan.errors import InputError
from micah_plan.robot.arm import Arm
from micah_plan.robot.clearance import ClearanceModel, clearance_model
from micah_plan.robot.inverse_kinematics import pose_error
from micah_plan.robot.posture import PostureWeights, posture_cost, posture_gradient
from micah_plan.robot.tool_path import ArmFailure, PathSettings, ToolPath, follow
from micah_plan.task.body import Body
from micah_plan.task.plan import ArmTrajectory

TABLE = Body("table", (Primitive("box", (1.2, 1.2, 0.02), (0.5, 0.0, -0.011)),))
BOOKS = Body("books", (Primitive("box", (0.2, 0.25, 0.2), (0.55, 0.3, 0.1)),))
STICK = Part("stick", (Primitive("box", (0.03, 0.16, 0.02), (0.0, 0.0, 0.02)),))
DOWN = Rotation.from_rotvec([np.pi, 0.0, 0.0])
KNOTS = 13


@pytest.fixture(scope="module")
def arm() -> Arm:
    return arm7()


@pytest.fixture(scope="module")
def model(arm: Arm) -> ClearanceModel:
    return clearance_model(arm, [TABLE, BOOKS], [STICK], ["stick"])


def line(start: tuple[float, ...], end: tuple[float, ...], knots: int = KNOTS) -> ToolPath:
    places = np.linspace(start, end, knots)
    tool = RigidTransform.from_components(places, Rotation.concatenate([DOWN] * knots))
    return ToolPath(tool, {"stick": tool})


def solved(found: ArmTrajectory | ArmFailure) -> ArmTrajectory:
    assert isinstance(found, ArmTrajectory), found
    return found


def failed(found: ArmTrajectory | ArmFailure) -> ArmFailure:
    assert isinstance(found, ArmFailure)
    return found


def test_the_tool_is_where_it_should_be_and_the_joints_keep_limits_steps_and_clearance(
    arm: Arm, model: ClearanceModel
) -> None:
    path = line((0.5, -0.3, 0.12), (0.55, 0.3, 0.3))
    found = solved(follow(model, path, seed=1))
    settings = PathSettings()
    for q, target in zip(found.positions, path.tool.as_matrix(), strict=True):
        assert np.abs(pose_error(target, arm.matrix(q))).max() < 1e-8
    assert np.all(found.positions >= arm.lower + settings.limit_margin)
    assert np.all(found.positions <= arm.upper - settings.limit_margin)
    assert np.abs(np.diff(found.positions, axis=0)).max() < 0.3
    np.testing.assert_allclose(found.manipulability, arm.manipulability(found.positions))
    assert found.manipulability.min() > settings.least_manipulability * arm.manipulability(arm.rest)[0]
    # An independent, dense check of the way that will be driven.
    dense = np.inf
    for before, after in zip(found.positions[:-1], found.positions[1:], strict=True):
        for share in np.linspace(0, 1, 8):
            q = before + share * (after - before)
            dense = min(dense, model.at(q, {"stick": arm.poses(q)[0]}).distance)
    assert found.least_clearance is not None
    assert settings.margin <= found.least_clearance <= dense + 1e-3
    assert found.deviation < 0.002
    assert found.joints == arm.joints


def test_the_same_seed_gives_the_same_trajectory(model: ClearanceModel) -> None:
    path = line((0.5, -0.2, 0.2), (0.5, 0.1, 0.3), 4)
    first, second = (solved(follow(model, path, seed=3)) for _ in range(2))
    assert np.array_equal(first.positions, second.positions)


def test_redundancy_is_used_to_stay_away_from_limits_and_findings(model: ClearanceModel) -> None:
    path = line((0.45, -0.35, 0.25), (0.45, 0.25, 0.35))
    lazy = PostureWeights(rest=0.0, limits=0.0, manipulability=0.0, clearance=0.0)
    settings = PathSettings(followed=1, enough=1, least_manipulability=0.0, margin=-1.0, limit_margin=0.0)
    costs = []
    for weights in (PostureWeights(), lazy):
        found = solved(follow(model, path, seed=2, settings=replace(settings, weights=weights)))
        costs.append(
            np.mean(
                [
                    posture_cost(model, q, path.at(k), frozenset(), PostureWeights())
                    for k, q in enumerate(found.positions)
                ]
            )
        )
    assert costs[0] < costs[1]


def test_the_gradient_of_the_posture_cost_is_its_difference(arm: Arm, model: ClearanceModel) -> None:
    weights, step = PostureWeights(), 1e-5
    for q in arm.sample(np.random.default_rng(8), 10):
        q = 0.6 * q + 0.4 * arm.rest

        def cost(row: np.ndarray) -> float:
            return posture_cost(model, row, {"stick": arm.poses(row)[0]}, frozenset(), weights)

        if model.at(q, {"stick": arm.poses(q)[0]}).distance < 1e-3:
            continue
        gradient = posture_gradient(model, q, {"stick": arm.poses(q)[0]}, frozenset(), weights)
        expected = [(cost(q + step * e) - cost(q - step * e)) / (2 * step) for e in np.eye(7)]
        np.testing.assert_allclose(gradient, expected, atol=0.02 * max(1.0, np.abs(expected).max()))


def test_a_pose_that_stays_is_held_still(model: ClearanceModel) -> None:
    tool = RigidTransform.from_components([[0.5, 0.0, 0.3]] * 3, Rotation.concatenate([DOWN] * 3))
    found = solved(follow(model, ToolPath(tool, {"stick": tool})))
    assert np.array_equal(found.positions[0], found.positions[2])


@pytest.mark.slow
def test_out_of_reach_is_reported_with_its_knot(model: ClearanceModel) -> None:
    found = failed(follow(model, line((0.5, 0.0, 0.3), (1.4, 0.0, 0.3))))
    assert found.kind in ("unreachable", "joint limit", "singularity")
    assert 3 <= found.knot <= 8
    assert f"at knot {found.knot}" in found.sentence
    far = failed(follow(model, line((3.0, 0.0, 0.3), (3.0, 0.0, 0.4))))
    assert far.knot == 0
    assert far.amount > 1.5


@pytest.mark.slow
def test_a_collision_is_reported_with_its_pair_and_may_be_allowed(model: ClearanceModel) -> None:
    path = line((0.5, -0.3, 0.12), (0.55, 0.3, 0.12))
    found = failed(follow(model, path))
    assert found.kind == "collision"
    assert found.names[1] == "books"
    lowered = line((0.5, -0.3, 0.028), (0.5, -0.1, 0.028), 5)
    blocked = failed(follow(model, lowered))
    assert blocked.names == ("stick", "table")
    allowed = [frozenset({("stick", "table")})] * 5
    through = solved(follow(model, ToolPath(lowered.tool, lowered.parts, allowed)))
    assert through.closest_pair != ("stick", "table")


@pytest.mark.slow
def test_a_limit_is_reported_with_its_joint(arm: Arm) -> None:
    turns = Rotation.from_rotvec(np.linspace([0.0, 0.0, 0.0], [0.0, 0.0, 2.9 * np.pi], 20)) * DOWN
    tool = RigidTransform.from_components(np.tile([0.5, 0.0, 0.35], (20, 1)), turns)
    found = failed(follow(clearance_model(arm), ToolPath(tool)))
    assert found.kind == "joint limit"
    assert set(found.names) <= set(arm.joints)
    assert f"at knot {found.knot}" in found.sentence


@pytest.mark.slow
def test_coarse_steps_are_jumps(model: ClearanceModel) -> None:
    found = failed(
        follow(model, line((0.45, -0.4, 0.35), (0.45, 0.4, 0.35), 2), settings=PathSettings(longest_step=0.1))
    )
    assert found.kind == "jump"
    assert found.amount > 0.1


def test_lengths_that_disagree_are_refused() -> None:
    path = line((0.5, 0.0, 0.3), (0.5, 0.1, 0.3), 3)
    with pytest.raises(InputError, match="same number of knots"):
        ToolPath(path.tool, {"stick": path.tool[:2]})
