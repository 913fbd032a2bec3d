"""With how many successes among roll-outs a plan is accepted: where it is verified, and where a plan file is read."""

from __future__ import annotations

import math

# The share of successes may fall short of the confidence by that many of its standard errors.
_STANDARD_ERRORS = 2.0


def least_share(confidence: float, trials: int) -> float:
    """The smallest share of successes among the roll-outs with which a plan is accepted.

    It lies two standard errors below the confidence, those of a plan whose true probability is the confidence: the
    standard error of the observed share would vanish where nothing succeeds.
    """
    return confidence - _STANDARD_ERRORS * math.sqrt(confidence * (1.0 - confidence) / max(trials, 1))
