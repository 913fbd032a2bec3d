"""Experiments that calibration writes: what was tied is told apart by their record; the plants are written by hand."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import planted_effects as plants
import pytest

from micah_plan.api.inputs import joined_recordings
from micah_plan.documents.experiment import load_experiment
from micah_plan.documents.model import dump_model
from micah_plan.recording.read import write_recording
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.next_experiment import next_experiment

NOISE = 0.02


def few_runs(plant, seed=100):
    runs = plants.runs_of(plant, 2, 25, seed, noise=NOISE, disturbance=NOISE / 3)
    return plants.door_recording(runs, across=plants.RADIUS * NOISE, seed=seed)


def carried_out(experiment, plant, seed=0):
    """The record of an experiment on a plant(c, u, k, memory) -> c."""
    rng, runs = np.random.default_rng(seed), []
    for _ in range(experiment.repetitions):
        for motion in experiment.motions:
            u = np.array([*(row[0] for row in motion.commands), 0.0])
            c, memory, z = motion.start.mean[0], {"rng": rng}, []
            plant(c, 0.0, 0, memory)
            for k, command in enumerate(u):
                z.append(c + NOISE * rng.standard_normal())
                c = plant(c, command, k, memory) + NOISE / 3 * rng.standard_normal()
                c = min(max(c, 0.0), plants.LENGTH)
            runs.append((np.array(z), u))
    return plants.door_recording(runs, across=plants.RADIUS * NOISE, seed=seed)


@pytest.fixture(scope="module")
def tied(door):
    recording = few_runs(plants.late)
    return recording, calibrate(door, recording)


@pytest.mark.slow
def test_tied_effects_are_separated(door, tied) -> None:
    recording, found = tied
    assert any(one.tied for one in found.effects)
    designed = next_experiment(door, recording, found)
    assert designed is not None
    after = calibrate(door, joined_recordings([recording, carried_out(designed.experiment, plants.late)]))
    assert after.verdict == "explained"
    assert [(one.effect.name, one.tied) for one in after.effects] == [("delay", ())]


@pytest.mark.slow
def test_motions_stay_where_the_recording_was_and_commands_are_no_larger(door, tied) -> None:
    recording, found = tied
    designed = next_experiment(door, recording, found)
    assert all(nats > 8.0 for _, _, nats in designed.expected)
    assert {found.effects[0].effect.name, *found.effects[0].tied} >= set(designed.expected[0][:2])
    experiment = designed.experiment
    largest = np.abs(found.traces[0].data.u).max()
    for motion in experiment.motions:
        u = np.array(motion.commands)[:, 0]
        assert np.abs(u).max() <= 1.001 * largest
        assert 0.0 <= motion.start.mean[0] <= plants.LENGTH
    low, high = found.traces[0].data.visited
    place = np.cumsum([experiment.motions[1].start.mean[0], *u])
    assert place.min() > low - plants.STEP * 6
    assert place.max() < high + plants.STEP * 6


@pytest.mark.slow
def test_without_effects_the_experiment_tests_the_closest_candidate(door) -> None:
    recording = few_runs(plants.honest)
    found = calibrate(door, recording)
    assert found.verdict == "none"
    designed = next_experiment(door, recording, found)
    assert designed is not None
    assert any("nothing" in pair[:2] for pair in designed.expected)


@pytest.mark.slow
def test_no_motion_along_the_joint_separates_a_gain_and_a_rotated_frame(door) -> None:
    recording = plants.door_recording(plants.runs_of(plants.short_steps, 4, 15, 3))
    found = calibrate(door, recording)
    assert found.effects[0].effect.name == "gain"
    one = found.traces[0]
    alone = replace(found, traces=(replace(one, findings=(replace(one.findings[0], tied=("frame_rotation",)),)),))
    assert next_experiment(door, recording, alone) is None


@pytest.mark.slow
def test_the_command_writes_a_file_that_execute_takes(door, tied, tmp_path) -> None:
    recording, _ = tied
    dump_model(door, tmp_path / "door.yaml")
    write_recording(recording, tmp_path / "runs.csv")
    command = ["calibrate", "door.yaml", "runs.csv", "-o", "new.yaml", "--experiment", "next.yaml", "--json"]
    run = [sys.executable, "-m", "micah_plan", *command]
    done = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)["experiment"]
    assert told["pairs"][0]["expected_nats"] > 8.0
    experiment = load_experiment(tmp_path / "next.yaml")
    assert experiment.automaton == door
    assert (tmp_path / "next.yaml").read_text().startswith(f"# {told['sentence'][:40]}")
