"""The hybrid filter beside the Bayes filter on a grid (`tests/reference/bayes_filter.py`)."""

from __future__ import annotations

import numpy as np
import pytest
from reference.bayes_filter import GridFilter
from test_hybrid_filter import door, slider

from micah_plan.belief.filter import initial_belief, predict_belief, update

# Commands and measurements [rad or m]: up to the threshold and over it, and back.
DOOR = [(0.05, 0.35), (0.05, 0.41), (0.05, 0.44), (0.05, 0.52), (0.05, 0.56), (0.05, 0.60), (0.05, 0.60), (-0.05, 0.56)]
SLIDER = [(0.03, 0.21), (0.03, 0.24), (0.03, 0.27), (0.03, 0.295), (0.03, 0.315), (0.03, 0.33), (-0.04, 0.31)]


@pytest.mark.parametrize(
    ("automaton", "start", "reach", "rows"),
    [(door(), (0.3, 0.03), (0.0, 0.9), DOOR), (slider(), (0.18, 0.02), (0.0, 0.5), SLIDER)],
    ids=["a door that a latch holds", "a slider with two segments"],
)
def test_modes_means_and_stds_are_those_of_the_grid(automaton, start, reach, rows) -> None:
    first = automaton.modes[0].name
    belief = initial_belief(automaton, [start[0]], [start[1]], first)
    grid = GridFilter(automaton, first, *start, reach, 361)
    for u, z in rows:
        belief = update(automaton, predict_belief(automaton, belief, [u]), [z])
        grid.predict(u)
        grid.update(z)
        assert belief.weights == pytest.approx(grid.weights, abs=0.03)
        for number, mode in enumerate(automaton.modes):
            if grid.weights[number] > 0.2:
                mean, std = grid.moments(mode.name)
                assert belief.means[number, 0] == pytest.approx(mean, abs=0.25 * std)
                assert np.linalg.norm(belief.factors[number, 0]) == pytest.approx(std, rel=0.25)
