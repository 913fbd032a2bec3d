"""Each mode measures in its own way: what is left of the spread is that of a Kalman filter with the mode's noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from micah_plan.automaton.hybrid import Coordinate, HybridAutomaton, Link, Mode, Noise, Part
from micah_plan.automaton.joint import prismatic
from micah_plan.automaton.sensing import Light
from micah_plan.belief.filter import initial_belief, update

STDS = {"open": 0.03, "touching": 0.002}


def slide() -> HybridAutomaton:
    joint = prismatic((1.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    modes = tuple(Mode(name, (joint,), ((1.0,),), observation_std=((0, std),)) for name, std in STDS.items())
    coordinate = (Coordinate("x", "m"),)
    return HybridAutomaton(
        coordinate, coordinate, (Link("base", "part", 0),), (Part("part"),), modes, (), Noise((0.0,), (0.5,))
    )


@pytest.mark.parametrize("mode", STDS)
def test_a_measurement_is_worth_what_the_mode_sees(mode: str) -> None:
    belief = update(slide(), initial_belief(slide(), [0.1], [0.05], mode), [0.12])
    variance = 1.0 / (1.0 / 0.05**2 + 1.0 / STDS[mode] ** 2)
    index = list(STDS).index(mode)
    assert belief.factors[index, 0, 0] ** 2 == pytest.approx(variance, rel=1e-6)
    assert belief.means[index, 0] == pytest.approx(variance * (0.1 / 0.05**2 + 0.12 / STDS[mode] ** 2), rel=1e-6)


def test_where_light_is_needed_a_mode_without_its_own_sees_by_the_distance() -> None:
    lit = replace(slide(), noise=Noise((0.0,), (0.01,), Light(((0, 0.0),), (0.5,))))
    dark = replace(lit, modes=(replace(lit.modes[0], observation_std=()), lit.modes[1]))
    after = {mode: update(dark, initial_belief(dark, [2.0], [0.1], mode), [2.0]) for mode in STDS}
    for index, (mode, std) in enumerate({"open": np.hypot(0.01, 0.5 * 2.0), "touching": STDS["touching"]}.items()):
        assert after[mode].factors[index, 0, 0] ** 2 == pytest.approx(1.0 / (1.0 / 0.1**2 + 1.0 / std**2), rel=1e-6)
