"""The action channel of a demonstration, applied to another recording of the same hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from micah_plan.api.learning import learn
from micah_plan.automaton.effects.add import for_demonstrations, with_learned_channel
from micah_plan.documents.model import load_model
from micah_plan.errors import InputError
from micah_plan.recording.value import Recording
from micah_plan.residual.prediction import predict_recording, rmse


def demonstration(seed, reach):
    """A hinged handle 0.3 m from its axis, moved by a hand that writes its actions 1.5 times too large, and turned."""
    rng, rows = np.random.default_rng(seed), 60
    angle = reach * (1.0 - np.cos(np.linspace(0.0, np.pi, rows))) / 2.0
    place = 0.3 * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    meant = np.vstack([np.diff(place, axis=0), np.full((1, 3), np.nan)])
    written = 1.5 * Rotation.from_rotvec([0.0, 0.0, -0.4]).apply(meant)
    turned = Rotation.from_rotvec(angle[:, None] * [0.0, 0.0, 1.0] + 0.01 * rng.standard_normal((rows, 3)))
    return Recording(
        time=0.1 * np.arange(rows),
        position=place + 0.002 * rng.standard_normal((rows, 3)),
        quaternion=turned.as_quat(),
        action=written + 0.0003 * rng.standard_normal((rows, 3)),
        run=np.zeros(rows, dtype=int),
        part=("part",) * rows,
    )


def test_another_recording_of_the_same_hand_is_predicted_as_learned() -> None:
    model = learn(demonstration(0, 1.2)).automaton
    other = demonstration(1, 0.9)
    plain = rmse([run.rollout.configuration for run in predict_recording(model, other)])
    as_learned = for_demonstrations(model, other)
    assert [effect.name for effect in as_learned.effects] == ["frame_rotation", "gain", "delay"]
    channel = rmse([run.rollout.configuration for run in predict_recording(as_learned, other)])
    assert plain > 0.1
    assert channel < 0.3 * plain


def test_a_model_made_by_hand_has_no_channel(repository) -> None:
    slot = load_model(repository / "models" / "slot.yaml")
    with pytest.raises(InputError, match="no action channel"):
        with_learned_channel(slot, 0.1)
