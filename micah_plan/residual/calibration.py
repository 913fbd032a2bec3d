"""Result of a calibration as values: effects with their evidence, errors before and after, and the new model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.message import Message
from micah_plan.recording.value import Recording
from micah_plan.residual.messages import Verdict
from micah_plan.residual.prediction import RunPrediction, predict_recording, refused, rmse, rmse_of_coordinates
from micah_plan.residual.trace import CoordinateTrace

# Rows whose poses are predicted for the report.
_POSE_ROWS = 2000


@dataclass(frozen=True, eq=False)
class FoundEffect:
    """An identified effect with its uncertainty and alternatives.

    Attributes:
        effect: as in the new automaton.
        units: of its parameters.
        interval: (low, high) of each parameter at 95 %; low = high for one that was not fitted.
        evidence: loss of held-out predictions without it [nats].
        tied: other effects that would do as well.
        derived: (name, value) of parameters in other units: times in s where the effect has steps.
        sentence, source: of its form.
        experiment: the one that separates it from the effects it is tied with; empty if there are none.
        is_added: whether the new automaton has it; not if it may as well come from earlier commands, if one of few runs
            contradicts it, or if the automaton would refuse the recording.
    """

    effect: Effect
    units: tuple[str, ...]
    interval: tuple[tuple[float, float], ...]
    evidence: float
    tied: tuple[str, ...]
    derived: tuple[tuple[str, float], ...]
    sentence: str
    source: str
    experiment: str
    is_added: bool = True

    @property
    def rows(self) -> tuple[tuple[str, float, str, float, float], ...]:
        """(name, value, unit, interval) of each parameter, without options at their neutral values."""
        every, stated = zip(self.effect.parameters, self.units, self.interval, strict=True), self._stated
        return tuple((name, value, unit, *ends) for (name, value), unit, ends in every if name in stated)

    @property
    def _stated(self) -> list[str]:
        return form(self.effect.name).stated(self.effect.parameters)


@dataclass(frozen=True)
class ResidualSize:
    """Root mean square errors over held-out rows: of the configuration [rad or m]; of positions [m] for geometry."""

    one_step: float
    rollout: float


@dataclass(frozen=True)
class Errors:
    """Errors in one unit: `of` a coordinate, or of all together; `unit` applies to all numbers, floors included."""

    of: str
    unit: str
    before: ResidualSize
    after: ResidualSize
    noise_floor: float
    rollout_floor: float


@dataclass(frozen=True, eq=False)
class Calibration:
    """Result of a calibration.

    Attributes:
        automaton: the calibrated one; the nominal one if nothing was found.
        effects: strongest first.
        before, after: errors on runs or segments that the parameters were not fitted to.
        noise_floor, rollout_floor: errors of one step and of roll-outs from noise alone [rad or m].
        unexplained_fraction: share of the explainable error that named effects leave, 0 to 1.
        traces: per coordinate.
        notes: conclusions and their limits, one sentence each.
        experiment: the most informative next one.
        nominal, recording: inputs of the calibration, without excluded runs.
        reviewed: the calibration that keeps the effects of an earlier one, where this one has others in their place.
    """

    automaton: HybridAutomaton
    verdict: Verdict
    effects: tuple[FoundEffect, ...]
    before: ResidualSize
    after: ResidualSize
    noise_floor: float
    rollout_floor: float
    unexplained_fraction: float
    traces: tuple[CoordinateTrace, ...]
    notes: tuple[Message, ...]
    experiment: str
    nominal: HybridAutomaton
    recording: Recording
    reviewed: Calibration | None = None

    @property
    def least(self) -> float:
        """Minimum log evidence of an additional effect [nats]."""
        return max(trace.held_out.competition.least for trace in self.traces)

    @property
    def errors(self) -> tuple[Errors, ...]:
        """Errors before and after: of positions if the geometry changed, else of all coordinates or of each unit's."""
        units = {trace.data.unit for trace in self.traces}
        if any(form(effect.effect.name).layer == "geometry" for effect in self.effects):
            return (Errors("positions", "m", self.before, self.after, self.noise_floor, self.rollout_floor),)
        if len(units) == 1:
            return (Errors("", units.pop(), self.before, self.after, self.noise_floor, self.rollout_floor),)
        traces = zip((self.reviewed or self).traces, self.traces, strict=True)
        sizes = [(size_of([before], is_final=False), size_of([after], is_final=True)) for before, after in traces]
        return tuple(
            Errors(trace.data.coordinate, trace.data.unit, before, after, trace.floor, trace.rollout_floor)
            for trace, (before, after) in zip(self.traces, sizes, strict=True)
        )

    @cached_property
    def _runs(self) -> tuple[RunPrediction, ...]:
        """All runs predicted by the new model; empty where it refuses one."""
        return () if refused(self.automaton, self.recording) else predict_recording(self.automaton, self.recording)

    @cached_property
    def written(self) -> tuple[ResidualSize, ...]:
        """Errors of each coordinate with the new model over its whole recording [rad or m], as `predict` computes them.

        `after` is of rows that the parameters were not fitted to. Empty where `predict` refuses these runs.
        """
        if not self._runs:
            return ()
        sizes = (rmse_of_coordinates([getattr(run, name) for run in self._runs]) for name in ("one_step", "rollout"))
        return tuple(ResidualSize(*of_kind) for of_kind in zip(*sizes, strict=True))

    @cached_property
    def predicted(self) -> tuple[list[RunPrediction], list[RunPrediction]]:
        """Some runs predicted before and after; empty where either model refuses them."""
        if not self._runs or refused(self.nominal, self.recording):
            return [], []
        chosen = spread_runs(self.recording, _POSE_ROWS)
        before = predict_recording(self.nominal, self.recording, runs=chosen)
        return list(before), [run for run in self._runs if run.run in chosen]

    @cached_property
    def pose_errors(self) -> tuple[tuple[str, str, ResidualSize, ResidualSize], ...]:
        """(quantity, unit, before, after) of positions [m] and orientations [rad], over all rows of `predicted`."""
        sizes = [pose_sizes(runs) for runs in self.predicted if runs]
        if not sizes:
            return ()
        names = ("positions", "m"), ("orientations", "rad")
        return tuple((*name, *both) for name, both in zip(names, zip(*sizes, strict=True), strict=False))


