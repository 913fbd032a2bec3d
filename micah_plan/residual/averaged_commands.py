"""Commands averaged over neighbouring rows: the signature of a recording that was smoothed, which no object shows.

Poses smoothed by a filter without delay move as the average of the commands in rows before and after. So does a part
whose commands were recorded with errors, since its own steps vary less than the recorded ones. No part can respond to
future commands, so what a two-sided average explains is a property of the recording and is not added to a model.
Effects that depend on earlier commands (`lag`, `delay`, `follow`) imitate it badly, but would be found if nothing else
competed.

The weights are symmetric, estimated by least squares from measured steps, and sum to 1: the share of a command that is
carried out is a gain, which is an effect.

Sources: Savitzky and Golay, "Smoothing and differentiation of data by simplified least squares procedures", Analytical
Chemistry 1964 (symmetric weights cause no delay); Schwarz, Annals of Statistics 1978 (penalty per weight).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from micah_plan.arrays import Floats, Ints, Scalar
from micah_plan.residual.candidates import FOLLOW
from micah_plan.residual.competition import Standings
from micah_plan.residual.contenders import Contenders, best_first, with_other_noise
from micah_plan.residual.coordinate_data import CoordinateData
from micah_plan.residual.filtering import STDS
from micah_plan.residual.fitting import Fitting
from micah_plan.residual.likelihood import FREEDOM, robust_log_density

# Rows on each side that are tried.
_REACHES = (1, 2, 3, 4, 6, 8, 10)
# Share of commands that must arrive for their weights to mean anything.
_LEAST_GAIN = 0.1
# Steps that determine a weight.
_ROWS_PER_WEIGHT = 10
# Effects that are tried on averaged commands besides the model itself, and rounds of their fits.
_EFFECTS, _ROUNDS = 8, 6


@dataclass(frozen=True, eq=False)
class Average:
    """Symmetric weights (k + 1,): of the command of the row itself, then of the rows at distance 1 to k."""

    weights: Floats

    @property
    def reach(self) -> int:
        """Rows on each side."""
        return len(self.weights) - 1


def with_averages(data: CoordinateData, average: Average) -> CoordinateData:
    """The data, and its whole runs, with averaged commands, which are displacements."""
    runs = data if data.whole is None else data.whole
    u, action = np.zeros(data.rows), np.zeros((data.rows, 3))
    for s, steps in enumerate(_steps(runs)):
        own = _number(runs)[s, :steps]
        u[own] = _beside(runs.u[s, :steps], average.reach) @ _both_sides(average)
        if runs.action is not None:
            action[own] = _beside(runs.action[s, :steps], average.reach) @ _both_sides(average)

    def changed_in(rows: CoordinateData) -> CoordinateData:
        is_step = np.arange(rows.u.shape[1]) < _steps(rows)[:, None]
        changed = np.where(is_step, u[_number(rows)], rows.u)
        vectors = None if rows.action is None else np.where(is_step[:, :, None], action[_number(rows)], rows.action)
        return replace(rows, u=changed, place=rows.place + changed - rows.u, action=vectors, meaning="displacement")

    whole = None if data.whole is None else changed_in(data.whole)
    return replace(changed_in(data), whole=whole)


def _number(data: CoordinateData) -> Ints:
    """(S, T) number of each row in the recording."""
    return np.asarray(np.rint(data.order * data.rows), dtype=np.int64) % data.rows


def _steps(data: CoordinateData) -> Ints:
    """(S,) number of steps of each segment up to its last counted row."""
    return np.asarray(np.where(data.counted, np.arange(data.counted.shape[1]), 0).max(axis=1))


def _beside(values: NDArray[Scalar], reach: int) -> NDArray[Scalar]:
    """(n, ..., 2 reach + 1) values (n, ...) of the rows around each; 0 outside."""
    padded = np.pad(values, [(reach, reach), *[(0, 0)] * (values.ndim - 1)])
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=0)


def _both_sides(average: Average) -> Floats:
    """(2 k + 1,) weights from the earliest to the latest row."""
    return np.concatenate([average.weights[:0:-1], average.weights])


def likeliest_average(contenders: Contenders, standings: Standings) -> Average | None:
    """The average of commands under which a recording is likeliest; None if effects on the recorded commands do better.

    None if there is none, or if commands are places, of which a response is as smooth.
    """
    nominal = standings.nominal
    rivals = (standings.chosen, *standings.remaining)
    average = None if contenders.has_places or rivals == (nominal,) else weights_of_steps(contenders.data)
    if average is None:
        return None
    data = with_averages(contenders.data, average)
    of_weights = _cost_of(average.reach, int(data.counted.sum()))
    least = max(model.evidence for model in rivals) + contenders.least + of_weights
    fitting = Fitting(data)
    fits = fitting.improved([nominal.fit, *with_other_noise(nominal.fit)], _ROUNDS)
    quiet = min(fits, key=lambda fit: fit.loss)
    # Something may be missing of the model as well.
    effects = [model for model in best_first(standings.singles) if FOLLOW not in model.names][:_EFFECTS]
    fits = [quiet, *fitting.improved([model.fit.with_noise(quiet.noise[: len(STDS)]) for model in effects], _ROUNDS)]
    return average if max(weighed.evidence for weighed in fitting.weighed(fits)) > least else None


def weights_of_steps(data: CoordinateData) -> Average | None:
    """Least-squares weights of measured steps; None if causal commands predict as well, or neither does."""
    of_past, of_both = [], list[tuple[float, Floats]]()
    for reach in _REACHES:
        around, now = _steps_and_commands(data, reach)
        if len(now) < _ROWS_PER_WEIGHT * reach:
            break
        before, after = around[:, reach::-1], around[:, reach:].copy()
        after[:, 1:] += before[:, 1:]
        cost = _cost_of(reach, len(now))
        past, both = (np.column_stack([np.ones(len(now)), commands]) for commands in (before, after))
        of_past.append(robust_log_density(past, now, FREEDOM) - cost)
        weights = np.asarray(np.linalg.lstsq(both, now, rcond=None)[0][1:], dtype=float)
        of_both.append((robust_log_density(both, now, FREEDOM) - cost, weights))
    if not of_both:
        return None
    most, weights = max(of_both, key=lambda tried: tried[0])
    gain = float(weights[0] + 2.0 * weights[1:].sum())
    # What counts the row itself more than once sharpens, as a response to places seems to do.
    is_average = gain > _LEAST_GAIN and 0.0 < weights[0] < gain
    return Average(weights / gain) if most > max(of_past) and is_average else None


def _steps_and_commands(data: CoordinateData, reach: int) -> tuple[Floats, Floats]:
    """(n, 2 reach + 1) commands around each row, from one measurement to the next, and steps (n,) [rad or m]."""
    runs, designs, moved = data.whole or data, list[Floats](), list[Floats]()
    for s, steps in enumerate(_steps(runs)):
        rows, z = np.flatnonzero(runs.is_measured[s, : steps + 1]), runs.z[s, : steps + 1]
        # What an end stops moves by no command.
        is_free = (z > runs.lower + data.command_size) & (z < runs.upper - data.command_size)
        counts = (runs.counted[s, : steps + 1] & _beside(is_free, reach).all(axis=1))[rows[1:]]
        so_far = np.cumsum(np.pad(_beside(runs.u[s, :steps], reach), [(1, 0), (0, 0)]), axis=0)
        designs.append(np.diff(so_far[rows], axis=0)[counts])
        moved.append(np.diff(z[rows])[counts])
    return np.concatenate(designs), np.concatenate(moved)


def _cost_of(reach: int, rows: int) -> float:
    """Bayesian information criterion (Schwarz) for `reach` weights [nats]."""
    return 0.5 * reach * float(np.log(max(rows, 1)))
