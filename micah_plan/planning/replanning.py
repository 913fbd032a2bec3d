"""Planning again from where the filter says the object is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.planning.plan import Trajectory
from micah_plan.planning.pomdp_hd import plan
from micah_plan.planning.problem import Problem, Start


def replan(problem: Problem, belief: HybridBelief, seed: int = 0) -> Trajectory | None:
    """A trajectory from the most likely mode of a belief to the problem's goal; None if there is none."""
    mode = belief.most_likely
    factor = belief.factors[mode]
    start = Start(
        mean=tuple(float(value) for value in belief.means[mode]),
        std=tuple(float(value) for value in np.linalg.norm(factor, axis=1)),
        mode=problem.automaton.modes[mode].name,
    )
    return plan(replace(problem, start=start), seed=seed).trajectory
