"""The 95 % intervals of a final fit hold the truth about that often (the whole table: benchmarks/fit_coverage.py)."""

from __future__ import annotations

import numpy as np
import pytest
from fit_coverage import Case, covered
from scipy.stats import binom

RARELY = 1e-4  # chance that a sound interval fails a bound below


def least_hits(trials: int, share: float) -> int:
    """Hits that an interval of a share of coverage hardly ever stays below."""
    return int(binom.ppf(RARELY, trials, share))


@pytest.mark.sweep
@pytest.mark.parametrize("wander", [0.0, 1.5])
def test_intervals_of_a_door_hold_the_truth(wander: float) -> None:
    found = covered(Case("revolute", rows=60, wander=wander), 60)
    assert (found.share * 60 >= least_hits(60, 0.93) - 0.5).all()
    # Intervals that always hold would be too wide by far.
    assert (found.claimed < 2.2 * found.real).all()


@pytest.mark.evidence
@pytest.mark.parametrize("wander", [0.0, 1.5])
@pytest.mark.parametrize("has_orientation", [True, False])
@pytest.mark.parametrize("kind", ["rigid", "prismatic", "revolute", "screw"])
def test_coverage_is_what_it_says(kind: str, has_orientation: bool, wander: float) -> None:
    hidden = kind == "screw" and not has_orientation
    trials = 100 if hidden else 300
    # A short piece of a helix looks like a piece of a circle: positions alone need more of it.
    arc = 2.4 if hidden else 0.9
    found = covered(Case(kind, has_orientation, 100, arc, 0.2, wander), trials)
    assert (found.share * trials >= least_hits(trials, 0.93) - 0.5).all()
    # Parameters share their errors, so their mean is bounded as a single one of them is.
    spread = 3 * np.sqrt(0.95 * 0.05 / trials)
    assert 0.93 - spread < found.share.mean() < 0.97 + spread
    assert (found.claimed < 1.8 * found.real).all()


@pytest.mark.evidence
@pytest.mark.parametrize("wander", [0.0, 1.5])
def test_a_screw_that_positions_hardly_determine_has_a_wide_interval(wander: float) -> None:
    """On 17 degrees its pitch is open: 70 of 100 and fewer intervals of the likeliest screw held it."""
    trials = 60
    found = covered(Case("screw", False, 100, 0.3, 0.4, wander), trials)
    assert found.share.mean() > 0.95 - 3 * np.sqrt(0.95 * 0.05 / trials)
    assert (found.share * trials >= least_hits(trials, 0.93) - 0.5).all()


@pytest.mark.evidence
def test_slow_wander_ends_what_intervals_can_promise() -> None:
    fast = covered(Case("revolute", rows=150, wander=1.5, memory=5.0), 150)
    slow = covered(Case("revolute", rows=150, wander=1.5, memory=150.0), 150)
    assert fast.share.mean() > 0.93
    # A wander that takes as long as the recording is, to any fit, another joint.
    assert slow.share.mean() < fast.share.mean()
