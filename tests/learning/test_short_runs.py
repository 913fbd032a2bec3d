"""Runs of a few rows are demonstrations of the same object: they share its joint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from micah_plan.automaton.joint import Joint, prismatic, revolute
from micah_plan.automaton.kinematics import forward
from micah_plan.learning.learn import learn_graph
from micah_plan.recording.value import Recording

HINGE = revolute((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (0.3, 0.0, 0.4))
SLIDE = prismatic((0.6, 0.8, 0.0), (0.3, 0.1, 0.7))
QUICK = [0.0, 0.1, 0.11, 0.11, 0.11, 0.11, 0.11, 0.11, 0.11, 0.11]  # two steps and a rest, as a planner moves a drawer


def recorded(joint: Joint, courses: list[np.ndarray], acted: bool, rng: np.random.Generator) -> Recording:
    """Runs of a joint at these configurations, 0.3 mm and 1 mrad of noise."""
    poses = [forward(joint, c) for c in courses]
    position = np.vstack([p.translation for p in poses])
    turns = rng.normal(0, 1e-3, (len(position), 3))
    quaternion = np.vstack([p.rotation.as_quat() for p in poses])
    quaternion[:, :3] += 0.5 * turns
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    action = None
    if acted:
        steps = [np.vstack([np.diff(p.translation, axis=0), np.full((1, 3), np.nan)]) for p in poses]
        action = np.vstack(steps) * 1.1
    return Recording(
        time=np.concatenate([np.arange(len(c)) * 0.1 for c in courses]),
        position=position + rng.normal(0, 3e-4, position.shape),
        quaternion=quaternion,
        action=action,
        run=np.repeat(np.arange(1, len(courses) + 1), [len(c) for c in courses]),
    )


@pytest.mark.parametrize("acted", [False, True])
def test_runs_with_two_moving_rows_share_the_drawer_that_none_of_them_shows(acted: bool) -> None:
    quick = np.array(QUICK)
    courses = [quick, 0.11 + 0.5 * quick, 0.165 - quick, 0.055 + 0.8 * quick, 0.143 - 1.3 * quick]
    recording = recorded(SLIDE, courses, acted, np.random.default_rng(2))
    segments = learn_graph(recording).edges[0].segments
    assert [(one.run, one.start, one.end) for one in segments] == [(i + 1, 10 * i, 10 * i + 9) for i in range(5)]
    assert {one.joint.kind for one in segments} == {"prismatic"}
    assert len({one.joint for one in segments}) == 1
    assert abs(np.dot(segments[0].joint.axis, SLIDE.axis)) > 0.999
    for one, course in zip(segments, courses, strict=True):
        assert one.configuration_start == pytest.approx(course[0], abs=2e-3)
        assert one.configuration_end == pytest.approx(course[-1], abs=2e-3)


@pytest.mark.sweep
@pytest.mark.parametrize("pushed", [False, True])
def test_short_runs_against_one_stop_share_the_hinge_and_end_rigid(pushed: bool) -> None:
    shut = np.concatenate([np.linspace(0.0, 0.8, 18), np.full(10, 0.8)])
    recording = recorded(HINGE, [shut, shut, shut], pushed, np.random.default_rng(3))
    if recording.action is not None:
        action = recording.action.copy()
        for run in range(3):  # the hand goes on pushing
            action[28 * run + 17 : 28 * run + 27] = action[28 * run + 16]
        recording = replace(recording, action=action)
    segments = learn_graph(recording).edges[0].segments
    assert [(one.run, one.joint.kind) for one in segments] == [
        (run, kind) for run in (1, 2, 3) for kind in ("revolute", "rigid")
    ]
    assert [one.start for one in segments if one.joint.kind == "rigid"] == pytest.approx([18, 46, 74], abs=1)
    hinges = [one.joint for one in segments if one.joint.kind == "revolute"]
    for one in hinges[1:]:
        assert one.axis == pytest.approx(hinges[0].axis, abs=1e-9)
        assert one.center == pytest.approx(hinges[0].center, abs=1e-9)


def test_runs_of_an_object_that_does_not_move_stay_rigid() -> None:
    recording = recorded(SLIDE, [np.zeros(12)] * 3, False, np.random.default_rng(3))
    still = replace(recording, position=np.repeat(recording.position[:1], 36, axis=0), quaternion=None)
    segments = learn_graph(still).edges[0].segments
    assert [(one.run, one.joint.kind) for one in segments] == [(1, "rigid"), (2, "rigid"), (3, "rigid")]
