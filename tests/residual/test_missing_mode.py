"""A mode that the automaton lacks is named with its place; what changes gradually is not taken for one."""

from __future__ import annotations

import numpy as np
import planted_effects as plants
import pytest
from scipy.signal import lfilter

from micah_plan.api.calibration import CalibrationResult
from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.joint import revolute
from micah_plan.automaton.tracks import tracks
from micah_plan.message import codes_of
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.coordinate_data import coordinate_data_of
from micah_plan.residual.missing_mode import missing_modes
from micah_plan.view.calibration_page import calibration_page

SWING = revolute((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (plants.RADIUS, 0.0, 0.1))
END = plants.LENGTH


@pytest.fixture(scope="module")
def door():
    """Swings from 0 to 1.2 rad, in one mode."""
    only = Segment(SWING, 0, 0, 99, 0.0, END, (0.0, END), 0.001, 0.003, 0.0, 1.0)
    return build_automaton(KinematicGraph((KinematicEdge(BASE, "door", (only,)),)))


def recorded(plant, seed, runs=8):
    moved = plants.runs_of(plant, runs, 50, seed, noise=0.002, disturbance=0.0007)
    return plants.door_recording(moved)


def told(door, plant, seed):
    """What the changepoints say of one-step errors, as if nothing else explained anything."""
    (data,) = coordinate_data_of(door, tracks(door, recorded(plant, seed)))
    errors = np.zeros_like(data.z)
    errors[:, 1:] = data.z[:, 1:] - np.clip(data.z + data.u, 0.0, END)[:, :-1]
    return missing_modes(data, errors, np.ones_like(errors), np.arange(len(data.run)) % 4)


@pytest.mark.parametrize("seed", range(3))
def test_motion_that_changes_at_a_place_is_a_mode(door, seed) -> None:
    (mode,) = told(door, plants.short_far_out, seed)
    assert mode.low == pytest.approx(0.5 * END, abs=0.05)
    assert mode.high == np.inf
    assert mode.gain == pytest.approx(0.75, abs=0.03)
    assert mode.evidence > 10


@pytest.mark.parametrize("plant", ["honest", "sprung", "rippled", "late"])
def test_what_changes_gradually_or_everywhere_is_none(door, plant) -> None:
    assert told(door, getattr(plants, plant), 1) == ()


def test_a_model_that_is_wrong_everywhere_and_by_much_lacks_no_mode(door) -> None:
    """Residuals of twenty times the noise are no bad rows."""
    moved = plants.runs_of(plants.feeble, 8, 50, 1, noise=0.0005, disturbance=0.0002)
    (data,) = coordinate_data_of(door, tracks(door, plants.door_recording(moved)))
    errors = np.zeros_like(data.z)
    errors[:, 1:] = data.z[:, 1:] - np.clip(data.z + data.u, 0.0, END)[:, :-1]
    assert missing_modes(data, errors, np.ones_like(errors), np.arange(len(data.run)) % 4) == ()


@pytest.mark.parametrize("seed", [3, 7])
def test_residuals_that_wander_count_as_few_rows(door, seed) -> None:
    (data,) = coordinate_data_of(door, tracks(door, recorded(plants.honest, 1)))
    fresh = np.random.default_rng(seed).normal(0.0, 0.001, data.z.shape)
    wandering = lfilter([1.0], [1.0, -0.97], fresh, axis=1)
    assert missing_modes(data, wandering, np.ones_like(wandering), np.arange(len(data.run)) % 4) == ()


@pytest.mark.slow
def test_calibration_writes_it_into_the_automaton(door) -> None:
    recording = recorded(plants.short_far_out, 5, runs=6)
    found = calibrate(door, recording)
    (effect,) = found.effects
    (mode,) = CalibrationResult(found, door, recording).json()["missing_modes"]
    assert mode["from"] == pytest.approx(0.6, abs=0.05)
    assert mode["to"] is None
    assert mode["modes"] == [one.name for one in found.automaton.modes[1:]] == list(effect.effect.modes)
    assert "the new model has it as revolute from" in mode["sentence"]
    assert effect.effect.name == "gain"
    assert effect.effect.values[0] == pytest.approx(0.75, abs=0.02)
    assert "missing_mode" in codes_of(found.notes)
    assert "Modes that the model lacks" in calibration_page(found, "door")
    assert found.after.one_step < 1.1 * found.noise_floor < 0.8 * found.before.one_step
