"""When a model is worth its parameters: held-out rows are predicted better, by more than chance and not in one run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.residual.coordinate_data import CoordinateData
from micah_plan.residual.likelihood import EVIDENCE_PER_ROW, LEAST_EVIDENCE
from micah_plan.residual.search import Scored, Search, TermCandidate
from micah_plan.residual.simulation import GATES

# Standard errors by which the gain must exceed what other segments lose.
_ERRORS = 2.0
# Of an effect's evidence, so much outside of the run that gains most (of the only run: the segment), by so many times
# what others lose (as a root of squares).
ELSEWHERE = 4.0
# What one-step errors may be of those before.
_SHORTER = 0.999


def ranked(scored: Sequence[Scored]) -> list[Scored]:
    """Best first."""
    return sorted(scored, key=lambda model: -float(model.density.sum()))


def is_worth(better: Scored, base: Scored, data: CoordinateData) -> bool:
    """Whether held-out rows are predicted so much better that it is no chance, and not in a single run alone."""
    gains = better.density - base.density
    gain = float(gains.sum())
    if better.squared >= base.squared or gain <= max(LEAST_EVIDENCE, EVIDENCE_PER_ROW * int(data.counted.sum())):
        return False
    losses = float(np.sqrt((np.minimum(gains, 0.0) ** 2).sum()))
    if gain <= _ERRORS * losses or elsewhere(gains, data) <= ELSEWHERE:
        return False
    # What began in one run makes the noise of all smaller, which is no evidence from those before.
    has_begun = any(map(begins_later, better.parts[-1:]))
    return not has_begun or elsewhere(better.density - better.without_last, data) > ELSEWHERE


def elsewhere(gains: Floats, data: CoordinateData) -> float:
    """What segments (S,) gain outside of the run (of the only one: the segment) that gains most [nats]."""
    runs, of_run = np.unique(data.run, return_inverse=True)
    if len(runs) > 1:  # rows of one run share what is particular to it
        gains = np.asarray(np.bincount(of_run, gains))
    gained = np.maximum(gains, 0.0)
    return float(gained.sum() - gained.max(initial=0.0))


def improves(search: Search, better: Scored, base: Scored) -> bool:
    """Whether a model is worth it and one-step errors get smaller too."""
    return is_worth(better, base, search.data) and shortens(search, better, base)


def shortens(search: Search, better: Scored, base: Scored) -> bool:
    """Whether held-out one-step errors get smaller."""
    return search.one_step_squares(better) < _SHORTER * search.one_step_squares(base)


def begins_later(part: TermCandidate) -> bool:
    """Whether a part acts since some place in the recording only."""
    return bool(np.isfinite(part.starts[0, -GATES]))
