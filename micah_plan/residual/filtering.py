"""Log density of every row of a coordinate under many hypotheses at once.

A hypothesis is a model (terms with parameters) with its own noise. The state is the configuration c and a wandering
measurement error d: c⁺ = F(c, v, memory) + w, d⁺ = ρ d + e, measured as h(c) + d + ν. Each step is a Kalman prediction
and update, so every residual is an innovation, white if the hypothesis is true (Kailath, Sayed and Hassibi, "Linear
Estimation", ch. 9). The density of a row is Student's t, and an outlying row moves the state less (Agamennoni, Nieto
and Nebot, "Approximate inference in state-space models with heavy-tailed noise", IEEE TSP 2012). At the start of a log
the part may still respond to commands before it: there an outlying row also increases the state's variance (Roth, Ozkan
and Gustafsson, "A Student's t filter for heavy tailed process and measurement noise", ICASSP 2013), so that the filter
converges again.

All hypotheses of a model go through the rows side by side, in a loop that is compiled (`row_loop`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from micah_plan.arrays import ROUND_OFF, SURE_STDS, Floats, Ints, Scalar
from micah_plan.automaton.effects.form import EffectForm, Layer
from micah_plan.residual.candidates import GATES, Model, term_columns
from micah_plan.residual.coordinate_data import UNSEEN, CoordinateData
from micah_plan.residual.row_loop import (
    FILTER,
    ONE_STEP,
    RELEASE_HIGH,
    RELEASE_LOW,
    ROLLOUT,
    RowsGiven,
    Settings,
    run_rows,
)
from micah_plan.residual.step_program import model_program
from micah_plan.symbolic.formula_lines import Neutral

Kind = Literal["filter", "one_step", "rollout"]
_KINDS: dict[Kind, int] = {"filter": FILTER, "one_step": ONE_STEP, "rollout": ROLLOUT}

STDS = ("white", "process", "motion", "wander")
"""Stds: of a reading; of what moves the part in a step, always and with a command of the usual size; of a reading's
error that wanders."""
NOISE = (*STDS, "low", "high")
"""Logs of `STDS` [of rad or m], and by how much the ends of the range are beside those that are known [rad or m]."""
# Correlation of the wandering error from row to row. Fitted, it comes near 1 and takes what a model lacks for noise.
_STAYS = 0.9
# Share of the variance that is left where something holds the part: a stop is no perfect pin.
_HELD_VARIANCE = 0.05
# Share of rows that may lie anywhere in the range (Box and Tiao, Biometrika 1968: contaminated normal).
_ANYWHERE = 1e-3


@dataclass(frozen=True, eq=False)
class ModelBatch:
    """B hypotheses of one model with different parameters and noise.

    Attributes:
        model: the terms.
        values: (B, columns) parameters of the terms, gates included.
        noise: (B, 6) see `NOISE`.
        freedom: (B,) degrees of freedom of the t distribution: even numbers, so that powers are cheap.
    """

    model: Model
    values: Floats
    noise: Floats
    freedom: Floats

    def __post_init__(self) -> None:
        if (self.freedom % 2.0).any():
            raise ValueError("degrees of freedom must be even")

    def __len__(self) -> int:
        return len(self.values)

    @cached_property
    def gated(self) -> tuple[bool, ...]:
        """Whether each term has an onset in some of the hypotheses."""
        gates = (self.values[:, columns.stop - GATES : columns.stop] for columns in term_columns(self.model))
        return tuple(bool((own != -np.inf).any()) for own in gates)

    @cached_property
    def neutral(self) -> tuple[Neutral, ...]:
        """Which parameters of each term are neutral in all hypotheses."""
        starts = (columns.start for columns in term_columns(self.model))
        return tuple(
            tuple(
                parameter.neutral is not None and bool((self.values[:, start + k] == parameter.neutral).all())
                for k, parameter in enumerate(term.form.parameters)
            )
            for term, start in zip(self.model, starts, strict=True)
        )

    def terms(self, layer: Layer) -> list[tuple[EffectForm, Floats]]:
        """Forms of a layer with their parameters (k, B)."""
        pairs = zip(self.model, term_columns(self.model), strict=True)
        return [
            (term.form, self.values[:, columns.start : columns.stop - GATES].T)
            for term, columns in pairs
            if term.form.layer == layer
        ]


@dataclass(frozen=True, eq=False)
class Rows:
    """Filter results of B hypotheses on the N counted rows, in the order of `of_rows`.

    Attributes:
        total: (B,) log density of all rows [nats].
        error: (K, N) measured minus predicted [rad or m], of the hypotheses that were requested. variance: (K, N) of
            it.
        freedom: (K,) of the t distribution. anywhere: density of a row that may lie anywhere in the range.
    """

    total: Floats
    error: Floats
    variance: Floats
    freedom: Floats
    anywhere: float

    def density(self, own: slice = slice(None)) -> Floats:
        """(k, N) log density of each row under the hypotheses `own` [nats]."""
        variance, freedom = self.variance[own], self.freedom[own][:, None]
        half = 0.5 * (freedom + 1.0)
        far = np.log1p(np.square(self.error[own]) / (variance * freedom))
        density = _peak(freedom) * np.exp(-half * far) / np.sqrt(variance)
        return np.asarray(np.log(density + self.anywhere))


def _peak(freedom: Floats) -> Floats:
    """Density of Student's t of unit scale at 0."""
    half = 0.5 * (freedom + 1.0)
    return np.asarray(np.exp(gammaln(half) - gammaln(0.5 * freedom)) / np.sqrt(freedom * np.pi))


