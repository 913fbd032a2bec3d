"""Ends that are only how far a demonstration went, and rows that are missing from a log."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import planted_effects as plants
import pytest

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.effects.ends import range_of
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.joint import revolute
from micah_plan.message import codes_of
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.compared_runs import sections
from micah_plan.residual.prediction import predict_recording, rmse
from micah_plan.residual.range_exceeded import ranges_exceeded

HALF = 0.5 * plants.LENGTH


def seen_up_to(end):
    """The door as a demonstration up to `end` teaches it: nothing holds it there."""
    swing = revolute((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (plants.RADIUS, 0.0, 0.1))
    segment = Segment(swing, 0, 0, 9, 0.0, end, (0.0, end), 0.001, 0.003, 0.0, 1.0)
    return build_automaton(KinematicGraph((KinematicEdge(BASE, "door", (segment,)),)))


def recording(plant=plants.honest, seed=3, **hand):
    return plants.door_recording(plants.runs_of(plant, 6, 50, seed, **hand), across=0.001, seed=seed)


def test_the_other_half_of_a_door_is_not_outside_of_a_model_that_saw_one_half():
    model, log = seen_up_to(HALF), recording()
    runs = predict_recording(model, log)
    assert rmse([run.one_step.configuration for run in runs]) < 2.0 * np.sqrt(2.0) * 0.003
    found = calibrate(model, log)
    assert found.verdict == "none"
    assert range_of(found.automaton, 0)[1] == pytest.approx(plants.LENGTH, abs=0.1)
    assert "range_exceeded" in codes_of(found.notes)


@pytest.mark.sweep
@pytest.mark.parametrize("beyond", [0.001, 0.01, 0.3])
def test_a_run_may_start_beyond_the_demonstrated_range(beyond):
    """An encoder's count or a hand's breadth: the range is how far a demonstration went."""
    log = recording()
    start = min(float(run.x[0, 0]) for run in predict_recording(seen_up_to(plants.LENGTH), log))
    swing = revolute((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (plants.RADIUS, 0.0, 0.1))
    low = start + beyond
    segment = Segment(swing, 0, 0, 9, low, plants.LENGTH, (low, plants.LENGTH), 1e-4, 3e-4, 0.0, 1.0)
    model = build_automaton(KinematicGraph((KinematicEdge(BASE, "door", (segment,)),)))
    runs = predict_recording(model, log)
    assert rmse([run.one_step.configuration for run in runs]) < 2.0 * np.sqrt(2.0) * 0.003


@pytest.mark.slow
def test_a_stop_beyond_the_end_that_was_seen_is_that_end_moved():
    model, log = seen_up_to(0.9 * plants.LENGTH), recording(goals=(0.4, 1.6))
    (only,) = calibrate(model, log).effects
    assert only.effect.name == "guard_shift"
    assert only.effect.values[0] == pytest.approx(0.1 * plants.LENGTH, abs=0.01)
    assert only.interval[0][0] < only.effect.values[0] < only.interval[0][1]


@pytest.mark.evidence
def test_readings_that_go_beyond_an_end_need_not_mean_that_it_is_elsewhere():
    """A sensor that reads too much at both ends: one effect, and not a gain with a moved end beside it."""
    model, log = seen_up_to(plants.LENGTH), recording(plants.stretched, goals=(-0.3, 1.6))
    found = calibrate(model, log)
    (only,) = found.effects
    assert only.effect.name == "sensor_scale"
    assert only.effect.values[0] == pytest.approx(1.1, abs=0.01)
    assert range_of(found.automaton, 0) == pytest.approx((0.0, plants.LENGTH))


def test_rows_a_hair_beyond_the_end_move_no_end(door):
    log = recording(goals=(-1.0, 2.0))
    runs = predict_recording(door, log)
    assert not ranges_exceeded(door, [run.x for run in runs])
    # An end takes nothing of a command that leads away from it: errors there are those of the noise.
    assert rmse([run.one_step.configuration for run in runs]) < 1.2 * np.sqrt(2.0) * 0.003


def test_a_tracker_that_is_frozen_over_a_gap_does_not_raise_the_floors(door):
    """The rows after the gap repeat the one before it: roll-outs begin where something is measured."""
    log = recording()
    kept = np.ones(len(log), dtype=bool)
    position, quaternion = log.position.copy(), log.quaternion.copy()
    for run in log.runs:
        rows = log.index(run=run)
        kept[rows[20:26]] = False
        position[rows[26:29]], quaternion[rows[26:29]] = position[rows[19]], quaternion[rows[19]]
    frozen = replace(log, position=position, quaternion=quaternion).rows(kept)
    found, whole = calibrate(door, frozen), calibrate(door, log)
    assert found.verdict == "none"
    assert 0.5 * whole.noise_floor < found.noise_floor < 2.0 * whole.noise_floor
    assert 0.5 * whole.rollout_floor < found.rollout_floor < 2.0 * whole.rollout_floor


@pytest.mark.parametrize("scale", [1e-3, 1.0, 60.0])
def test_gaps_are_found_in_any_unit_of_time_and_uneven_times_have_none(scale):
    rng = np.random.default_rng(0)
    even = np.delete(np.arange(60.0), [20, 21, 40]) * scale
    assert sections(even) == [(0, 20), (20, 38), (38, 57)]
    uneven = np.cumsum(rng.uniform(0.5, 1.5, 60)) * scale
    assert sections(uneven) == [(0, 60)]


@pytest.mark.slow
def test_missing_rows_are_reported_and_do_not_raise_the_floor(door):
    log = recording()
    rng = np.random.default_rng(1)
    kept = rng.random(len(log.time)) > 0.07
    fewer = log.rows(kept)
    whole, parts = (calibrate(door, one) for one in (log, fewer))
    assert parts.verdict == whole.verdict == "none"
    assert parts.noise_floor < 1.2 * whole.noise_floor
    assert "gaps_in_time" in codes_of(parts.notes)
    assert "gaps_in_time" not in codes_of(whole.notes)


def test_time_may_begin_anywhere(door):
    log = recording()
    later = replace(log, time=log.time + 1e4)
    first, second = (predict_recording(door, one)[0].rollout.configuration for one in (log, later))
    assert np.allclose(first, second)
