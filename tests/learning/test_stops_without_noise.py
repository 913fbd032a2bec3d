"""Poses without any noise, as simulators and encoders write them: a part that rests repeats to the last digit.

Of a tracker, equal readings are one reading that was held. Here they are rests, and some are stops.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_commanded_places import jumps, servo

from micah_plan.learning.learn import learn_graph
from micah_plan.recording.value import Recording

RADIUS, RATE, TRAVEL, TURNED = 0.3, 10.0, 1.1, Rotation.from_rotvec([0.4, -0.7, 0.2])
NEAR = 2  # rows


def pushed(kind: str, seed: int, *, noise: float = 0.0, oriented: bool = True) -> tuple[Recording, list[int]]:
    """A part that goes to its end and back to the other, at speeds that change, and is pushed against both.

    Returns:
        The recording, and the rows in which it arrives.
    """
    rng, c, configuration, asked, stops = np.random.default_rng(seed), 0.0, [0.0], [], []
    for sign in (1.0, -1.0):
        pace = np.exp(0.2 * rng.standard_normal(40))
        for step in (*(1.02 * TRAVEL * pace / pace.sum()), *np.full(25, TRAVEL / 40)):
            c = float(np.clip(c + sign * step, 0.0, TRAVEL))
            asked.append(sign * step)
            configuration.append(c)
        stops.append(len(configuration) - 1 - 25)
    angles = np.array(configuration)
    along = np.stack([-np.sin(angles), np.cos(angles), 0.0 * angles], axis=1)
    position = RADIUS * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    turn = np.outer(angles, [0.0, 0.0, 1.0])
    if kind == "prismatic":
        along, turn = np.tile([0.0, 1.0, 0.0], (len(angles), 1)), 0.0 * turn
        position = np.outer(RADIUS * angles, [0.0, 1.0, 0.0])
    action = RADIUS * np.append(asked, 0.0)[:, None] * along
    quaternion = (TURNED * Rotation.from_rotvec(turn)).as_quat() if oriented else None
    read = TURNED.apply(position) + noise * rng.standard_normal(position.shape)
    return Recording(np.arange(len(angles)) / RATE, read, quaternion, TURNED.apply(action)), stops


def segments(recording: Recording) -> list[tuple[str, int]]:
    (edge,) = learn_graph(recording).edges
    return [(segment.joint.kind, segment.start) for segment in edge.segments]


@pytest.mark.sweep
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize("noise", [0.0, 1e-6, 1e-3])
def test_a_stop_is_one_however_exact_its_poses_are(kind: str, seed: int, noise: float) -> None:
    recording, (first, last) = pushed(kind, seed, noise=noise)
    kinds, starts = zip(*segments(recording), strict=True)
    assert kinds == (kind, "rigid", kind, "rigid")
    assert abs(starts[1] - first) <= NEAR
    assert abs(starts[3] - last) <= NEAR


@pytest.mark.parametrize("digits", [3, 5])
def test_digits_that_a_file_leaves_out_take_no_stop(digits: int) -> None:
    recording, _ = pushed("revolute", 0)
    turns = np.round(recording.quaternion, digits)
    turns /= np.linalg.norm(turns, axis=1)[:, None]
    written = replace(recording, position=np.round(recording.position, digits), quaternion=turns)
    assert [kind for kind, _ in segments(written)] == ["revolute", "rigid", "revolute", "rigid"]


def test_without_orientation_too() -> None:
    recording, _ = pushed("revolute", 1, oriented=False)
    assert [kind for kind, _ in segments(recording)] == ["revolute", "rigid", "revolute", "rigid"]


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_of_two_parts_that_are_moved_one_after_the_other_too(seed: int) -> None:
    (door, _), (drawer, _) = pushed("revolute", seed), pushed("prismatic", seed + 10)
    n, none = len(door), np.zeros((len(door), 3))
    first, then = np.minimum(np.arange(2 * n), n - 1), np.maximum(np.arange(2 * n) - n, 0)
    both = Recording(
        np.repeat(np.arange(2 * n) / RATE, 2),
        np.stack([door.position[first], drawer.position[then] + [1.0, 0.0, 0.0]], axis=1).reshape(-1, 3),
        np.stack([door.quaternion[first], drawer.quaternion[then]], axis=1).reshape(-1, 4),
        np.stack([np.vstack([door.action, none]), np.vstack([none, drawer.action])], axis=1).reshape(-1, 3),
        part=("door", "drawer") * (2 * n),
        has_part=True,
    )
    kinds = {edge.child: [segment.joint.kind for segment in edge.segments] for edge in learn_graph(both).edges}
    assert kinds == {
        "door": ["revolute", "rigid", "revolute", "rigid"],
        "drawer": ["prismatic", "rigid", "prismatic", "rigid"],
    }


def test_a_tracker_that_holds_its_reading_on_the_way_shows_no_stop() -> None:
    """The first new reading makes up for them all."""
    recording, (first, _) = pushed("revolute", 2, noise=1e-3)
    rows = np.arange(first)
    rows[14:22] = 13
    held = replace(recording.rows(rows), time=recording.time[:first], action=recording.action[:first])
    assert [kind for kind, _ in segments(held)] == ["revolute"]


@pytest.mark.parametrize("seed", [0, 8])
def test_a_servo_that_is_where_it_was_sent_has_no_stop(seed: int) -> None:
    """Rests at many places, read exactly: one joint meets all of them, and nothing withstands it."""
    assert [kind for kind, _ in segments(servo(jumps(seed)))] == ["revolute"]
