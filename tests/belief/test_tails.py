"""Probabilities of guards and log weights far in the tails: right, finite, and with a slope to go by."""

from __future__ import annotations

from dataclasses import replace

import baseline_direct as direct
import casadi as ca
import numpy as np
import pytest
from baseline_direct import mixture_step
from scipy.special import log_ndtr
from scipy.stats import norm, truncnorm
from single_gaussian import reference as gaussian
from single_gaussian.one_at_a_time import truncate
from uncertain_joints import SHUT, unsure_door

from micah_plan.automaton.region import above
from micah_plan.belief.filter import initial_belief, update
from micah_plan.planning.limits import Limits

SIGMAS = np.concatenate([np.linspace(-30.0, 8.0, 96), [-5.0 - 1e-9, -5.0, -5.0 + 1e-9]])


def compiled() -> ca.Function:
    t = ca.SX.sym("t")
    value = direct.log_ndtr(t)
    slope = ca.gradient(value, t)
    return ca.Function("tail", [t], [value, slope, ca.gradient(slope, t)])


def test_the_symbolic_logarithm_has_value_slope_and_curvature_down_to_thirty_sigma() -> None:
    for t in SIGMAS:
        value, slope, curvature = (float(v) for v in compiled()(t))
        mills = np.exp(-0.5 * t**2 - 0.5 * np.log(2 * np.pi) - log_ndtr(t))
        assert value == pytest.approx(log_ndtr(t), rel=1e-9, abs=1e-9)
        assert slope == pytest.approx(mills, rel=1e-8)
        # t + mills cancels in the tail.
        assert curvature == pytest.approx(-mills * (t + mills), rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("t", [-1e8, -1e4, -300.0, 40.0, 1e4])
def test_it_stays_finite_far_beyond(t: float) -> None:
    values = [float(v) for v in compiled()(t)]
    assert np.isfinite(values).all()
    assert values[0] == pytest.approx(log_ndtr(t), rel=1e-12, abs=1e-300)


@pytest.mark.parametrize("sigmas", [-1.0, -6.0, -12.0, -30.0])
def test_the_log_weight_of_a_mode_far_away_has_the_slope_of_its_finite_differences(sigmas: float) -> None:
    """Of the direct transcription: by the mean and the spread of a door that has that far to go to its latch."""
    door, std = unsure_door(None, process=0.0), 0.05
    step = mixture_step(door, Limits(*np.array([[0.02], [0.0], [1.0], [0.02]])))
    z, u = ca.MX.sym("z", 4), ca.MX.sym("u")
    log_weight = ca.log(step(z, u)[3])
    function = ca.Function("log_weight", [z, u], [log_weight, ca.gradient(log_weight, z)])

    def at(z: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = function(z, 0.0)
        return float(value), np.array(slope).ravel()[:2]

    # Mean, factor, weights; the chance is softer than the belief by a part of a step and the threshold's std.
    where = np.array([SHUT + sigmas * float(np.hypot(np.hypot(std, 0.01), 0.005)), std, 1.0, 0.0])
    value, slope = at(where)
    assert value == pytest.approx(log_ndtr(sigmas), rel=1e-6)
    ways = 1e-6 * np.eye(4)[:2]
    assert slope == pytest.approx([(at(where + by)[0] - at(where - by)[0]) / 2e-6 for by in ways], rel=1e-5)
    assert slope[0] > 1.0  # towards the latch, from wherever it is


@pytest.mark.parametrize("sigmas", np.linspace(-30.0, 4.0, 18))
def test_a_half_space_that_far_away_has_its_probability_and_its_moments(sigmas: float) -> None:
    mean, factor = np.array([0.2, -0.4]), np.array([[0.3, 0.0], [0.1, 0.5]])
    a = np.array([0.8, -0.6])
    std = float(np.linalg.norm(factor.T @ a))
    offset = float(a @ mean) - sigmas * std
    half_space = replace(above(0, offset, 2, 1), a=(0.8, -0.6))
    probability = gaussian.half_space_probability(mean, factor, np.zeros(1), half_space)
    assert np.log(probability) == pytest.approx(log_ndtr(sigmas), rel=1e-9)
    found, inward, narrowed = truncate(mean, factor, a, offset)
    assert found == pytest.approx(log_ndtr(sigmas), rel=1e-9)
    within = truncnorm(-sigmas, np.inf)
    # SciPy's own moments of a tail cancel beyond 20 sigma; those of an exponential say enough there.
    expected = (within.mean(), within.std()) if sigmas > -20 else (-sigmas - 1 / sigmas, 1 / abs(sigmas))
    assert (a @ inward - offset) / std + -sigmas == pytest.approx(expected[0], rel=1e-4)
    assert np.linalg.norm(narrowed.T @ a) / std == pytest.approx(expected[1], rel=0.01)


@pytest.mark.parametrize("observation", [0.05, 0.03, 0.025])
def test_log_weights_have_the_slope_of_the_likelihoods_however_unlikely_a_measurement_was(observation: float) -> None:
    """A measurement half way between a door at 0.3 rad and one in its latch, 3 to 6 sigma from either."""
    door = unsure_door(None, observation=observation)
    certain = replace(door, edges=tuple(replace(edge, threshold_std=0.0) for edge in door.edges))
    belief = replace(initial_belief(certain, [0.3], [0.003], "swing"), weights=np.array([0.5, 0.5]))
    stds = np.hypot(observation, belief.factors[:, 0, 0])

    def log_odds(z: float) -> float:
        after = update(certain, belief, [z])
        assert np.isfinite(after.means).all()
        assert np.isfinite(after.factors).all()
        return float(np.log(after.weights[0]) - np.log(after.weights[1]))

    z = 0.45
    free, shut = norm(belief.means[:, 0], stds).logpdf(z)
    assert log_odds(z) == pytest.approx(free - shut, rel=1e-6)
    slope = (z - belief.means[:, 0]) / stds**2
    assert (log_odds(z + 1e-6) - log_odds(z - 1e-6)) / 2e-6 == pytest.approx(slope[1] - slope[0], rel=1e-4)
