"""Ends that other coordinates change: what stands in the way is the model's own, and no effect that it lacks."""

from __future__ import annotations

import numpy as np
import pytest

from micah_plan.automaton.transition import step
from micah_plan.documents.model import load_model
from micah_plan.execution.open_loop import carry_out
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.row_ends import row_ends
from micah_plan.task.experiment import Experiment, Motion
from micah_plan.task.start import Start


@pytest.fixture(scope="module")
def cupboard(repository):
    return load_model(repository / "models" / "cupboard.yaml")


def test_ends_are_those_of_the_step(cupboard) -> None:
    """Rows of (door, jar): the jar in the way, not in the way, out, and the door not open yet."""
    x = np.array([[1.5, 0.1], [1.5, 0.0], [1.5, 0.3], [0.6, 0.0]])
    modes = np.array([2, 2, 2, 1])
    door, jar = (row_ends(cupboard, x, modes, i) for i in (0, 1))
    assert door.low == pytest.approx([1.3, 0.0, 0.0, 0.0])
    assert door.high == pytest.approx([1.7] * 4)
    assert np.isinf(jar.low).all()  # no transition leaves its range, so nothing ends the motion
    for row, low in zip(x, door.low, strict=True):
        mode = "open" if row[0] > 1.3 else "ajar"
        assert step(cupboard, mode, row, [-3.0, 0.0]).x[0] == pytest.approx(low)


def test_what_noise_leaves_open_is_reported(cupboard) -> None:
    x = np.array([[1.5, 0.019], [1.5, 0.1], [1.5, 0.021]])
    ends = row_ends(cupboard, x, np.full(3, 2), 0)
    assert ends.low[[0, 2]] == pytest.approx([0.0, 0.0])
    assert ends.narrow[0][[0, 2]] == pytest.approx([1.3, 1.3])
    assert ends.depends_on_noise(x[:, 0], np.full(3, -0.3)).tolist() == [True, False, True]
    assert ends.depends_on_noise(x[:, 0], np.full(3, -0.1)).tolist() == [False] * 3


@pytest.mark.slow
def test_pushing_against_what_stands_in_the_way_is_no_effect(cupboard) -> None:
    push, draw = [(-0.1, 0.0)] * 8, [(0.0, 0.03)] * 5
    motions = [
        Motion(Start((1.5, 0.1), (0.01, 0.003), "open"), tuple(push + draw + push)),
        Motion(Start((0.5, 0.0), (0.01, 0.003), "ajar"), tuple([(0.12, 0.0)] * 12 + draw[:3] + push)),
    ]
    log, _ = carry_out(Experiment(cupboard, tuple(motions), 3), seed=4)
    found = calibrate(cupboard, log)
    assert found.verdict == "none"
    assert found.before.one_step < 1.5 * found.noise_floor
