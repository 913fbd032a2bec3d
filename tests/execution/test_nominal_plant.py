"""The nominal plant is the automaton, and its tracker is as precise as the model says."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from execution_objects import SHUT, arm, door, drawer, worm

from micah_plan.automaton.hybrid import Noise
from micah_plan.automaton.sensing import Light
from micah_plan.automaton.transition import step
from micah_plan.documents.model import load_model
from micah_plan.execution.nominal import NominalPlant
from micah_plan.execution.plant import Command
from micah_plan.execution.pose import command, configuration
from micah_plan.task.start import Start

MODELS = Path(__file__).parents[2] / "models"


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("name", "start", "std"), [("swinging", 0.2, 0.05), ("swinging", 0.6, 0.29), ("shut", SHUT, 0.002)]
)
def test_measurements_are_as_noisy_as_the_mode_and_the_place_say(name, start, std):
    own = tuple(replace(m, observation_std=((0, 0.002),)) if m.name == "shut" else m for m in door().modes)
    automaton = replace(door(), modes=own, noise=Noise((0.0,), (0.05,), Light(((0, 0.2),), (0.7,))))
    plant = NominalPlant(automaton, Start((start,), (0.0,), name))
    rng = np.random.default_rng(4)
    poses = [plant.reset(rng) for _ in range(800)]
    found = [configuration(automaton, name, p.position, p.quaternion, np.array([start]))[0] for p in poses]
    assert np.std(found) == pytest.approx(std, rel=0.1)


@pytest.mark.slow
def test_a_part_that_another_one_carries_is_measured_relative_to_it():
    automaton = replace(load_model(MODELS / "slot.yaml"), noise=Noise((0.0, 0.0), (20.0, 1.0)))
    plant = NominalPlant(automaton, Start((-0.1, 0.04), (1e-9, 1e-9), "table"))
    rng = np.random.default_rng(4)
    poses = [plant.reset(rng) for _ in range(800)]
    found = [configuration(automaton, "table", p.position, p.quaternion, np.zeros(2)) for p in poses]
    assert np.std(found, axis=0) == pytest.approx([20.0, 1.0], rel=0.1)


def quiet(automaton):
    n = automaton.n
    return replace(automaton, noise=Noise((0.0,) * n, (0.0,) * n))


def test_the_true_state_is_the_automatons():
    automaton = quiet(door())
    plant = NominalPlant(automaton, Start((0.2,), (0.0,)))
    plant.reset(np.random.default_rng(0))
    mode, x = "swinging", np.array([0.2])
    for u in np.random.default_rng(1).uniform(-0.2, 0.5, size=(40, 1)):
        after = step(automaton, mode, x, u)
        mode, x = after.mode, after.x
        plant.apply(command(automaton, mode, x, u))
        truth = plant.truth()
        assert truth.mode == mode
        np.testing.assert_array_equal(truth.x, x)
        assert truth.latched.all() == (mode == "shut")


def test_the_process_noise_has_the_models_std():
    automaton = drawer(process_std=0.002)
    plant = NominalPlant(automaton, Start((0.15,), (0.0,)))
    rng = np.random.default_rng(5)
    steps = []
    for _ in range(400):
        plant.reset(rng)
        plant.apply(command(automaton, "sliding", np.array([0.15]), np.array([0.01])))
        steps.append(plant.truth().x[0] - 0.15)
    assert np.mean(steps) == pytest.approx(0.01, abs=4e-4)
    assert np.std(steps) == pytest.approx(0.002, rel=0.12)


@pytest.mark.slow
@pytest.mark.parametrize("automaton", [door(), drawer(), worm()], ids=["door", "drawer", "worm"])
def test_measured_configurations_are_as_noisy_as_the_model_says(automaton):
    plant = NominalPlant(automaton, Start((0.2,), (0.0,)))
    rng = np.random.default_rng(2)
    mode = automaton.modes[0].name
    found = []
    for _ in range(1500):
        seen = plant.reset(rng)
        found.append(configuration(automaton, mode, seen.position, seen.quaternion, np.array([0.2]))[0])
    assert np.mean(found) == pytest.approx(0.2, abs=4 * automaton.noise.observation_std[0] / np.sqrt(1500))
    assert np.std(found) == pytest.approx(automaton.noise.observation_std[0], rel=0.08)


@pytest.mark.parametrize("automaton", [door(0.4), drawer(), worm(), arm()], ids=["door", "drawer", "worm", "chain"])
def test_without_noise_the_next_position_is_this_one_plus_the_action(automaton):
    automaton = quiet(automaton)
    plant = NominalPlant(automaton, Start((0.1,) * automaton.n, (0.0,) * automaton.n))
    seen = plant.reset(np.random.default_rng(0))
    mode = automaton.modes[0].name
    for u in np.random.default_rng(3).uniform(-0.02, 0.04, size=(5, automaton.m)):
        x = configuration(automaton, mode, seen.position, seen.quaternion, plant.truth().x)
        order = command(automaton, mode, x, u)
        expected = seen.position + order.origin
        seen = plant.apply(order)
        np.testing.assert_allclose(seen.position, expected, atol=1e-9)


def test_a_pull_on_a_held_part_is_an_action_though_nothing_moves():
    automaton = door()
    pull = command(automaton, "shut", np.array([SHUT]), np.array([0.05]))
    assert np.linalg.norm(pull.origin) == pytest.approx(2 * 0.35 * np.sin(0.025))
    plant = NominalPlant(quiet(automaton), Start((SHUT,), (0.0,), "shut"))
    before = plant.reset(np.random.default_rng(0)).position
    np.testing.assert_array_equal(plant.apply(pull).position, before)


def test_starts_are_drawn_within_the_start_modes_invariant():
    plant = NominalPlant(door(), Start((0.02,), (0.05,)))
    starts = []
    for seed in range(200):
        plant.reset(np.random.default_rng(seed))
        starts.append(plant.truth().x[0])
    assert min(starts) >= 0.0
    assert np.std(starts) > 0.02


def test_reset_comes_first():
    plant = NominalPlant(door(), Start((0.1,), (0.0,)))
    with pytest.raises(RuntimeError, match="before reset"):
        plant.apply(Command(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3))))


@pytest.mark.slow
def test_a_threshold_that_is_not_known_is_drawn_at_every_reset():
    certain = quiet(door())
    edges = (e if e.source == e.target else replace(e, threshold_std=0.02) for e in certain.edges)
    plant = NominalPlant(replace(certain, edges=tuple(edges)), Start((SHUT - 0.1,), (0.0,)))
    rng, held_at = np.random.default_rng(3), []
    for _ in range(300):
        plant.reset(rng)
        plant.apply(command(certain, "swinging", np.array([SHUT - 0.1]), np.array([0.3])))
        assert plant.truth().mode == "shut"
        held_at.append(plant.truth().x[0])
    assert np.mean(held_at) == pytest.approx(SHUT, abs=0.005)
    assert np.std(held_at) == pytest.approx(0.02, rel=0.2)
