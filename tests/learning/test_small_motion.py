"""Motions about as small as the wander that a tracker is granted are told of, with the setting that decides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planted import JOINTS, Noise, recorded

from micah_plan.api.learning import learn
from micah_plan.learning.settings import LearnSettings
from micah_plan.learning.small_motions import small_motions
from micah_plan.recording.read import read_recording
from micah_plan.recording.value import Recording

FINE = LearnSettings(position_wander=0.0005, rotation_wander=0.005)


def slide(size: float, noise: float = 2e-4, orientation: bool = True) -> Recording:
    """A drawer that is pulled by so many metres and then held."""
    c = np.concatenate([np.linspace(0.0, size, 70), np.full(40, size)])
    quiet = Noise(noise, 10 * noise)
    return recorded([(JOINTS["prismatic"], c)], np.random.default_rng(1), quiet, orientation=orientation)


@pytest.mark.parametrize("orientation", [True, False])
def test_a_slide_of_a_centimetre_names_the_setting(orientation: bool) -> None:
    (line,) = small_motions(slide(0.01, orientation=orientation), LearnSettings())
    assert "LearnSettings.position_wander (0.004 m)" in line
    assert ("rotation_wander" in line) == orientation
    assert small_motions(slide(0.01, orientation=orientation), FINE) == ()


@pytest.mark.parametrize("size", [0.06, 0.3])
def test_larger_motions_are_not_suspected(size: float) -> None:
    assert small_motions(slide(size), LearnSettings()) == ()


@pytest.mark.parametrize("noise", [5e-5, 1e-3, 5e-3])
def test_what_does_not_move_is_not_suspected(noise: float) -> None:
    for seed in range(5):
        still = recorded([(JOINTS["prismatic"], np.zeros(100))], np.random.default_rng(seed), Noise(noise, 0.01))
        assert small_motions(still, LearnSettings()) == ()


def test_each_part_is_judged_by_the_run_that_moves_it_most() -> None:
    small, large = slide(0.01), slide(0.3)
    both = Recording(
        time=np.concatenate([small.time, large.time]),
        position=np.concatenate([small.position, large.position]),
        quaternion=np.concatenate([small.quaternion, large.quaternion]),  # type: ignore[list-item]
        run=np.repeat([0, 1], len(small)),
        part=("drawer",) * (2 * len(small)),
    )
    assert small_motions(both, LearnSettings()) == ()
    apart = replace(both, run=np.zeros(len(both), dtype=np.int64), part=("a",) * len(small) + ("b",) * len(large))
    assert len(small_motions(apart, LearnSettings())) == 1


def test_learning_passes_the_warning_on() -> None:
    assert any("position_wander" in line for line in learn(slide(0.01)).warnings)


def test_shared_demonstrations_and_tracks_are_large_enough(shared_data) -> None:
    for folder in ("demonstrations", "tracks"):
        for file in sorted((shared_data / folder).rglob("*.csv")):
            assert small_motions(read_recording(file), LearnSettings()) == (), file.name
