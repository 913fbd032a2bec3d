"""Act-CHAMP with actions that were recorded in another frame, scaled and late."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planted import JOINTS, TRAVEL, Noise, recorded
from scipy.spatial.transform import Rotation

from micah_plan.automaton.certainty import CHANNEL_NAMES
from micah_plan.automaton.graph import KinematicEdge
from micah_plan.learning.learn import learn_graph
from micah_plan.recording.value import Recording

ROWS, PUSHED, RATE = 130, 90, 18.0


def late_push(kind: str, delay_rows: int, turn: Rotation, gain: float, seed: int) -> Recording:
    """A part that follows the hand `delay_rows` later until it stops; the hand goes on pushing."""
    rng = np.random.default_rng(seed)
    speed = np.clip(1 + 0.5 * np.sin(np.arange(ROWS) / 6.0) + 0.3 * np.sin(np.arange(ROWS) / 2.3), 0.1, None)
    asked = np.cumsum(speed)
    asked *= TRAVEL[kind] / asked[PUSHED]
    c = np.concatenate([np.zeros(delay_rows), asked[: ROWS - delay_rows]])
    c = np.minimum(c, TRAVEL[kind])
    commanded = np.append(np.diff(asked), 0.0)
    recording = recorded([(JOINTS[kind], c)], rng, Noise(0.001, 0.006), commanded=[commanded])
    assert recording.action is not None
    return replace(recording, action=turn.inv().apply(np.nan_to_num(recording.action)) / gain)


def learned(recording: Recording, method: str) -> KinematicEdge:
    return learn_graph(recording, method=method).edges[0]  # type: ignore[arg-type]


@pytest.mark.sweep
@pytest.mark.parametrize("kind", ["prismatic", "revolute"])
@pytest.mark.parametrize("seed", range(2))
def test_a_late_turned_and_scaled_channel_is_reported_and_does_not_fool_the_segments(kind: str, seed: int) -> None:
    turn, gain, delay = Rotation.from_rotvec([0.3, -0.2, 0.5]), 0.6, 5
    edge = learned(late_push(kind, delay, turn, gain, seed), "act-champ")
    assert [segment.joint.kind for segment in edge.segments] == [kind, "rigid"]
    assert abs(edge.changepoints[0] - (PUSHED + delay)) <= 3
    assert edge.certainty is not None
    channel = edge.certainty.channel
    assert channel is not None
    std = dict(zip(CHANNEL_NAMES, np.sqrt(np.diag(np.array(channel.covariance))), strict=True))
    assert abs(channel.delay - delay / RATE) < max(4 * std["delay"], 0.5 / RATE)
    assert abs(channel.gain - gain) < max(4 * std["gain"], 0.1)
    assert channel.explained > 0.7


def test_poses_alone_have_no_channel() -> None:
    recording = late_push("prismatic", 0, Rotation.identity(), 1.0, 0)
    for edge in (learned(recording, "champ"), learned(replace(recording, action=None), "act-champ")):
        assert edge.certainty is not None
        assert edge.certainty.channel is None
