"""What one joint describes nearly: threads of a millimetre, tilts of a slide, waves; and the joints beside them."""

from __future__ import annotations

import numpy as np
import pytest
from planted import JOINTS, recorded
from scipy.spatial.transform import Rotation

from micah_plan.automaton.graph import Segment
from micah_plan.automaton.joint import screw
from micah_plan.automaton.kinematics import forward
from micah_plan.learning.learn import learn_graph
from micah_plan.learning.online import OnlineLearner
from micah_plan.learning.settings import LearnSettings
from micah_plan.recording.value import Recording

RATE = 18.0  # Hz


def seen(position: np.ndarray, rotation: Rotation | None, white: float, seed: int = 0) -> Recording:
    """Poses under white noise [m], of which rotations have six times as much [rad]."""
    rng, n = np.random.default_rng(seed), len(position)
    noisy = position + white * rng.standard_normal((n, 3))
    quaternion = None
    if rotation is not None:
        quaternion = (Rotation.from_rotvec(6 * white * rng.standard_normal((n, 3))) * rotation).as_quat()
    return Recording(np.arange(n) / RATE, noisy, quaternion)


def learned(recording: Recording) -> tuple[Segment, ...]:
    return learn_graph(recording).edges[0].segments


def kinds(recording: Recording) -> list[str]:
    return ["none" if one.certainty.no_single_joint is not None else one.joint.kind for one in learned(recording)]


def cap(pitch: float, turns: float, rows: int = 220) -> tuple[np.ndarray, Rotation]:
    """A cap whose mark lies 14 mm beside its axis."""
    joint = screw([0.1, 0.4, -0.9], [0.74, 0.97, -0.61], pitch / (2 * np.pi), [0.754, 0.97, -0.61])
    c = 2 * np.pi * turns * np.linspace(0, 1, rows)
    poses = forward(joint, c + 0.3 * np.sin(c / turns))
    return poses.translation, poses.rotation


@pytest.mark.slow
@pytest.mark.parametrize(("pitch", "turns"), [(0.003, 4.0), (0.002, 3.0), (0.005, 1.5)])
def test_the_thread_of_a_cap_is_separated_from_none(pitch: float, turns: float) -> None:
    (advances,) = learned(seen(*cap(pitch, turns), 0.0004))
    assert advances.joint.kind == "screw"
    assert advances.probability > 0.9
    assert abs(advances.joint.pitch) == pytest.approx(pitch / (2 * np.pi), rel=0.1)
    (turns_only,) = learned(seen(*cap(0.0, turns), 0.0004))
    assert turns_only.joint.kind == "revolute"
    assert turns_only.probability > 0.9


@pytest.mark.sweep
@pytest.mark.parametrize("seed", range(4))
def test_a_hinge_that_hardly_turns_or_is_seen_badly_is_no_screw(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arc = rng.uniform(0.2, 1.5)
    door = recorded([(JOINTS["revolute"], np.linspace(0.0, arc, 90))], rng)
    assert [one.joint.kind for one in learned(door)] == ["revolute"]


def slide(tilt: float, passes: int, rows: int = 160) -> tuple[np.ndarray, Rotation]:
    """A part that goes 0.35 m straight on, and tilts meanwhile [deg]."""
    sweep = np.abs((passes * np.linspace(0, 1, rows) + 1.0) % 2.0 - 1.0)
    return np.outer(0.35 * sweep, [0.6, 0.8, 0.0]), Rotation.from_rotvec(
        np.outer(np.radians(tilt) * sweep, [0, 0.6, 0.8])
    )


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [18.0, 25.0, 38.0])
def test_a_slide_that_tilts_is_no_slide(tilt: float) -> None:
    assert kinds(seen(*slide(tilt, 3), 0.001)) == ["path"]
    (once,) = kinds(seen(*slide(tilt, 1), 0.001))
    assert once != "prismatic"
    assert kinds(seen(*slide(0.0, 3), 0.001)) == ["prismatic"]


def bent(corners: bool, rows: int = 126) -> np.ndarray:
    """One wave of 0.2 m; or three straight ways with corners between its turning points."""
    along = np.linspace(0.0, 0.6, rows)
    if corners:
        aside = np.interp(along, [0.0, 0.15, 0.45, 0.6], [0.0, 0.1, -0.1, 0.0])
    else:
        aside = 0.1 * np.sin(2 * np.pi * along / 0.6)
    return np.stack([aside, along, 0 * along], axis=1)


def test_a_wave_is_no_chain_of_joints_and_a_chain_of_slides_is() -> None:
    assert kinds(seen(bent(corners=False), None, 0.001)) == ["none"]
    assert kinds(seen(bent(corners=True), None, 0.001)) == ["prismatic"] * 3


@pytest.mark.slow
def test_a_stream_goes_on_after_rows_that_no_joint_holds() -> None:
    learner = OnlineLearner(LearnSettings(window=256, resolution=32), "champ")
    rows = seen(np.tile(bent(corners=False), (12, 1)) + np.outer(np.arange(12 * 126), [1e-3, 0, 1e-3]), None, 0.001)
    for start in range(0, len(rows), 100):
        now = slice(start, start + 100)
        learner.push(rows.time[now], rows.position[now])
    assert learner.segments()[-1].end == len(rows) - 1


@pytest.mark.sweep
@pytest.mark.parametrize(("height", "halves"), [(0.1, 1.5), (0.08, 2.0)])
def test_a_wave_that_two_hinges_follow_closely_is_no_chain_of_them_and_two_arcs_are(
    height: float, halves: float
) -> None:
    along = np.linspace(0.0, 0.6, 80)
    wave = np.stack([height * np.sin(np.pi * halves * along / 0.6), along, 0 * along], axis=1)
    assert kinds(seen(wave, None, 0.001)) == ["none"]
    # As high and as long, without a corner between: what tells them is how closely two hinges follow.
    angle = np.linspace(-1.2, 1.2, 40)
    radius = 0.3 / (2 * np.sin(1.2))
    arc = radius * np.stack([np.cos(angle) - np.cos(1.2), np.sin(angle) + np.sin(1.2), 0 * angle], axis=1)
    arcs = np.concatenate([arc, arc[-1] + arc[1:] * [-1.0, 1.0, 1.0]])
    assert kinds(seen(arcs, None, 0.001)) == ["revolute", "revolute"]
