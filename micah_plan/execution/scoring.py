"""The goal against beliefs, to decide when to stop, and the truth in the model's terms, to score."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from micah_plan.automaton.contacts.values import COLLIDED
from micah_plan.automaton.hybrid import HybridAutomaton, Mode
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.execution.plant import Truth
from micah_plan.execution.pose import configuration
from micah_plan.planning.input_memory import coasted
from micah_plan.task.goal import Goal

Floats = NDArray[np.float64]


def goal_probability(automaton: HybridAutomaton, goal: Goal, belief: HybridBelief) -> float:
    """Probability, never overstated, that the state is in the goal set.

    Within a mode, coordinates may be correlated; Bonferroni's bound 1 - Σ P(outside) holds whatever the correlation.
    """
    total = 0.0
    for number, mode in enumerate(automaton.modes):
        if not goal.admits(mode.name):
            continue
        std = np.sqrt(np.maximum(np.sum(belief.factors[number] ** 2, axis=1), 1e-24))
        outside = 0.0
        for index, value, tolerance in goal.target:
            away = belief.means[number, index] - value
            inside = ndtr((tolerance - away) / std[index]) - ndtr((-tolerance - away) / std[index])
            outside += 1.0 - float(inside)
        total += float(belief.weights[number]) * max(0.0, 1.0 - outside)
    return total


def lasting_probability(automaton: HybridAutomaton, goal: Goal, belief: HybridBelief) -> float:
    """Probability of the goal now, and when all that was commanded has arrived: the smaller of both."""
    now = goal_probability(automaton, goal, belief)
    if not automaton.input_memories:
        return now
    ends = [coasted(automaton, mode.name, mean) for mode, mean in zip(automaton.modes, belief.means, strict=True)]
    return min(now, goal_probability(automaton, goal, replace(belief, means=np.array(ends))))


def true_state(automaton: HybridAutomaton, truth: Truth) -> tuple[str, Floats]:
    """The truth in the terms of the executing side's model: its mode and x (n,).

    A plant may be another model or physics. Then x follows from the true poses by the model's inverse kinematics, and
    the mode is the one that pins what is latched, with the largest margin inside its invariant among those. A collision
    stays one, though the model may have no mode for it.
    """
    if truth.mode in automaton.mode_names:
        return str(truth.mode), truth.x
    still = np.zeros(automaton.m)
    x = configuration(automaton, automaton.modes[0].name, truth.position, truth.quaternion, truth.x)
    x = np.where(np.isnan(x), truth.x, x)
    if truth.mode == COLLIDED:
        return COLLIDED, x

    def fit(mode: Mode) -> tuple[int, float, float]:
        distance = sum(abs(pin.value - float(x[pin.coordinate])) for pin in mode.pins)
        margin = float(mode.invariant.margins(x, still).min(initial=0.0))
        return -int((mode.free == truth.held).sum()), -distance, margin

    return max(automaton.modes, key=fit).name, x
