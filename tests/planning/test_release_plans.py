"""Releases, planned: how an object comes to rest, where it can be released, and how a plan with it is kept."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from micah_plan.documents.plan import load_plan, write_plan
from micah_plan.documents.problem import load_problem
from micah_plan.errors import InputError
from micah_plan.planning.release import with_release
from micah_plan.planning.solver import solve
from micah_plan.planning.verification import verify
from micah_plan.task.deadline import NEVER
from micah_plan.task.release import pre_release_problem, resting_place

PROBLEMS = Path(__file__).resolve().parents[2] / "problems"
STAPLER, BOX = PROBLEMS / "stapler_on_books.yaml", PROBLEMS / "box_under_bar.yaml"


@cache
def solved(name: str):
    problem = load_problem(PROBLEMS / f"{name}.yaml")
    return problem, solve(problem)


def test_what_is_held_level_does_not_turn() -> None:
    rest = resting_place(load_problem(BOX))
    assert (rest.top, rest.touching) == pytest.approx((0.06, 0.03))
    np.testing.assert_allclose([*rest.turn, *rest.shift], 0.0, atol=1e-12)


@pytest.mark.sweep
@pytest.mark.parametrize("pitch", [-0.2, -0.05, 0.05, 0.2])
def test_what_is_held_pitched_turns_until_it_lies_flat(pitch: float) -> None:
    changes = {"hold.rotation": [0.0, pitch, 0.0], "goal.target.z.tolerance": 0.1}
    rest = resting_place(load_problem(STAPLER, changes))
    np.testing.assert_allclose(rest.turn, [0.0, -pitch, 0.0], atol=1e-9)
    assert rest.top + rest.touching + rest.shift[2] == pytest.approx(0.26)  # as high as one that was held level
    # The hand's point is 0.06 m above the lower side, 0.105 m and 0.055 m from its ends.
    end = -0.105 if pitch < 0 else 0.055
    assert rest.touching == pytest.approx(0.06 * np.cos(pitch) + end * np.sin(pitch))


def test_it_turns_about_the_fingers() -> None:
    problem = load_problem(STAPLER)
    rest, fingers = resting_place(problem), np.array(problem.grasp.position)
    moved = Rotation.from_rotvec(rest.turn).apply(-fingers) + fingers
    np.testing.assert_allclose(rest.shift[:2], moved[:2], atol=1e-12)


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"hold.rotation": [0.0, 0.6, 0.0]}, "it would tip over"),
        (
            {"goal.target.z.value": 0.288},
            "rests with the hand's point at z = 0.26 m, found 0.288; write 0.26",
        ),
        ({"goal.modes": ["free"]}, "only an object that has latched can be released"),
        ({"release.support": "lamp"}, "lamp"),
        ({"release.shift_std": 0.01}, "the release moves the object by more than the tolerance 0.01 m"),
        ({"hold.rotation": [0.3, 0.0, 0.0]}, "only with its hinge level"),
    ],
)
def test_what_cannot_be_let_go_is_refused_as_the_file_is_read(changes, words) -> None:
    with pytest.raises(InputError, match="release") as refused:
        load_problem(STAPLER, changes)
    assert words in str(refused.value)


def test_only_what_is_held_can_be_let_go() -> None:
    with pytest.raises(InputError, match="only what a hand holds can be released"):
        load_problem(PROBLEMS / "drawer_open.yaml", {"release": {"support": "table"}})


def test_before_it_lets_go_the_hand_is_above_the_support_by_what_is_not_known() -> None:
    problem = load_problem(STAPLER, {"release.support_std": 0.004})
    rest, goal = resting_place(problem), pre_release_problem(problem).goal
    (_, z, room), sigmas = goal.target[2], problem.settings.sigmas
    assert z - room == pytest.approx(rest.top + rest.touching + sigmas * 0.004)
    assert pre_release_problem(pre_release_problem(problem)) == pre_release_problem(problem)


@pytest.mark.slow
def test_the_plan_goes_down_and_away_along_a_free_path() -> None:
    problem, plan = solved("stapler_on_books")
    found = plan.release
    assert plan.outcome == "solved"
    down, away = found.lowering, found.withdrawing
    np.testing.assert_allclose(down.positions[0], plan.arm.positions[-1], atol=1e-6)
    assert np.abs(away.positions[0] - down.positions).max(axis=1).min() < 0.05
    assert np.linalg.norm(found.withdrawal.sum(axis=0)) == pytest.approx(problem.release.withdraw)
    assert min(down.least_clearance, away.least_clearance) >= 0.003
    np.testing.assert_allclose(found.rest[:3], [0.45, 0.0, 0.26], atol=2e-3)
    depth = found.steps * problem.release.step
    assert depth > plan.trajectory.means[-1][2] - (0.2 + resting_place(problem).touching)


def test_the_plan_file_holds_how_the_hand_lets_go(tmp_path: Path) -> None:
    problem, plan = solved("stapler_on_books")
    write_plan(plan, problem, tmp_path / "plan.json")
    stored = load_plan(tmp_path / "plan.json")
    assert stored.problem.release == problem.release
    assert stored.plan.release.steps == plan.release.steps
    np.testing.assert_array_equal(stored.plan.release.withdrawing.positions, plan.release.withdrawing.positions)
    np.testing.assert_array_equal(stored.plan.release.rest, plan.release.rest)


def test_a_support_that_may_be_anywhere_is_no_place_to_let_go() -> None:
    problem, plan = solved("stapler_on_books")
    unsure = replace(problem, robot=None, grasp=None, release=replace(problem.release, support_std=0.02))
    answer, _ = with_release(unsure, replace(plan, arm=None, release=None), NEVER)
    assert answer.outcome == "not_verified"
    assert "the support's height is known to 20 mm" in answer.reason
    assert answer.success_probability == pytest.approx(0.383 * plan.success_probability, rel=0.01)


def test_an_arm_without_a_gripper_that_opens_cannot_let_go() -> None:
    problem, plan = solved("stapler_on_books")
    with pytest.raises(InputError, match=r"release.fingers: a robot releases by joints that open its gripper"):
        with_release(replace(problem, release=replace(problem.release, fingers=())), plan, NEVER)


@pytest.mark.slow
def test_a_hand_without_an_arm_goes_up() -> None:
    problem = load_problem(STAPLER)
    problem = replace(problem, robot=None, grasp=None, release=replace(problem.release, fingers=()))
    plan = solve(problem)
    assert plan.outcome == "solved"
    assert (plan.release.withdrawal[:, 2] > 0).all()
    assert verify(problem, plan, 200).outcome == "solved"
