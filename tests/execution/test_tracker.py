"""The tracker's noise has the stated size, and the wander the stated memory."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from micah_plan.execution.tracker import PoseTracker, TrackerNoise

TRUE_POSITION = np.array([[0.1, 0.2, 0.3], [1.0, 1.0, 1.0]])
TRUE_QUATERNION = np.array([[0.0, 0.0, 0.0, 1.0], [0.5, 0.5, 0.5, 0.5]])


def errors(noise, samples, elapsed):
    tracker = PoseTracker(noise, 2, np.random.default_rng(0))
    position, rotation = [], []
    for _ in range(samples):
        p, q = tracker.measure(TRUE_POSITION, TRUE_QUATERNION, elapsed)
        position.append(p - TRUE_POSITION)
        rotation.append((Rotation.from_quat(q) * Rotation.from_quat(TRUE_QUATERNION).inv()).as_rotvec())
    return np.array(position), np.array(rotation)


def test_white_noise_has_its_std_per_link():
    position, rotation = errors(TrackerNoise(np.array([0.002, 0.005]), np.array([0.02, 0.05])), 3000, 0.1)
    np.testing.assert_allclose(position.std(axis=(0, 2)), [0.002, 0.005], rtol=0.03)
    np.testing.assert_allclose(rotation.std(axis=(0, 2)), [0.02, 0.05], rtol=0.03)
    assert abs(np.corrcoef(position[1:, 0, 0], position[:-1, 0, 0])[0, 1]) < 0.06


@pytest.mark.slow
def test_the_wander_is_stationary_and_forgets_in_its_time():
    noise = TrackerNoise(0.0, 0.0, position_wander=0.01, rotation_wander=0.1, wander_time=2.0)
    position, rotation = errors(noise, 20000, 0.5)
    series = position.reshape(-1, 6)
    np.testing.assert_allclose(series.std(), 0.01, rtol=0.05)
    np.testing.assert_allclose(rotation.std(), 0.1, rtol=0.05)
    lag = np.mean(series[4:] * series[:-4]) / series.var()
    assert lag == pytest.approx(np.exp(-1.0), abs=0.05)


def test_without_noise_the_truth_is_measured():
    tracker = PoseTracker(TrackerNoise(0.0, 0.0), 2, np.random.default_rng(0))
    position, quaternion = tracker.measure(TRUE_POSITION, TRUE_QUATERNION, 1.0)
    np.testing.assert_array_equal(position, TRUE_POSITION)
    np.testing.assert_allclose(quaternion, TRUE_QUATERNION, atol=1e-15)
