"""Runs that deviate from the others: an obstacle, a lost tracker, or a hand that slipped.

No other run can confirm what a single run shows. If it is kept, it increases the estimated noise of all runs and hides
what they share; so it is excluded and reported. A last block of such runs may be no fault: something changed there that
no effect with an onset explains.

Source: the F test of two variances, the run's against that of the run in the middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from micah_plan.arrays import Floats
from micah_plan.message import Message
from micah_plan.residual import messages
from micah_plan.residual.contenders import Contender
from micah_plan.residual.fitting import ENOUGH_INDEPENDENT
from micah_plan.residual.trace import CoordinateTrace

_MOST_SHARE = 0.25  # of the runs: more of them are no exception
_LEAST_RATIO = 3.0  # of the errors: what every effect looks like in the run that shows it most
_CHANCE = 1e-6  # of one such run among all, if errors are noise


@dataclass(frozen=True)
class FaultyRun:
    """A deviating run, with its one-step error and that of the others [rad or m].

    Attributes:
        is_lasting: whether all later runs are like it; then something may have changed, and it is no fault.
    """

    run: int
    coordinate: str
    unit: str
    error: float
    usual: float
    is_lasting: bool

    def __str__(self) -> str:
        return messages.outlying_run(self.coordinate, self.unit, self.run, self.error, self.usual)

    @property
    def advice(self) -> Message:
        """The finding with its consequence for the user."""
        advice = messages.lasting_change if self.is_lasting else messages.faulty_run
        return advice(self.coordinate, self.unit, self.run, self.error, self.usual)


def faulty_runs(traces: Sequence[CoordinateTrace]) -> tuple[FaultyRun, ...]:
    """Runs that no effect explains, if few, each for the coordinate with the largest error."""
    worst: dict[int, FaultyRun] = {}
    for trace in traces:
        data, runs = trace.data, np.unique(trace.data.run)
        others = () if trace.outcome.verdict == "explained" else trace.alternatives
        tried = [_errors_by_run(trace, model) for model in (trace.chosen, *others)]
        by_run = min(tried, key=_median_error)
        for faulty in outlying_runs(runs.tolist(), by_run, data.coordinate, data.unit):
            before = worst.get(faulty.run)
            if before is None or faulty.error / faulty.usual > before.error / before.usual:
                worst[faulty.run] = faulty
    return tuple(worst[run] for run in sorted(worst))


def _errors_by_run(trace: CoordinateTrace, model: Contender) -> list[Floats]:
    """One-step errors of each run [rad or m]."""
    data, errors = trace.data, trace.held_out.errors(model, "one_step")
    return [errors[data.run == run][data.counted[data.run == run]] for run in np.unique(data.run)]


def _median_error(errors: Sequence[Floats]) -> float:
    """Median over runs of the mean square error: robust against a minority of bad runs.

    Source: Rousseeuw, "Least median of squares regression", JASA 1984.
    """
    return float(np.median([float(np.mean(run**2)) for run in errors if len(run)] or [0.0]))


def outlying_runs(runs: Sequence[int], errors: Sequence[Floats], coordinate: str, unit: str) -> list[FaultyRun]:
    """Runs whose one-step errors (one array per run, [rad or m]) are far larger than the median run's."""
    if len(runs) < ENOUGH_INDEPENDENT:
        return []
    rows = np.array([len(run) for run in errors])
    squares = np.array([float(np.mean(run**2)) if len(run) else 0.0 for run in errors])
    usual = _median_error(errors)
    if usual <= 0.0:
        return []
    ratio = squares / usual
    is_odd = (ratio > _LEAST_RATIO**2) & (fdtrc(rows, rows.sum() - rows, ratio) < _CHANCE / len(runs))
    if not 0 < is_odd.sum() <= _MOST_SHARE * len(runs):
        return []
    is_lasting = bool(is_odd[int(np.argmax(is_odd)) :].all())
    return [
        FaultyRun(runs[k], coordinate, unit, float(np.sqrt(squares[k])), float(np.sqrt(usual)), is_lasting)
        for k in np.flatnonzero(is_odd).tolist()
    ]