def filtered(data: CoordinateData, batches: Sequence[ModelBatch], wanted: Sequence[int] | None = None) -> Rows:
    """Filter results of all hypotheses, batch by batch.

    Args:
        wanted: of how many of each batch, its first ones, errors are wanted as well; None: of all.
    """
    wanted = [len(batch) for batch in batches] if wanted is None else wanted
    total, error, variance = _run_batches(data, batches, "filter", data.numbered, wanted)
    freedom = np.concatenate([batch.freedom[:count] for batch, count in zip(batches, wanted, strict=True)])
    return Rows(total, error, variance, freedom, _anywhere(data))


def _anywhere(data: CoordinateData) -> float:
    """Density of an outlier, uniform over several times the visited range [1/rad or 1/m]."""
    low, high = data.visited
    return _ANYWHERE / max(high - low, ROUND_OFF)


def of_rows(data: CoordinateData, of_segment: Ints) -> Ints:
    """(N,) value of each counted row's segment (S,), segment by segment."""
    return np.asarray(np.broadcast_to(of_segment[:, None], data.counted.shape)[data.counted])


def errors(data: CoordinateData, batches: Sequence[ModelBatch], kind: Kind) -> tuple[Floats, Floats]:
    """(B, S, T) measured minus predicted [rad or m], 0 in uncounted rows, and its variance."""
    every = np.arange(data.z.size).reshape(data.z.shape)
    _, *found = _run_batches(data, batches, kind, every, [len(batch) for batch in batches])
    error, variance = (rows.reshape(-1, *data.z.shape) for rows in found)
    return error * data.counted, variance


def _run_batches(
    data: CoordinateData, batches: Sequence[ModelBatch], kind: Kind, number: Ints, wanted: Sequence[int]
) -> tuple[Floats, Floats, Floats]:
    """(B,) log densities, and (K, N) errors and variances of rows with a non-negative number (S, T)."""
    sizes = np.array([len(batch) for batch in batches])
    at, first = np.full(int(sizes.sum()), -1), np.cumsum(sizes) - sizes
    for start, count, before in zip(first, wanted, np.cumsum(wanted) - wanted, strict=True):
        at[start : start + count] = before + np.arange(count)
    shape = sum(wanted), int(number.max()) + 1
    total, error, variance = np.zeros(len(at)), np.zeros(shape), np.ones(shape)
    rows, by_instructions = (
        _rows_given(data, number),
        dict[tuple[Model, tuple[bool, ...], tuple[Neutral, ...]], list[int]](),
    )
    for k, batch in enumerate(batches):
        by_instructions.setdefault((batch.model, batch.gated, batch.neutral), []).append(k)
    # All hypotheses of a model share its instructions.
    for instructions, own in by_instructions.items():
        batch, program = _joined([batches[k] for k in own]), model_program(*instructions)
        per_hypothesis = _per_hypothesis(data, batch)
        of = np.concatenate([np.arange(first[k], first[k] + sizes[k]) for k in own])
        total[of] = run_rows(
            program.programs,
            _rows_for(data, rows, batch, program.mode_sets),
            _settings(data, batch, kind, per_hypothesis),
            batch.values.T.copy(),
            per_hypothesis,
            at[of],
            error,
            variance,
        )
    return total, error, variance


def _rows_for(
    data: CoordinateData, rows: RowsGiven, batch: ModelBatch, mode_sets: Sequence[tuple[str, ...]]
) -> RowsGiven:
    """The rows with the commands, ends and modes of a model."""
    in_mode = np.zeros((len(mode_sets), len(data.modes)), dtype=bool)
    for k, names in enumerate(mode_sets):
        in_mode[k] = [name in names for name in data.modes]
    # What a sensor reads beyond the model's range need not lie there.
    given = data.ends_of_model if batch.terms("sensor") else (data.lower, data.upper)
    return rows._replace(
        moved=_commands(data, data.action, batch) if batch.terms("frame") and data.action is not None else rows.moved,
        ends=np.reshape(given, (2, 1, 1)) if data.row_ends is None else _contiguous(data.row_ends),
        in_mode=in_mode,
    )


