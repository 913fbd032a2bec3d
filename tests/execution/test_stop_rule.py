"""An execution that stops "with p % probability of the goal" is in the goal that often."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from micah_plan.documents.problem import load_problem
from micah_plan.execution.trials import run_trials
from micah_plan.planning.solver import solve

PROBLEMS = Path(__file__).resolve().parents[2] / "problems"
CONFIDENCE = 0.7
TRIALS = 120
# Three standard errors of a right rule; one in 370 seeds of a right rule would miss them.
BAND = 3.0


def stopped(name: str, tightened: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Believed probabilities and true successes of the executions that stopped by themselves.

    Goals are tightened and the asked confidence lowered until failures are frequent enough to count.
    """
    problem = load_problem(PROBLEMS / f"{name}.yaml")
    target = tuple((index, value, tightened * tolerance) for index, value, tolerance in problem.goal.target)
    settings = replace(problem.settings, confidence=CONFIDENCE)
    problem = replace(problem, goal=replace(problem.goal, target=target), settings=settings)
    results = run_trials(problem, solve(problem), trials=TRIALS, seed=seed, replans=False).results
    own = [result for result in results if result.confidence >= CONFIDENCE]
    assert len(own) > 0.9 * TRIALS
    return np.array([result.confidence for result in own]), np.array([result.success for result in own])


def excess(believed: np.ndarray, true: np.ndarray) -> float:
    """Successes beyond those believed, in standard deviations of a sum of independent trials."""
    return float((true.sum() - believed.sum()) / np.sqrt((believed * (1.0 - believed)).sum()))


@pytest.mark.evidence
def test_what_stops_is_as_often_in_the_goal_as_it_believes() -> None:
    runs = [
        stopped(*case) for case in (("microwave_close", 1.0, 1), ("microwave_open", 0.4, 2), ("light_dark", 0.5, 3))
    ]
    for believed, true in runs:
        assert abs(excess(believed, true)) <= BAND
    believed, true = (np.concatenate(values) for values in zip(*runs, strict=True))
    assert abs(excess(believed, true)) <= BAND
    # There were failures to count, and a rule that overstates by 10 % would have been found out.
    assert (~true).sum() >= 5
    assert abs(excess(np.minimum(believed + 0.1, 0.999), true)) > BAND
