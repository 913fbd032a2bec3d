"""What an arm cannot do is cut out of planning: plans elsewhere are found, and what is impossible is told as that."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from robot_examples import arm7
from scipy.spatial.transform import RigidTransform

from micah_plan.automaton.hybrid import Primitive
from micah_plan.documents.problem import load_problem
from micah_plan.planning.solver import solve
from micah_plan.robot.clearance import clearance_model
from micah_plan.task.body import Body

PROBLEMS = Path(__file__).resolve().parents[2] / "problems"
STAPLER, BOX = PROBLEMS / "stapler_on_books.yaml", PROBLEMS / "box_under_bar.yaml"


def test_outside_of_an_overlap_nothing_meets() -> None:
    """What a box around link and body leaves free is free: distances at random places of the tool, turned as it is."""
    arm, rng, met = arm7(), np.random.default_rng(0), 0
    for q in arm.sample(rng, 20):
        place = arm.matrix(q)[:3, 3] + rng.uniform(-0.05, 0.05, 3)
        quaternion = rng.normal(size=4)
        turned = tuple((quaternion / np.linalg.norm(quaternion)).tolist())
        body = Body("shelf", (Primitive("box", (0.2, 0.1, 0.05)),), position=tuple(place.tolist()), quaternion=turned)
        model = clearance_model(arm, [body])
        distances = model.distances(q, {})
        for pair in {model.names[k] for k in np.flatnonzero(distances < 0.0) if "shelf" in model.names[k]}:
            model.distances(q, {})
            overlap = model.overlap(pair)
            if not overlap:  # the posture counts, too
                continue
            met += 1
            tools = np.tile(arm.matrix(q), (40, 1, 1))
            tools[1:, :3, 3] += rng.normal(0.0, 0.1, (39, 3))
            apart = model.tool_distances(pair, RigidTransform.from_matrix(tools)).min(axis=1)
            assert apart[0] == pytest.approx(
                min(distances[k] for k, n in enumerate(model.names) if n == pair), abs=1e-6
            )
            sides, most = np.array([side for side, _ in overlap]), np.array([room for _, room in overlap])
            beyond = (tools[:, :3, 3] @ sides.T - most).max(axis=1)
            assert beyond[0] < 0.0
            assert np.all(apart >= beyond - 1e-6)
    assert met >= 10


@pytest.mark.slow
def test_a_goal_where_the_hand_meets_the_shelf_is_called_impossible() -> None:
    refused = solve(load_problem(STAPLER, {"goal.target.x.value": 0.5}), advise=False)
    assert refused.outcome == "no_plan"
    assert refused.reason.startswith("wherever in the goal the hand is, flange meets shelf")


@pytest.mark.slow
def test_what_the_fingers_do_not_let_the_hand_put_down_is_not_planned() -> None:
    """Deep on the plinth they meet it in all of the goal; less deep, in the part that plans then stay out of."""
    refused = solve(load_problem(BOX, {"goal.target.x.value": 0.5}), advise=False)
    assert refused.outcome == "no_plan"
    assert refused.reason.startswith("wherever in the goal the hand sets the object down, left_finger meets plinth")
    tolerant = load_problem(BOX, {"goal.target.x": {"value": 0.47, "tolerance": 0.025}})
    plan = solve(tolerant, advise=False)
    assert plan.outcome == "solved", plan.reason
    assert plan.release is not None
    assert plan.trajectory is not None
    assert plan.trajectory.means[-1, 0] < 0.46


@pytest.mark.slow
@pytest.mark.parametrize("seed", [pytest.param(0, marks=pytest.mark.evidence), 1])
def test_where_a_part_of_the_goal_is_free_the_plan_ends_there(seed: int) -> None:
    tolerant = load_problem(STAPLER, {"goal.target.x": {"value": 0.48, "tolerance": 0.02}})
    plan = solve(tolerant, seed=seed, advise=False)
    assert plan.outcome == "solved", plan.reason
    assert plan.arm is not None
    assert plan.trajectory is not None
    assert plan.trajectory.means[-1, 0] < 0.475
    assert plan.arm.limit_margin is not None
    assert plan.arm.limit_margin >= 0.02 - 1e-9


@pytest.mark.slow
def test_an_object_that_is_almost_shut_is_pressed_and_placed() -> None:
    """The hand is planned lower than the shut object lets it get: the arm goes where the object stops it."""
    plan = solve(load_problem(STAPLER, {"start.mean.theta": 0.55, "start.std.theta": 0.03}), advise=False)
    assert plan.outcome == "solved", plan.reason
