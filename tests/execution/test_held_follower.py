"""Following a plan with a held object: a missed latch is pressed again, and nothing pulls at a joint that swings."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.documents.problem import load_problem
from micah_plan.execution.pilot import PlanFollower
from micah_plan.task.plan import Trajectory

PROBLEM = load_problem(Path(__file__).resolve().parents[2] / "problems" / "stapler_on_books.yaml")
ABOVE, PRESSED, LIFTED = (0.0, 0.0, 0.1, 0.3), (0.0, 0.0, 0.07, 0.46), (0.02, 0.0, 0.1, 0.573)
AT_GOAL = (0.45, 0.0, 0.288, 0.573)


def pressing() -> Trajectory:
    """From above the table into contact, up again and straight to the goal, with a transition between modes."""
    modes = ("free", "free", "line", "rigid", "rigid")
    means = np.array([ABOVE, PRESSED, PRESSED, LIFTED, AT_GOAL])
    is_transition = np.array([False, True, True, False])
    inputs = np.where(is_transition[:, None], 0.0, np.diff(means, axis=0)[:, :3])
    return Trajectory(modes, means, np.zeros((5, 4, 4)), inputs, np.zeros((4, 3, 4)), is_transition)


def believed(mode: str, x: tuple[float, ...]) -> HybridBelief:
    """All of the belief in one mode."""
    names = [one.name for one in PROBLEM.automaton.modes]
    weights = np.array([float(name == mode) for name in names])
    return HybridBelief(weights, np.tile(x, (len(names), 1)), np.full((len(names), 4, 4), 1e-3))


def test_a_missed_latch_is_pressed_again_by_the_hand_alone():
    """The swinging arm is at another angle than planned; that must not lift the hand, which contact would need."""
    follower = PlanFollower(PROBLEM, pressing())
    assert follower.advise(believed("free", ABOVE)).fit == "on_plan"
    lifted = (0.02, 0.0, 0.1, 0.55)
    advice = follower.advise(believed("free", lifted))
    assert advice.fit == "lagging"
    np.testing.assert_allclose(advice.u, np.subtract(PRESSED, lifted)[:3], atol=1e-12)


def test_at_the_goal_the_press_is_not_repeated():
    """Some doubt is left whether it latched, but pressing again would take it away from the goal."""
    follower = PlanFollower(PROBLEM, pressing())
    for mode, x in (("free", ABOVE), ("rigid", LIFTED)):
        follower.advise(believed(mode, x))
    arrived = believed("rigid", AT_GOAL)
    doubted = HybridBelief(
        0.95 * arrived.weights + 0.05 * believed("line", AT_GOAL).weights, arrived.means, arrived.factors
    )
    advice = follower.advise(doubted)
    assert advice.fit == "finished"
    np.testing.assert_allclose(advice.u, 0.0, atol=1e-12)
