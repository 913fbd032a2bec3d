"""The 95 % interval of a changepoint's row holds the true row about that often, and no wider than needed."""

from __future__ import annotations

import numpy as np
import pytest
from planted import JOINTS, TRAVEL, Noise, recorded
from scipy.stats import binom

from micah_plan.learning.learn import learn_graph

STOP, HELD = 240, 120


def intervals(kind: str, trials: int, noise: float) -> list[tuple[int, int]]:
    """Of the row at which a joint that moved slowly for `STOP` rows stops; those in which the stop was found."""
    c = np.concatenate([np.linspace(0.0, TRAVEL[kind], STOP + 1), np.full(HELD, TRAVEL[kind])])
    found = []
    for seed in range(trials):
        rng = np.random.default_rng([11, seed])
        recording = recorded([(JOINTS[kind], c)], rng, noise=Noise(position=noise, rotation=6 * noise))
        segments = learn_graph(recording, method="champ").edges[0].segments
        certainty = segments[-1].certainty
        if len(segments) == 2 and certainty is not None and certainty.start is not None:
            found.append(certainty.start.interval())
    return found


@pytest.mark.slow
def test_an_interval_of_a_stop_is_as_wide_as_the_noise_makes_it() -> None:
    sharp, blurred = (intervals("prismatic", 3, noise) for noise in (0.0003, 0.004))
    assert all(low <= STOP + 1 and high >= STOP for low, high in sharp)
    widths = [np.median([high - low for low, high in found]) for found in (sharp, blurred)]
    assert widths[0] < 10 < widths[1]


@pytest.mark.evidence
@pytest.mark.parametrize("kind", ["prismatic", "revolute"])
def test_intervals_of_a_stop_hold_it(kind: str) -> None:
    found = intervals(kind, 60, 0.001)
    hits = sum(low <= STOP + 1 and high >= STOP for low, high in found)
    assert len(found) >= 55
    assert hits >= binom.ppf(1e-4, len(found), 0.93)
