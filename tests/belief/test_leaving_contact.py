"""A contact that is left: what was held at a wall is not taken to be behind it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from reference.hybrid_step import step

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.belief import filter as batch
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.documents.model import load_model

MODES = ("free", "wall_x", "wall_y", "corner")
LEAVING = {
    ("corner", (3.0, 3.0)): "free",
    ("corner", (3.0, -1.0)): "wall_y",
    ("corner", (-1.0, 3.0)): "wall_x",
    ("wall_x", (3.0, 3.0)): "free",
    ("wall_y", (-3.0, 3.0)): "free",
}


@pytest.fixture(scope="module")
def walls() -> HybridAutomaton:
    return load_model(Path(__file__).parents[2] / "models" / "walled_domain.yaml")


def at_contact(mode: str, offset: tuple[float, float]) -> HybridBelief:
    """All of the belief in a mode, its mean a little off the walls that it knows to 0.1 m."""
    weights = np.array([float(name == mode) for name in MODES])
    x = -20.0 if mode in ("wall_x", "corner") else 30.0
    y = -20.0 if mode in ("wall_y", "corner") else 30.0
    mean = np.array([x, y]) + offset
    return HybridBelief(weights, np.tile(mean, (4, 1)), np.tile(0.1 * np.eye(2), (4, 1, 1)))


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.02, -0.03), (-0.02, 0.03), (-0.05, -0.05)])
@pytest.mark.parametrize(("mode", "u"), LEAVING)
def test_leaving_a_wall_does_not_bump_into_it(
    walls: HybridAutomaton, mode: str, u: tuple[float, float], offset: tuple[float, float]
) -> None:
    belief = at_contact(mode, offset)
    after = batch.predict_belief(walls, belief, u)
    wanted = LEAVING[mode, u]
    assert after.weights[MODES.index(wanted)] > 1 - 1e-6
    at_wall = np.array([-20.0 if abs(value + 20.0) < 1 else 30.0 for value in belief.means[0]])
    assert step(walls, mode, at_wall, u).mode == wanted
    together = batch.predict_belief(walls, batch.repeated_belief(walls, belief, 3), np.tile(u, (3, 1)))
    np.testing.assert_allclose(together.weights, np.tile(after.weights, (3, 1)), atol=1e-12)


def test_pressing_on_stays_at_the_wall(walls: HybridAutomaton) -> None:
    after = batch.predict_belief(walls, at_contact("corner", (0.03, 0.03)), (-3.0, -3.0))
    assert after.weights[MODES.index("corner")] == pytest.approx(1.0)
    np.testing.assert_allclose(after.means[MODES.index("corner")], [-19.97, -19.97])
