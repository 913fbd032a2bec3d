"""Measurements that depend on the mode and on the place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from automaton_examples import cabinet

from micah_plan.automaton.hybrid import Noise
from micah_plan.automaton.sensing import Light, Sensing


def test_without_anything_stated_it_is_the_models_noise_everywhere() -> None:
    automaton = cabinet()
    for mode in automaton.modes:
        sensing = automaton.sensing(mode)
        assert sensing.is_uniform
        x = np.random.default_rng(0).normal(size=(5, 3, automaton.n))
        assert np.array_equal(sensing.std_at(x), np.broadcast_to(automaton.noise.observation_std, x.shape))


def test_a_mode_that_states_its_own_needs_no_light() -> None:
    automaton = cabinet()
    light = Light(((0, 1.0),), (0.5, 0.25))
    first = replace(automaton.modes[0], observation_std=((1, 0.01),))
    automaton = replace(automaton, modes=(first, *automaton.modes[1:]), noise=Noise((0.1, 0.1), (0.3, 0.4), light))
    at_light, away = np.array([1.0, 7.0]), np.array([-3.0, 7.0])
    own, other = automaton.sensing(automaton.modes[0]), automaton.sensing(automaton.modes[1])
    assert own.std_at(at_light) == pytest.approx([0.3, 0.01])
    assert own.std_at(away) == pytest.approx([np.hypot(0.3, 2.0), 0.01])
    assert other.std_at(away) == pytest.approx([np.hypot(0.3, 2.0), np.hypot(0.4, 1.0)])


def test_the_light_of_platt() -> None:
    """Variance ½ (5 - x)² along a line; a light at a point counts the distance to it."""
    line = Sensing((0.0, 0.0), (0.5**0.5,) * 2, ((0, 5.0),))
    x = np.array([[2.0, 2.0], [5.0, -1.0], [9.0, 0.0]])
    assert np.square(line.std_at(x)) == pytest.approx(np.repeat(0.5 * (5 - x[:, :1]) ** 2, 2, axis=1))
    point = Sensing((0.1, np.inf), (1.0, 1.0), ((0, 0.0), (1, 0.0)))
    assert point.std_at(np.array([3.0, 4.0])) == pytest.approx([np.hypot(0.1, 5.0), np.inf])
