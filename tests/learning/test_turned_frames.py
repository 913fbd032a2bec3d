"""Where the axes of the base frame point does not matter: the same recording, turned, gets the same answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from planted import JOINTS, TRAVEL, Noise, moving_then_held, recorded
from planted_parts import cabinet, recorded_parts
from scipy.spatial.transform import Rotation

from micah_plan.learning.learn import learn_graph
from micah_plan.learning.parts.carriers import carriers, moves_far
from micah_plan.learning.roughness import extent
from micah_plan.learning.segmenting.noise_fit import initial_noise
from micah_plan.learning.segmenting.steps import activity_of
from micah_plan.learning.settings import LearnSettings
from micah_plan.learning.small_motions import small_motions
from micah_plan.learning.track import find_inliers, part_track
from micah_plan.recording.read import read_recording
from micah_plan.recording.value import Recording

FRAMES = list(Rotation.random(24, rng=np.random.default_rng(5)))
SAME_AT_LEAST = 23


def turned(recording: Recording, frame: Rotation) -> Recording:
    """The same rows as a base frame with other axes has them."""
    quaternion, action = recording.quaternion, recording.action
    if action is not None:
        known = np.isfinite(action).all(axis=1)
        action = np.where(known[:, None], frame.apply(np.where(known[:, None], action, 0.0)), np.nan)
    return replace(
        recording,
        position=frame.apply(recording.position.copy()),
        quaternion=None if quaternion is None else (frame * Rotation.from_quat(quaternion)).as_quat(),
        action=action,
    )


def shut(orientation: bool, seed: int = 0) -> Recording:
    """A door that is pressed on once it is shut, seen by a tracker whose error is larger along one axis."""
    rng = np.random.default_rng(seed)
    c = moving_then_held("revolute", 60, 30)
    step = np.append(np.diff(c), 0.0)
    step[step == 0] = TRAVEL["revolute"] / 60
    clean = recorded([(JOINTS["revolute"], c)], rng, commanded=[step], orientation=orientation)
    return replace(clean, position=clean.position + 0.002 * rng.standard_normal((90, 3)) * [0.2, 0.5, 2.0])


def wandering(orientation: bool) -> Recording:
    """A drawer under a tracker that wanders."""
    rng = np.random.default_rng(1)
    error = rng.standard_normal((140, 3))
    for row in range(1, 140):
        error[row] = 0.9 * error[row - 1] + 0.44 * error[row]
    c = np.linspace(0.0, TRAVEL["prismatic"], 140)
    clean = recorded([(JOINTS["prismatic"], c)], rng, Noise(2e-4, 2e-3), orientation=orientation)
    return replace(clean, position=clean.position + 0.002 * error)


def resting(orientation: bool) -> Recording:
    """A part that nobody moves, a jump of the tracker among its rows."""
    still = recorded([(JOINTS["prismatic"], np.zeros(100))], np.random.default_rng(2), orientation=orientation)
    position = still.position.copy()
    position[40] += 0.2
    return replace(still, position=position)


def answer(recording: Recording) -> list[tuple[str, bool]]:
    segments = learn_graph(recording).edges[0].segments
    return [(one.joint.kind, one.certainty.no_single_joint is None) for one in segments]


def assert_same_in_turned_frames(recording: Recording, frames: list[Rotation]) -> None:
    expected = answer(recording)
    same = sum(answer(turned(recording, frame)) == expected for frame in frames)
    assert same >= len(frames) - (len(FRAMES) - SAME_AT_LEAST), f"{same} of {len(frames)}"


@pytest.mark.evidence
@pytest.mark.parametrize(
    ("draw", "orientation"),
    [(wandering, False), *(pytest.param(one, True, marks=pytest.mark.slow) for one in (shut, resting))],
)
def test_simulated_kinds_are_the_same_in_every_frame(draw: Callable[[bool], Recording], orientation: bool) -> None:
    assert_same_in_turned_frames(draw(orientation), FRAMES)


@pytest.mark.slow
@pytest.mark.parametrize("orientation", [True, False])
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.evidence) for seed in (2, 3, 4))])
def test_a_door_is_shut_at_the_same_row_in_every_frame(seed: int, orientation: bool) -> None:
    rows = [
        [one.start for one in learn_graph(turned(shut(orientation, seed), frame)).edges[0].segments]
        for frame in [Rotation.identity(), *FRAMES[:8]]
    ]
    assert all(one == rows[0] for one in rows)


@pytest.mark.evidence
@pytest.mark.parametrize("name", ["microwave_with_grasp", "drawer_no_grasp", "stapler"])
def test_measured_demonstrations_are_the_same_in_every_frame(shared_data: Path, name: str) -> None:
    recording = read_recording(shared_data / "demonstrations" / f"{name}.csv")
    assert_same_in_turned_frames(recording, FRAMES)
    assert_same_in_turned_frames(replace(recording, action=None), FRAMES)


@pytest.mark.evidence
@pytest.mark.parametrize("name", ["cabinet_one/002", "drawer_one/004", "iros_2010/left_door/004", "kitchen/M2U00390"])
def test_measured_tracks_are_the_same_in_every_frame(shared_data: Path, name: str) -> None:
    assert_same_in_turned_frames(read_recording(shared_data / "tracks" / f"{name}.csv"), FRAMES)


def test_what_comes_before_the_joints_is_the_same_in_every_frame() -> None:
    recording, settings = resting(orientation=True), LearnSettings()
    track = part_track(recording, 0, recording.parts[0])
    noise = initial_noise(track, settings)
    parts = recorded_parts(cabinet(), 0)
    for frame in FRAMES:
        other = part_track(turned(recording, frame), 0, recording.parts[0])
        np.testing.assert_array_equal(find_inliers(other), find_inliers(track))
        np.testing.assert_allclose(initial_noise(other, settings).white, noise.white)
        activity = activity_of(track, np.arange(len(track)))
        turned_activity = activity_of(other, np.arange(len(other)))
        np.testing.assert_array_equal(turned_activity.rows, activity.rows)
        assert turned_activity.sweeps == pytest.approx(activity.sweeps)
        assert carriers(turned(parts, frame)) == carriers(parts)
        assert moves_far(turned(recording, frame)) == moves_far(recording)
        assert small_motions(turned(recording, frame), settings) == small_motions(recording, settings)


def test_an_extent_is_the_distance_of_the_ends_of_a_path_and_blind_to_a_few_points() -> None:
    line = np.linspace(0, 1, 50)[:, None] * [3.0, 4.0, 0.0]
    assert extent(line) == pytest.approx(5.0)
    line[20] = [9.0, 9.0, 9.0]
    assert extent(line, 0.05) == pytest.approx(5.0, rel=0.05)
    assert extent(np.zeros((0, 3))) == 0.0