def size_of(traces: Sequence[CoordinateTrace], *, is_final: bool) -> ResidualSize:
    """Errors over all coordinates of the nominal or of the final model, on held-out rows."""
    models = [(trace, trace.final if is_final else trace.nominal) for trace in traces]
    steps = [trace.held_out.errors(model, "one_step")[trace.data.counted] for trace, model in models]
    rolls = [trace.held_out.rollout_errors(model) for trace, model in models]
    one_step, rollout = (float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) for errors in (steps, rolls))
    return ResidualSize(one_step, rollout)


def spread_runs(recording: Recording, most: int) -> tuple[int, ...]:
    """Numbers of runs with two rows or more: all, or a subset spread over the recording with about `most` rows."""
    able = tuple(run for run in recording.runs if len(np.unique(recording.time[recording.index(run=run)])) > 1)
    count = max(1, min(len(able), len(able) * most // max(len(recording.time), 1)))
    return tuple(able[k] for k in np.linspace(0, len(able) - 1, count).astype(int).tolist())


def pose_sizes(runs: Sequence[RunPrediction]) -> list[ResidualSize]:
    """Errors of positions [m] and, where they were measured, orientations [rad]."""
    kinds = [[run.one_step for run in runs], [run.rollout for run in runs]]
    sizes = [ResidualSize(*(rmse([error.position for error in kind]) for kind in kinds))]
    turns = [[error.rotation for error in kind if error.rotation is not None] for kind in kinds]
    return [*sizes, ResidualSize(*map(rmse, turns))] if all(turns) else sizes