def _settings(data: CoordinateData, batch: ModelBatch, kind: Kind, per_hypothesis: Floats) -> Settings:
    return Settings(
        kind=_KINDS[kind],
        is_bounded=bool(np.isfinite([data.lower, data.upper]).any() or batch.terms("guard")),
        is_held=bool((per_hypothesis[RELEASE_LOW : RELEASE_HIGH + 1] > 0.0).any()),
        surely=SURE_STDS * data.blur,
        unseen=UNSEEN,
        anywhere=_anywhere(data),
        stays=_STAYS,
        held_variance=_HELD_VARIANCE,
    )


def _rows_given(data: CoordinateData, number: Ints) -> RowsGiven:
    return RowsGiven(
        z=_contiguous(data.z),
        moved=_contiguous(data.u[None]),
        effort=_contiguous((data.u / data.command_size) ** 2),
        place=_contiguous(data.place),
        noise=_contiguous(data.noise),
        time=_contiguous(data.time),
        order=_contiguous(data.order),
        mode=_contiguous(data.mode),
        ends=np.zeros((2, 1, 1)),
        # What moves on need not have begun here: the second row of a segment that goes on is taken as measured.
        goes_on=_contiguous(np.where(data.goes_on, data.command_size**2, 0.0)),
        moving=_contiguous(data.moving),
        # Those of hypotheses that read actions in another frame are a little different.
        earlier=_contiguous(data.earlier),
        in_mode=np.zeros((0, len(data.modes)), dtype=bool),
        last=data.z.shape[1] - 1 - np.argmax((number >= 0)[:, ::-1], axis=1),
        number=_contiguous(number),
    )


def _contiguous(rows: NDArray[Scalar]) -> NDArray[Scalar]:
    """The rows as a C-contiguous writable array, so that Numba compiles one signature."""
    return np.require(rows, requirements=("C", "W"))


def _joined(batches: Sequence[ModelBatch]) -> ModelBatch:
    """All hypotheses of several batches of one model."""
    if len(batches) == 1:
        return batches[0]
    values, noise, freedom = (
        np.concatenate([getattr(batch, name) for batch in batches]) for name in ("values", "noise", "freedom")
    )
    return ModelBatch(batches[0].model, values, noise, freedom)


def _per_hypothesis(data: CoordinateData, batch: ModelBatch) -> Floats:
    """(10, B) noise and ends of each hypothesis, in the order of `row_loop.WHITE` and so on."""
    release = np.repeat(np.array(data.release)[:, None], len(batch), axis=1)
    for form, p in batch.terms("guard"):
        needed = form.release(list(p))
        for side in np.flatnonzero(data.clings):
            release[side] = np.maximum(release[side], needed)
    variances, beside = np.exp(2.0 * batch.noise[:, : len(STDS)]).T, batch.noise[:, len(STDS) :].T
    return np.concatenate([variances, batch.freedom[None], beside, release, _peak(batch.freedom)[None]])


def _commands(data: CoordinateData, action: Floats, batch: ModelBatch) -> Floats:
    """(B, S, T) commands under hypotheses that rotate the frame of actions (S, T, 3)."""
    ((form, p),) = batch.terms("frame")
    parts, wide = list(np.moveaxis(action, -1, 0)), [value[:, None, None] for value in p]
    meant = np.stack([form.frame_command(np, parts, list(unit), wide) for unit in np.eye(3)], axis=-1)
    places = np.broadcast_to(data.z, meant.shape[:-1])
    u = data.path.commanded(places.ravel(), meant.reshape(-1, 3))
    return _contiguous(np.nan_to_num(u).reshape(meant.shape[:-1]))


def noiseless_data(data: CoordinateData, hypothesis: ModelBatch, mode_at: Callable[[Floats], Ints]) -> CoordinateData:
    """The data with measurements replaced by one hypothesis' noise-free prediction from the same starts and commands.

    Args:
        mode_at: index of the mode at configurations.
    """
    every = np.arange(data.z.size).reshape(data.z.shape)
    z = np.where(np.arange(data.z.shape[1]) == 0, data.z, 0.0)
    made = replace(data, z=data.z.copy())
    # A row's mode and place depend on the rows before, so that each round gets at least one more of them right.
    for _ in range(data.z.shape[1]):
        before = made.z
        made = replace(made, place=before + data.u, mode=mode_at(before).reshape(before.shape))
        _, error, _ = _run_batches(replace(made, z=z), [hypothesis], "rollout", every, [1])
        made = replace(made, z=z - error.reshape(z.shape))
        if np.array_equal(made.z, before):
            break
    return made
