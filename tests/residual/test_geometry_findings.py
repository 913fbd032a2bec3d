"""A wrong axis is found under a tracker that wanders, and the wandering itself is not taken for one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import planted_effects as plants
import pytest

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.joint import revolute
from micah_plan.automaton.tracks import tracks
from micah_plan.residual import calibrate as calibration
from micah_plan.residual.geometry import geometry_findings, transverse_rms

SWING = revolute((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (plants.RADIUS, 0.0, 0.1))
SEEDS = range(20)


@pytest.fixture
def door():
    """Swings from 0 to 1.2 rad."""
    end = plants.LENGTH
    only = Segment(SWING, 0, 0, 99, 0.0, end, (0.0, end), 0.001, 0.003, 0.0, 1.0)
    return build_automaton(KinematicGraph((KinematicEdge(BASE, "door", (only,)),)))


def wandering(rng, rows, size, memory=0.98):
    """A tracker's slow error [m]: a first-order autoregression of this standard deviation."""
    error = np.zeros(rows)
    error[0] = size * rng.standard_normal()
    for k in range(1, rows):
        error[k] = memory * error[k - 1] + size * np.sqrt(1 - memory**2) * rng.standard_normal()
    return error


def opened_once(seed, *, rows=100, size=0.004, lift=lambda c: 0.0 * c):
    """One slow opening by a hand, measured by a wandering tracker; lift(c) is what the door rises [m]."""
    rng = np.random.default_rng(seed)
    c = np.linspace(0.0, plants.LENGTH, rows)
    u = np.diff(c, append=c[-1])
    recording = plants.door_recording([(c + 0.001 * rng.standard_normal(rows), u)])
    error = np.stack([wandering(rng, rows, size) for _ in range(3)], axis=1)
    error[:, 2] += lift(c)
    return replace(recording, position=recording.position + error)


def found_and_scatter(door, recording):
    """Names found, and the scatter beside the joints before and after they are taken in [m]."""
    found = geometry_findings(door, tracks(door, recording))
    better = with_effect(door, *(one.effect for one in found))
    before, after = (transverse_rms(model, tracks(model, recording))[0] for model in (door, better))
    return [one.effect.name for one in found], before, after


@pytest.mark.slow
def test_a_tracker_that_wanders_is_no_screw(door) -> None:
    named = 0
    for seed in SEEDS:
        names, before, after = found_and_scatter(door, opened_once(seed))
        named += len(names)
        assert not names or after < before
    assert named <= 1


@pytest.mark.slow
def test_a_trend_that_only_a_constant_makes_fit_is_not_named(door) -> None:
    """Poses that wander from one side of the joint to it ask for another place of the joint, not for a pitch."""
    for seed in SEEDS:
        names, _, _ = found_and_scatter(door, opened_once(seed, size=0.0005, lift=lambda c: 0.012 - 0.010 * c))
        assert "screw_pitch" not in names


def test_a_real_pitch_is_found_under_a_wandering_tracker(door) -> None:
    for seed in range(5):
        recording = opened_once(seed, size=0.001, lift=lambda c: 0.03 * c)
        (found,) = geometry_findings(door, tracks(door, recording))
        assert found.effect.name == "screw_pitch"
        assert found.effect.values[0] == pytest.approx(0.03, abs=4 * found.std[0] + 0.001)
        names, before, after = found_and_scatter(door, recording)
        assert names == ["screw_pitch"]
        assert after < 0.5 * before


def test_a_displaced_axis_is_found_in_noise_of_its_size(door) -> None:
    """What the moved axis bends the path by, about its mean, is as large as the scatter of the poses."""
    noise = 0.01
    recording = plants.door_recording(
        plants.runs_of(plants.honest, 8, 40, 1, noise=noise),
        across=plants.RADIUS * noise,
        seed=1,
        shape=plants.off_axis,
    )
    (found,) = geometry_findings(door, tracks(door, recording))
    assert found.effect.name == "axis_offset"
    for value, std, truth in zip(found.effect.values, found.std, (0.0, -0.015), strict=True):
        assert value == pytest.approx(truth, abs=3 * std)
        assert std < 0.001


@pytest.mark.sweep
@pytest.mark.parametrize("most_rows", [20_000, 40])
def test_position_errors_before_and_after_a_pitch_are_reported(door, monkeypatch, most_rows) -> None:
    """Also where only some of the runs are looked at."""
    recording = plants.door_recording(plants.runs_of(plants.honest, 4, 20, 3))
    lifted = recording.position.copy()
    lifted[:, 2] += 0.03 * np.arctan2(lifted[:, 1], lifted[:, 0])
    monkeypatch.setattr(calibration, "MOST_ROWS", most_rows)
    found = calibration.calibrate(door, replace(recording, position=lifted))
    assert found.effects[0].effect.name == "screw_pitch"
    assert found.effects[0].effect.values[0] == pytest.approx(0.03, abs=1e-3)
    assert found.after.one_step < 0.5 * found.before.one_step
