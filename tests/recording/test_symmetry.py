"""Objects that look the same when they are turned: readings that jump to a likeness, and turns that are real."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from micah_plan.learning.learn import learn_graph
from micah_plan.recording.breaks import breaks
from micah_plan.recording.symmetry import detect_symmetry, turned_back, with_unified_orientations
from micah_plan.recording.value import Recording

ROWS, RADIUS, NOISE = 160, 0.45, 1e-3
TILTED = np.array([0.3, 0.5, 0.8]) / np.linalg.norm([0.3, 0.5, 0.8])
Z = np.array([0.0, 0.0, 1.0])
PIECES = {
    "from the middle on": slice(ROWS // 2, None),
    "the first rows": slice(0, 60),
    "there and back": slice(50, 100),
    "three pieces": np.r_[40:60, 80:100, 120:140],
    "row by row": np.random.default_rng(0).random(ROWS) < 0.4,
}


def swing(seed=0, noise=NOISE, end=1.2):
    """A door that is opened smoothly, with orientations of the handle."""
    rng, s = np.random.default_rng(seed), np.clip((np.arange(ROWS) - 0.1 * ROWS) / (0.8 * ROWS), 0.0, 1.0)
    angle = end * s * s * (3.0 - 2.0 * s)
    position = RADIUS * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    turn = Rotation.from_rotvec(np.outer(angle, Z)) * Rotation.from_euler("xyz", [0.1, 0.2, 0.3])
    turn = Rotation.from_rotvec(2.0 * noise * rng.standard_normal((ROWS, 3))) * turn
    return Recording(0.1 * np.arange(ROWS), position + noise * rng.standard_normal((ROWS, 3)), turn.as_quat())


def read_as_likeness(recording, rows, axis=Z, fold=2):
    """The same, some rows turned by a share of a whole turn in the part's frame."""
    quaternion = recording.quaternion.copy()
    turn = Rotation.from_rotvec(2.0 * np.pi / fold * np.asarray(axis))
    quaternion[rows] = (Rotation.from_quat(quaternion[rows]) * turn).as_quat()
    return replace(recording, quaternion=quaternion)


def missed(found, true):
    """Largest turn between two recordings [rad], beside one that is the same in all rows."""
    turn = Rotation.from_quat(found.quaternion).inv() * Rotation.from_quat(true.quaternion)
    return float((turn[0].inv() * turn).magnitude().max())


@pytest.mark.parametrize("rows", PIECES.values(), ids=list(PIECES))
@pytest.mark.parametrize("noise", [NOISE, 0.0])
@pytest.mark.parametrize("axis", [Z, -np.eye(3)[0], TILTED], ids=["z", "-x", "tilted"])
def test_half_turns_are_turned_back(rows, noise, axis) -> None:
    true = swing(noise=noise)
    found = with_unified_orientations(read_as_likeness(true, rows, axis))
    # Along an axis of the part's frame the turn is exact; of another one it is as well known as the jumps tell.
    assert missed(found, true) < (6.0 * noise + 1e-3 if axis is TILTED else 1e-9)


@pytest.mark.sweep
@pytest.mark.parametrize("fold", [4, 3, 6])
def test_smaller_turns_are_turned_back_if_they_come_again(fold) -> None:
    true = swing()
    found = with_unified_orientations(read_as_likeness(true, PIECES["three pieces"], TILTED, fold))
    assert missed(found, true) < 6.0 * NOISE
    once = read_as_likeness(true, PIECES["from the middle on"], TILTED, fold)
    assert with_unified_orientations(once) is once


@pytest.mark.parametrize("rows", [PIECES["there and back"], PIECES["row by row"]])
def test_one_hinge_is_learned_and_the_rows_are_reported(rows) -> None:
    recording = read_as_likeness(swing(), rows)
    ((segment,),) = (edge.segments for edge in learn_graph(recording).edges)
    assert segment.joint.kind == "revolute"
    np.testing.assert_allclose(np.abs(segment.joint.axis), Z, atol=0.005)
    (line,) = breaks(recording)
    assert "turned by 180°" in line
    assert "--positions-only" in line


@pytest.mark.parametrize("change", ["switch", "valve", "jump of the place", "noise", "short"])
def test_other_jumps_are_left(change) -> None:
    recording = swing()
    if change == "switch":  # flips by 0.6 rad there and back again, about an axis through its origin
        recording = read_as_likeness(recording, PIECES["three pieces"], Z, 2.0 * np.pi / 0.6)
    elif change == "valve":  # a quarter turn within a row, once
        recording = read_as_likeness(recording, PIECES["from the middle on"], Z, 4)
    elif change == "jump of the place":
        recording = read_as_likeness(recording, PIECES["from the middle on"])
        place = recording.position.copy()
        place[ROWS // 2 :] += 0.2
        recording = replace(recording, position=place)
    elif change == "noise":
        recording = swing(noise=0.2)
    else:
        few = np.arange(ROWS // 2 - 3, ROWS // 2 + 3)
        recording = read_as_likeness(recording, PIECES["from the middle on"]).rows(few)
    assert with_unified_orientations(recording) is recording


def test_runs_that_begin_with_another_likeness_are_read_alike() -> None:
    runs = [swing(seed) for seed in range(3)]
    runs[1] = read_as_likeness(runs[1], slice(None))
    runs[2] = read_as_likeness(runs[2], slice(0, 30))
    rows = {name: np.concatenate([getattr(run, name) for run in runs]) for name in ("time", "position", "quaternion")}
    recording = Recording(**rows, run=np.repeat([1, 2, 3], ROWS), has_run=True)
    (edge,) = learn_graph(recording).edges
    assert {segment.joint.kind for segment in edge.segments} == {"revolute"}
    for segment in edge.segments:
        np.testing.assert_allclose(np.abs(segment.joint.axis), Z, atol=0.005)
    lines = breaks(recording)
    assert [line.split(":")[0] for line in lines] == ["run 2", "run 3"]


def test_a_run_that_is_mostly_read_the_other_way_reports_those_rows() -> None:
    """Within the run most rows are the likeness, but the run before says which is meant: only they are turned back."""
    first, second = swing(0), read_as_likeness(swing(1), slice(0, 100))
    columns = {
        name: np.concatenate([getattr(run, name) for run in (first, second)])
        for name in ("time", "position", "quaternion")
    }
    recording = Recording(**columns, run=np.repeat([1, 2], ROWS), has_run=True)
    found, (turned,) = turned_back(recording)
    assert (turned.run, turned.part) == (2, "part")
    np.testing.assert_array_equal(turned.rows, ROWS + np.arange(100))
    assert missed(found.select(run=2), swing(1)) < 1e-9


def test_symmetry_has_its_turn() -> None:
    recording = read_as_likeness(swing(), PIECES["three pieces"], Z, 4)
    symmetry, turns = detect_symmetry(recording.position, recording.quaternion)
    assert symmetry.fold == 4
    np.testing.assert_array_equal(np.abs(symmetry.axis), Z)
    assert set(turns[PIECES["three pieces"]].tolist()) <= {1, 3}
    assert not turns[:40].any()
