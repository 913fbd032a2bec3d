"""Parts that hang on parts, in both plants: a door with a handle that is tracked too, and a drawer beside it."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from execution_objects import arm
from extras import requires
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.execution.mujoco.parameters import PhysicalParameters
from micah_plan.execution.mujoco.standing import StandingPlant
from micah_plan.execution.nominal import NominalPlant, pose_noise
from micah_plan.execution.pose import command, configuration
from micah_plan.task.start import Start

EXAMPLES = Path(__file__).parents[2] / "examples"
STILL = Start((0.0, 0.0), (0.0, 0.0))


@pytest.fixture(scope="module")
def cabinet() -> HybridAutomaton:
    sys.path.insert(0, str(EXAMPLES))
    try:
        import objects

        return objects.cabinet()
    finally:
        sys.path.remove(str(EXAMPLES))


def apart(position: np.ndarray, quaternion: np.ndarray) -> RigidTransform:
    """Pose of the handle on the door."""
    poses = RigidTransform.from_components(position, Rotation.from_quat(quaternion))
    return poses[0].inv() * poses[2]


def test_the_door_determines_the_configuration_not_its_handle(cabinet: HybridAutomaton) -> None:
    plant = NominalPlant(cabinet, Start((0.7, 0.1), (0.0, 0.0)))
    plant.reset(np.random.default_rng(0))
    truth = plant.truth()
    for mode in ("swinging", "latched"):
        found = configuration(cabinet, mode, truth.position, truth.quaternion, np.zeros(2))
        assert found == pytest.approx([0.7, 0.1], abs=1e-9)


def test_the_handle_is_seen_as_well_as_the_door(cabinet: HybridAutomaton) -> None:
    noise = pose_noise(cabinet)
    assert noise.position[2] == noise.position[0]
    assert noise.position[1] == pytest.approx(0.002)


@requires("sim")
def test_in_physics_the_handle_stays_on_the_door(cabinet: HybridAutomaton) -> None:
    plant = StandingPlant(cabinet, STILL, PhysicalParameters(control_period=0.1, motion_share=1.0))
    plant.reset(np.random.default_rng(0))
    before = apart(plant.truth().position, plant.truth().quaternion)
    for _ in range(14):
        plant.apply(command(cabinet, "swinging", plant.truth().x, np.array([0.1, 0.01])))
    truth = plant.truth()
    plant.close()
    assert truth.x == pytest.approx([1.2, 0.14], abs=0.01)
    assert truth.latched.tolist() == [True, False]
    after = apart(truth.position, truth.quaternion)
    assert after.translation == pytest.approx(before.translation, abs=1e-6)
    assert (after.rotation * before.rotation.inv()).magnitude() == pytest.approx(0.0, abs=1e-6)


@requires("sim")
def test_in_physics_a_slider_rides_on_its_lever() -> None:
    automaton = arm()
    plant = StandingPlant(automaton, STILL, PhysicalParameters(control_period=0.1, motion_share=1.0))
    plant.reset(np.random.default_rng(0))
    for _ in range(10):
        plant.apply(command(automaton, "moving", plant.truth().x, np.array([0.04, 0.01])))
    truth = plant.truth()
    plant.close()
    assert truth.x == pytest.approx([0.4, 0.1], abs=0.03)
    assert configuration(automaton, "moving", truth.position, truth.quaternion, np.zeros(2)) == pytest.approx(
        truth.x, abs=1e-6
    )
