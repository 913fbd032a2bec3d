"""Which rows are measurements of one continuous motion: planted losses, flips, exchanges, repeats and new starts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from micah_plan.learning.learn import learn_graph
from micah_plan.message import codes_of
from micah_plan.recording.breaks import breaks
from micah_plan.recording.continuity import continuity_of, stretches
from micah_plan.recording.value import Recording

ROWS, RADIUS, NOISE = 120, 0.45, 0.0008
UNKNOWN = np.array([[0.3, -0.2, 0.1]])
OFFSET = np.array([0.05, -0.06, 0.02])


def swing(angle, seed=0, noise=NOISE, **columns):
    """A handle 0.45 m from a vertical hinge at angles (n,), measured with noise."""
    rng = np.random.default_rng(seed)
    position = np.stack([1.0 + RADIUS * np.cos(angle), 0.3 + RADIUS * np.sin(angle), 0.5 + 0 * angle], axis=1)
    turn = Rotation.from_rotvec(np.outer(angle, [0.0, 0.0, 1.0])) * Rotation.from_euler("xyz", [0.1, 0.2, 0.3])
    turn = Rotation.from_rotvec(2.0 * noise * rng.standard_normal((len(angle), 3))) * turn
    position = position + noise * rng.standard_normal(position.shape)
    columns = {"position": position, "quaternion": turn.as_quat(), **columns}
    return Recording(time=columns.pop("time", 0.05 * np.arange(len(angle))), **columns)


def angles(rows=ROWS, end=1.2):
    """Rest, a smooth swing, rest."""
    s = np.clip((np.arange(rows) - 0.1 * rows) / (0.8 * rows), 0.0, 1.0)
    return end * s * s * (3.0 - 2.0 * s)


def changed(recording, rows, position=None, turn=None):
    """The recording with other poses in some rows."""
    place, quaternion = recording.position.copy(), recording.quaternion.copy()
    if position is not None:
        place[rows] = position(place[rows])
    if turn is not None:
        quaternion[rows] = (turn * Rotation.from_quat(quaternion[rows])).as_quat()
    return Recording(recording.time, place, quaternion, recording.action)


def lost(recording, rows, to=0.0):
    """Zeros and the unit quaternion, as trackers write them that see nothing."""
    place, quaternion = recording.position.copy(), recording.quaternion.copy()
    place[rows], quaternion[rows] = to, (0.0, 0.0, 0.0, 1.0)
    return Recording(recording.time, place, quaternion, recording.action)


def left_out(recording):
    return stretches(~continuity_of(recording).is_measured)


@pytest.mark.sweep
@pytest.mark.parametrize(
    "rows", [slice(0, 8), slice(0, 1), slice(50, 58), slice(70, 71), slice(105, ROWS), slice(ROWS - 1, ROWS)]
)
def test_rows_of_a_lost_tracker_are_left_out_and_reported(rows) -> None:
    recording = lost(swing(angles()), rows)
    assert left_out(recording) == [(rows.start, rows.stop - 1)]
    (line,) = breaks(recording)
    assert f"rows {rows.start} to {rows.stop - 1}" in line or f"row {rows.start} (" in line
    (edge,) = learn_graph(recording).edges
    (segment,) = edge.segments
    assert segment.joint.kind == "revolute"
    assert np.hypot(*(np.array(segment.joint.center[:2]) - [1.0, 0.3])) < 0.004


@pytest.mark.parametrize("rows", [(30, 31), (60, 66), (40, 58)])
@pytest.mark.parametrize("turn", [(np.pi, 0.0, 0.0), (0.0, 0.7, 0.2)])
def test_a_tag_that_flips_and_comes_back_is_left_out(rows, turn) -> None:
    recording = changed(swing(angles()), slice(*rows), turn=Rotation.from_rotvec(turn))
    assert left_out(recording) == [(rows[0], rows[1] - 1)]


def test_rows_that_repeat_the_last_pose_are_no_measurements() -> None:
    recording = swing(angles())
    place, quaternion = recording.position.copy(), recording.quaternion.copy()
    place[51:75], quaternion[51:75] = place[50], quaternion[50]
    frozen = Recording(recording.time, place, quaternion)
    assert left_out(frozen) == [(51, 74)]
    assert "the pose of row 50" in breaks(frozen)[0]
    (segment,) = learn_graph(frozen).edges[0].segments
    assert segment.joint.kind == "revolute"


@pytest.mark.parametrize("each", [2, 3, 5])
def test_a_tracker_slower_than_its_log_is_measured_where_its_pose_is_new(each) -> None:
    recording = swing(angles(240))
    held = np.arange(240) // each * each
    slow = Recording(recording.time, recording.position[held], recording.quaternion[held])
    assert np.array_equal(continuity_of(slow).is_measured, np.arange(240) % each == 0)


def quantised(recording, grid):
    return Recording(recording.time, np.round(recording.position / grid) * grid, recording.quaternion)


def with_turns_on_a_grid(recording, degrees=2.0, turn=(0.0, 0.0, 0.0)):
    """Read to 4 mm and to some degrees, and written as quaternions, which then lie on no grid."""
    read = Rotation.from_quat(recording.quaternion).as_euler("xyz", degrees=True)
    turns = Rotation.from_euler("xyz", degrees * np.round(read / degrees), degrees=True)
    frame = Rotation.from_rotvec(turn)
    place = frame.apply(np.array(quantised(recording, 0.004).position))
    return Recording(recording.time, place, (frame * turns).as_quat(), recording.action)


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.3, -0.5, 0.2)])
def test_readings_to_whole_degrees_at_rest_are_measurements_and_those_of_a_lost_tracker_are_not(turn) -> None:
    recording = swing(np.concatenate([angles(), np.full(60, 1.2)]), noise=4e-4)
    coarse = with_turns_on_a_grid(recording, turn=turn)
    equal = (coarse.position[1:] == coarse.position[:-1]).all(axis=1)
    equal &= (coarse.quaternion[1:] == coarse.quaternion[:-1]).all(axis=1)
    assert equal[125:].sum() > 20
    assert continuity_of(coarse).is_measured.all()
    # Positions on the same grid, but turns to all digits: those do not stay by themselves.
    held = np.arange(180)
    held[61:80] = 60
    lost_for_a_while = Recording(recording.time, coarse.position[held], recording.quaternion[held])
    assert left_out(lost_for_a_while) == [(61, 79)]


@pytest.mark.parametrize(
    "recording",
    [
        swing(angles(), noise=0.0),  # at rest without noise all rows are equal
        Recording(0.05 * np.arange(ROWS), np.round(swing(angles(), noise=2e-4).position, 3)),  # coarser than its noise
        Recording(0.05 * np.arange(ROWS), np.tile(UNKNOWN, (ROWS, 1))),  # never moves
        swing(np.where(np.arange(30) < 15, 0.0, 0.04 * (np.arange(30) - 14)), noise=0.0),  # starts at full speed
        swing(np.array([0.0, 0.0, 0.0, 0.1, 0.4, 0.7, 0.8, 0.8, 0.8, 0.8])),  # in few rows
        swing(np.zeros(ROWS)),  # noise alone
        swing(angles(), noise=0.02),  # much noise
        swing(0.6 * np.sin(0.5 * np.arange(ROWS))),  # fast, to and fro
        swing(angles(), time=np.where(np.arange(ROWS) < 60, 0.05, 0.08) * np.arange(ROWS)),  # another rate
        swing(np.delete(angles(), np.r_[40:70]), time=np.delete(0.05 * np.arange(ROWS), np.r_[40:70])),  # a gap
    ],
    ids=["exact", "coarse", "still", "at_once", "few_rows", "noise", "rough", "fast", "rates", "gap"],
)
def test_all_rows_of_an_honest_track_are_measured(recording) -> None:
    found = continuity_of(recording)
    assert found.is_measured.all()
    assert not found.jumps
    assert breaks(recording) == ()


def test_a_blow_that_an_action_commands_is_no_jump() -> None:
    c = np.where(np.arange(60) < 30, 0.0, 0.5)
    recording = swing(c)
    asked = np.zeros((60, 3))
    asked[:-1] = np.diff(swing(c, noise=0.0).position, axis=0)
    told = Recording(recording.time, recording.position, None, asked)
    assert not continuity_of(told).jumps
    assert continuity_of(Recording(recording.time, recording.position)).jumps


@pytest.mark.parametrize("row", [25, 70, 95])
def test_a_tracker_restart_is_reported(row) -> None:
    recording = changed(swing(angles()), slice(row, None), lambda p: p + OFFSET, Rotation.from_rotvec([0.0, 0.2, 0.15]))
    found = continuity_of(recording)
    assert found.is_measured.all()
    (jump,) = found.jumps
    assert jump.row == row
    assert jump.distance == pytest.approx(np.linalg.norm(OFFSET), abs=0.03)
    assert codes_of(breaks(recording)) == ["jumps"]


def test_a_part_that_moves_on_while_rows_are_missing_keeps_them_all() -> None:
    c = np.delete(angles(), np.r_[45:60])  # without a gap in the time stamps
    found = continuity_of(swing(c))
    assert found.is_measured.all()
    assert [jump.row for jump in found.jumps] == [45]


def test_two_bodies_that_are_exchanged_are_named() -> None:
    door, drawer = swing(angles()), swing(np.zeros(ROWS), seed=1)
    slide = drawer.position - 8.0 * UNKNOWN + np.outer(angles(end=0.3), [0.8, -0.6, 0.0])
    place, turn = [door.position.copy(), slide.copy()], [door.quaternion.copy(), drawer.quaternion.copy()]
    for values in (place, turn):
        values[0][50:65], values[1][50:65] = values[1][50:65].copy(), values[0][50:65].copy()
    both = Recording(
        np.tile(door.time, 2), np.concatenate(place), np.concatenate(turn), part=("door",) * ROWS + ("drawer",) * ROWS,
        has_part=True,
    )  # fmt: skip
    (line,) = breaks(both)
    assert "'door' and part 'drawer' are exchanged in rows 50 to 64" in line
    kinds = {edge.child: [s.joint.kind for s in edge.segments if s.joint.moves] for edge in learn_graph(both).edges}
    assert kinds == {"door": ["revolute"], "drawer": ["prismatic"]}


@pytest.mark.parametrize("rows", [0, 1, 2, 7])
def test_few_rows_are_all_measured(rows) -> None:
    recording = swing(np.linspace(0.0, 1.0, rows))
    assert continuity_of(recording).is_measured.shape == (rows,)
    assert continuity_of(recording).is_measured.all()


def test_the_answer_does_not_depend_on_the_frame_or_the_clock() -> None:
    recording = lost(swing(angles()), slice(50, 56), to=UNKNOWN)
    turn = Rotation.from_rotvec([0.4, -1.0, 2.0])
    other = Recording(
        3.0 + 20.0 * recording.time,
        turn.apply(np.array(recording.position)) + UNKNOWN,
        (turn * Rotation.from_quat(recording.quaternion)).as_quat(),
    )
    assert left_out(other) == left_out(recording) == [(50, 55)]


@pytest.mark.parametrize("what", ["position", "quaternion", "shuffled"])
def test_positions_that_jump_in_every_row_are_reported_as_noise(what) -> None:
    recording, rng = swing(angles()), np.random.default_rng(3)
    columns = {"position": recording.position, "quaternion": recording.quaternion}
    if what == "position":
        columns["position"] = rng.standard_normal((ROWS, 3))
    elif what == "quaternion":
        columns["quaternion"] = Rotation.random(ROWS, rng=rng).as_quat()
    else:
        order = rng.permutation(ROWS)
        columns = {name: values[order] for name, values in columns.items()}
    assert any("is this noise" in line for line in breaks(Recording(recording.time, **columns)))


@pytest.mark.parametrize("noise", [0.005, 0.015])
def test_a_part_at_rest_under_noise_is_not(noise) -> None:
    assert breaks(swing(np.zeros(ROWS), noise=noise)) == ()


def test_parts_that_are_exchanged_twice_are_named_twice_and_one_that_is_lost_is_not() -> None:
    places = [swing(0.0 * angles(), seed=k).position + 3.0 * k * UNKNOWN for k in range(3)]
    places[2][80:86] = 0.0
    for rows in (slice(30, 38), slice(60, 66)):
        places[0][rows], places[1][rows] = places[1][rows].copy(), places[0][rows].copy()
    together = Recording(
        np.tile(0.05 * np.arange(ROWS), 3),
        np.concatenate(places),
        part=tuple(name for name in "abc" for _ in range(ROWS)),
        has_part=True,
    )
    lines = breaks(together)
    assert ["are exchanged" in line for line in lines] == [True, True, False]
    assert "part 'c' is" in lines[2]
