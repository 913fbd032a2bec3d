"""Acceptance of plans by their roll-outs, at verification and when a file is read."""

from __future__ import annotations

import math

from micah_plan.errors import InputError
from micah_plan.task.plan import Plan, Trajectory

# The share of successes may fall short of the confidence by that many of its standard errors.
_STANDARD_ERRORS = 2.0
# Probability that a plan just below a confidence passes as many roll-outs as show it.
_LUCK = 0.05


def least_trials(confidence: float) -> int:
    """The number of successful roll-outs that establishes a confidence beyond chance.

    With that many in a row, a plan that succeeds less often is excluded at 95 % (the exact rule of three).
    """
    return math.ceil(math.log(_LUCK) / math.log(confidence))


def least_share(confidence: float, trials: int) -> float:
    """The smallest success rate at which a plan is accepted.

    It is two standard errors below the confidence, those of a plan whose true probability is the confidence: the
    standard error of the observed share would vanish where nothing succeeds.
    """
    return confidence - _STANDARD_ERRORS * math.sqrt(confidence * (1.0 - confidence) / max(trials, 1))


def executable_trajectory(plan: Plan, *, anyway: bool = False, source: str | None = None) -> Trajectory:
    """The trajectory of a solved plan.

    Args:
        anyway: whether one that was found but not verified will do.
        source: the file that the plan is in.

    Raises:
        InputError: if the plan has another outcome.
    """
    if plan.trajectory is not None and (plan.outcome == "solved" or anyway):
        return plan.trajectory
    remedy = "only a solved plan can be executed"
    if plan.trajectory is not None:
        remedy += "; `execute --anyway` shows in simulation how this one fails"
    raise InputError(f"plan has outcome {plan.outcome}: {plan.reason}", source=source, remedy=remedy)
