"""`predict`: a model against measured motion, and what its errors are worth.

**`calibrate`.** What the model lacks in measured motion, and the model with it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from micah_plan.api import inputs
from micah_plan.api.inputs import Measured, Modelled
from micah_plan.api.result import Result, save_model
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.quantities import common_unit, count, percent, plain, quantity
from micah_plan.recording.commands import CommandKind, with_commands
from micah_plan.recording.value import Recording
from micah_plan.summaries import Progress, Table
from micah_plan.task.experiment import Experiment

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from micah_plan.documents.model_difference import Difference
    from micah_plan.residual.calibration import Calibration, FoundEffect
    from micah_plan.residual.judgement import Judgement
    from micah_plan.residual.missing_mode import MissingMode
    from micah_plan.residual.prediction import PredictionError, RunPrediction
    from micah_plan.residual.range_exceeded import RangeExceeded
    from micah_plan.residual.trace import CoordinateTrace

_SHOWN = {"one_step": "one step", "rollout": "roll-out"}


@dataclass(frozen=True, eq=False, repr=False)
class PredictionResult(Result):
    """What `predict` returns: the predictions of every run, and what their errors are worth."""

    automaton: HybridAutomaton
    recording: Recording
    runs: tuple[RunPrediction, ...]

    @cached_property
    def judgement(self) -> Judgement:
        """Noise floors, what errors follow, and when modes changed."""
        from micah_plan.residual.judgement import judge

        return judge(self.automaton, self.recording, self.runs)

    @property
    def success(self) -> bool:
        """Whether errors look like noise alone."""
        return self.judgement.is_noise is True

    @property
    def outcome(self) -> str:
        """``"noise"``, ``"lacking"`` (the model lacks something) or ``"unknown"``."""
        return {True: "noise", False: "lacking", None: "unknown"}[self.judgement.is_noise]

    @property
    def reason(self) -> str:
        """What errors follow, in words."""
        return self.judgement.sentence

    @cached_property
    def excesses(self) -> tuple[RangeExceeded, ...]:
        """Where the motion went beyond the model's range."""
        from micah_plan.residual.range_exceeded import ranges_exceeded

        return tuple(ranges_exceeded(self.automaton, [run.x for run in self.runs]))

    def report(self) -> list[str | Table]:
        """Errors of both predictions beside what noise alone would leave, what they follow, and when modes changed."""
        summary = self.json()
        coordinates = summary["per_coordinate"]
        rows = list[tuple[str, ...]]()
        for k, (name, text) in enumerate(_SHOWN.items()):
            floor, sizes = summary["noise_floor"][name], [(c[f"{name}_rmse"], c["unit"]) for c in coordinates]
            rows.append((text, *_amounts(summary[name], sizes)))
            if floor:
                floors = [(c["noise_floor"][k], c["unit"]) for c in coordinates]
                rows.append(("  noise alone", *_amounts(floor, floors)))
        names = ("root mean square error", "position", "rotation", *(c["name"] for c in coordinates))
        lines: list[str | Table] = [Table(names, tuple(rows)), self.reason]
        if "estimate" in summary:
            unit = summary["configuration_unit"]
            size, last = (quantity(summary["estimate"][key], unit) for key in ("rmse", "final_error"))
            lines.append(f"what the controller believed was {size} beside what was measured, at the end {last}")
        lines += [str(excess) for excess in self.excesses]
        gaps = sum(run["gaps"] for run in summary["per_run"])
        if gaps:
            lines.append(f"{count(gaps, 'gap')} in t: rows are missing, so roll-outs begin anew after each")
        return [*lines, *_changes_of_mode(self.judgement)]

    def json(self) -> dict[str, Any]:
        """Root mean squares over all runs against what noise alone would leave, and per run, mode and coordinate."""
        runs, judged = self.runs, self.judgement
        return {
            "configuration_unit": common_unit(coordinate.unit for coordinate in self.automaton.coordinates),
            "one_step": _rmse([run.one_step for run in runs]),
            "rollout": _rmse([run.rollout for run in runs]),
            **_estimate(runs),
            "noise_floor": {
                name: None if floor is None else _errors(floor.position, floor.rotation, floor.configuration)
                for name, floor in (("one_step", judged.one_step), ("rollout", judged.rollout))
            },
            "whiteness": {
                "is_noise": judged.is_noise,
                "verdict": judged.sentence,
                "follows": [{"coordinate": c, "what": what, "probability": p} for c, what, p in judged.follows],
                "lag_1_correlation": judged.correlation,
            },
            "mode_changes": [
                {"run": c.run, "mode": c.mode, "measured_s": c.measured, "predicted_s": c.predicted}
                for c in judged.changes
            ],
            "per_run": [_of_run(number, runs) for number in dict.fromkeys(run.run for run in runs)],
            "per_mode": _per_mode(runs),
            "per_coordinate": _per_coordinate(self.automaton, runs, judged),
            "ranges_exceeded": [
                {"coordinate": excess.name, "end": excess.end, "measured": excess.reached, "sentence": str(excess)}
                for excess in self.excesses
            ],
        }

    def plot(self) -> Figure:
        """Measured and predicted configurations over time."""
        from micah_plan.view.figures import chart_figure
        from micah_plan.view.prediction_figure import prediction_charts

        return chart_figure(prediction_charts(self.automaton, self.runs), across=True)

    def page(self, title: str = "") -> str:
        """Measured and predicted objects in 3-D, run by run."""
        from micah_plan.view.prediction_page import prediction_page

        return prediction_page(self.automaton, self.recording, self.runs, self.judgement, title=title or self.title)

    def save(self, path: str | Path) -> None:
        """Write the measured recording."""
        from micah_plan.recording.read import write_recording

        write_recording(self.recording, path)


def predict(
    model: Modelled,
    recording: Measured,
    *,
    actions_as_learned: bool = False,
    commands: CommandKind | None = None,
    progress: Progress | None = None,
) -> PredictionResult:
    """Measured motion against the model's predictions, one step ahead and from the first row on.

    Args:
        model: a path of a model, problem or plan; an automaton; or a result that has one.
        recording: a path, a recording, or executed runs, with actions.
        actions_as_learned: whether actions act as they did in the demonstration that the model was learned from.
        commands: what the actions mean: ``"displacement"``, the way to a commanded ``"position"``, or ``"velocity"``
            [m/s]; None: as the recording says.
        progress: called with a message and the fraction done.

    Raises:
        InputError: if the recording has no actions or other parts than the model.
    """
    from micah_plan.automaton.effects.add import for_demonstrations
    from micah_plan.residual.prediction import predict_recording

    automaton, measured = inputs.automaton_of(model), inputs.recording_of(recording, minimum_rows=2)
    with inputs.located(recording):
        measured = measured if commands is None else with_commands(measured, commands)
        automaton = for_demonstrations(automaton, measured) if actions_as_learned else automaton
        return PredictionResult(automaton, measured, predict_recording(automaton, measured, progress))


def _estimate(runs: Sequence[RunPrediction]) -> dict[str, Any]:
    from micah_plan.residual.prediction import estimate_errors

    errors = estimate_errors(runs)
    return {} if errors is None else {"estimate": {"rmse": errors[0], "final_error": errors[1]}}


def _of_run(number: int, runs: Sequence[RunPrediction]) -> dict[str, Any]:
    """Errors of one run, whose consecutive parts are predicted by themselves."""
    parts = [run for run in runs if run.run == number]
    one_step, rollout = (_rmse([getattr(part, kind) for part in parts]) for kind in ("one_step", "rollout"))
    return {"run": number, "gaps": len(parts) - 1, "one_step": one_step, "rollout": rollout}


def _errors(position: float, rotation: float | None, configuration: float) -> dict[str, float | None]:
    return {"position_rmse_m": position, "rotation_rmse_rad": rotation, "configuration_rmse": configuration}


def _per_coordinate(
    automaton: HybridAutomaton, runs: Sequence[RunPrediction], judged: Judgement
) -> list[dict[str, Any]]:
    """Errors of each coordinate in its own unit, and what noise alone would leave of them."""
    from micah_plan.residual.prediction import rmse_of_coordinates

    sizes = [rmse_of_coordinates([getattr(run, kind) for run in runs]) for kind in ("one_step", "rollout")]
    floors = [None if floor is None else floor.coordinates for floor in (judged.one_step, judged.rollout)]
    return [
        {"name": c.name, "unit": c.unit, "one_step_rmse": sizes[0][i], "rollout_rmse": sizes[1][i]}
        | {"noise_floor": [None if floor is None else floor[i] for floor in floors]}
        for i, c in enumerate(automaton.coordinates)
    ]


def _per_mode(runs: Sequence[RunPrediction]) -> dict[str, dict[str, float]]:
    """One-step errors of the configuration by the mode that a step ended in."""
    steps_of: dict[str, list[float]] = {}
    for run in runs:
        for mode, errors in zip(run.one_step.modes, run.one_step.configuration, strict=True):
            steps_of.setdefault(mode, []).extend(np.square(errors).tolist())
    return {m: {"configuration_rmse": float(np.sqrt(np.mean(v))), "steps": len(v)} for m, v in steps_of.items()}


def _rmse(errors: Sequence[PredictionError]) -> dict[str, float | None]:
    from micah_plan.residual.prediction import rmse

    rotations = [error.rotation for error in errors if error.rotation is not None]
    return _errors(
        rmse([error.position for error in errors]),
        rmse(rotations) if rotations else None,
        rmse([error.configuration for error in errors]),
    )


def _amounts(values: dict[str, float | None], coordinates: list[tuple[float, str]]) -> tuple[str, ...]:
    """Position, rotation, and each coordinate, in their units."""
    errors = [(values["position_rmse_m"], "m"), (values["rotation_rmse_rad"], "rad"), *coordinates]
    return tuple("not measured" if value is None else quantity(value, unit, degrees=False) for value, unit in errors)


def _changes_of_mode(judged: Judgement) -> list[str]:
    """How many changes of mode were predicted, and how late."""
    if not judged.changes:
        return []
    both = [c.predicted - c.measured for c in judged.changes if c.predicted is not None and c.measured is not None]
    late = sum(both) / len(both) if both else 0.0
    when = f"{quantity(abs(late), 's')} {'early' if late < 0 else 'late'}" if abs(late) > 1e-6 else "in time"
    on_average = f", on average {when}" if both else ""
    missed = sum(c.predicted is None for c in judged.changes)
    extra = len(judged.changes) - len(both) - missed
    counts = f"{len(both)} predicted{on_average}, {missed} measured only, {extra} predicted only"
    return [f"mode changes: {counts}"]


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationResult(Result):
    """What `calibrate` returns: the verdict, the effects found, and the model with them."""

    calibration: Calibration
    before: HybridAutomaton
    recording: Recording
    seconds: float = 0.0

    @property
    def success(self) -> bool:
        """Whether what the model lacks has a name, if it lacks anything."""
        return self.outcome != "unexplained"

    @property
    def outcome(self) -> str:
        """``"none"``, ``"explained"``, ``"partly"`` or ``"unexplained"``."""
        return self.calibration.verdict

    @property
    def reason(self) -> str:
        """The outcome as a sentence."""
        from micah_plan.residual.verdict import SENTENCES

        return SENTENCES[self.calibration.verdict]

    @property
    def title(self) -> str:
        """What the page is about."""
        return "measured runs"

    @property
    def automaton(self) -> HybridAutomaton:
        """The model with the effects."""
        return self.calibration.automaton

    @property
    def effects(self) -> tuple[FoundEffect, ...]:
        """What was found, strongest first."""
        return self.calibration.effects

    @cached_property
    def changes(self) -> tuple[Difference, ...]:
        """Where the new model differs."""
        from micah_plan.documents.model_difference import differences

        return tuple(differences(self.before, self.automaton))

    @cached_property
    def experiment(self) -> Experiment | None:
        """The motions that would tell apart what stays open, for `execute`; None if no motion would.

        They are designed when they are first asked for, which takes some seconds.
        """
        from micah_plan.residual.next_experiment import next_experiment

        designed = next_experiment(self.before, self.recording, self.calibration)
        return None if designed is None else designed.experiment

    def report(self) -> list[str | Table]:
        """Verdict, effects with their parameters, errors before and after, what to try next, and what changed."""
        lines: list[str | Table] = [f"{self.outcome}: {self.reason}"]
        if self.effects:
            names = ("effect", "parameters", "evidence [nats]", "or instead")
            lines.append(Table(names, tuple(_effect_row(effect) for effect in self.effects)))
        lines += _error_lines(self.calibration)
        lines.append(f"  left unexplained: {percent(self.calibration.unexplained_fraction, 0)}")
        lines += [f"  note: {note}" for note in self.calibration.notes]
        lines.append(f"  next: {self.calibration.experiment}")
        lines.append("changes of the model:" if self.changes else "the model stays as it is")
        return [*lines, *(f"  {change}" for change in self.changes)]

    def json(self) -> dict[str, Any]:
        """Verdict, effects, errors before and after, what stays unexplained, and what changed."""
        calibration = self.calibration
        written = zip(self.automaton.coordinates, calibration.written, strict=bool(calibration.written))
        return {
            "verdict": calibration.verdict,
            "effects": [_effect(effect) for effect in calibration.effects],
            "residual": {
                "before": {"one_step_rmse": calibration.before.one_step, "rollout_rmse": calibration.before.rollout},
                "after": {"one_step_rmse": calibration.after.one_step, "rollout_rmse": calibration.after.rollout},
                "new_model": {
                    coordinate.name: {"one_step_rmse": size.one_step, "rollout_rmse": size.rollout}
                    for coordinate, size in written
                },
                "noise_floor": calibration.noise_floor,
                "rollout_noise_floor": calibration.rollout_floor,
            },
            "unexplained_fraction": calibration.unexplained_fraction,
            "missing_modes": [_missing_mode(mode) for trace in calibration.traces for mode in trace.missing_modes],
            "coordinates": [_coordinate(trace) for trace in calibration.traces],
            "notes": list(calibration.notes),
            "next_experiment": calibration.experiment,
            "seconds": self.seconds,
            "changes": [asdict(change) for change in self.changes],
        }

    def plot(self) -> Figure:
        """Measured configurations, and those that the model predicts before and after."""
        from micah_plan.view.calibration_page import motion_charts
        from micah_plan.view.figures import chart_figure

        return chart_figure(motion_charts(self.calibration), across=True)

    def page(self, title: str = "") -> str:
        """What was compared, what the model lacks, and how sure that is."""
        from micah_plan.view.calibration_page import calibration_page

        return calibration_page(self.calibration, title=title or self.title)

    def save(self, path: str | Path) -> None:
        """Write the calibrated model (YAML)."""
        save_model(self.automaton, "", path)


def calibrate(
    model: Modelled,
    recording: Measured,
    *,
    commands: CommandKind | None = None,
    progress: Progress | None = None,
) -> CalibrationResult:
    """What a model lacks in measured motion, and the model with it.

    Args:
        model, recording, commands: as of `predict`.
        progress: called with a message and the fraction done.

    Raises:
        InputError: if the recording has no actions, too few rows or other parts than the model.
    """
    from micah_plan.residual.calibrate import calibrate as calibrated

    automaton, measured = inputs.automaton_of(model), inputs.recording_of(recording, minimum_rows=2)
    begin = time.perf_counter()
    with inputs.located(recording):
        measured = measured if commands is None else with_commands(measured, commands)
        calibration = calibrated(automaton, measured, progress)
    return CalibrationResult(calibration, automaton, measured, time.perf_counter() - begin)


def _effect_row(row: FoundEffect) -> tuple[str, ...]:
    """Name, parameters, evidence, and what would do as well."""
    from micah_plan.residual.calibrate import began

    effect = row.effect
    units = dict(zip([name for name, _ in effect.parameters], row.units, strict=True))
    values = [(name, value, units[name]) for name, value in effect.parameters]
    values += [(name, value, "s") for name, value in row.derived]
    name = f"{effect.name} ({effect.coordinate})" + ("" if row.is_added else ", not added")
    name += f", began {began(effect.since)}" if effect.since else ""
    texts = ", ".join(f"{parameter} {quantity(value, unit)}" for parameter, value, unit in values)
    return name, texts, plain(row.evidence), ", ".join(row.tied)


def _error_lines(calibration: Calibration) -> list[str]:
    """Errors before and after, and those of noise alone, in one unit each."""
    lines = []
    for error in calibration.errors:
        lines += [f"  {error.of}"] if error.of else []
        for name, text in _SHOWN.items():
            sizes = (getattr(size, name) for size in (error.before, error.after))
            before, after = (quantity(size, error.unit) for size in sizes)
            lines.append(f"  {text:9} {before} before, {after} after")
        floors = (quantity(floor, error.unit) for floor in (error.noise_floor, error.rollout_floor))
        lines.append(f"  noise     {' (one step), '.join(floors)} (roll-out)")
    if calibration.automaton is calibration.nominal or not calibration.written:
        return lines
    for coordinate, size in zip(calibration.automaton.coordinates, calibration.written, strict=True):
        sizes = (quantity(amount, coordinate.unit) for amount in (size.one_step, size.rollout))
        whose = f", {coordinate.name}" if calibration.automaton.n > 1 else ""
        lines.append(f"  new model on these runs{whose}: {' (one step), '.join(sizes)} (roll-out)")
    return lines


def _effect(entry: FoundEffect) -> dict[str, Any]:
    effect, since = entry.effect, entry.effect.since
    names = [name for name, _ in effect.parameters]
    return {
        "name": effect.name,
        "parameters": dict(effect.parameters) | dict(entry.derived),
        "units": dict(zip(names, entry.units, strict=True)) | {name: "s" for name, _ in entry.derived},
        "evidence": entry.evidence,
        "is_added": entry.is_added,
        "interval_95": {name: list(pair) for name, pair in zip(names, entry.interval, strict=True)},
        "coordinate": effect.coordinate,
        "modes": list(effect.modes),
        "since": None if since is None else {"run": since.run, "time_s": since.time},
        "tied_with": list(entry.tied),
        "separating_experiment": entry.experiment or None,
        "sentence": entry.sentence,
        "source": entry.source,
    }


def _missing_mode(mode: MissingMode) -> dict[str, Any]:
    ends = {
        "from": mode.low if math.isfinite(mode.low) else None,
        "to": mode.high if math.isfinite(mode.high) else None,
    }
    return {"coordinate": mode.coordinate, "unit": mode.unit, **ends, "gain": mode.gain, "bias": mode.bias} | {
        "evidence": mode.evidence,
        "modes": list(mode.modes),
        "sentence": str(mode),
    }


def _correlation(trace: CoordinateTrace) -> dict[str, Any] | None:
    names, matrix = trace.held_out.correlations_of(trace.chosen)
    return {"parameters": list(names), "matrix": matrix.tolist()} if len(names) > 1 else None


def _coordinate(trace: CoordinateTrace) -> dict[str, Any]:
    return {
        "name": trace.data.coordinate,
        "unit": trace.data.unit,
        "verdict": trace.outcome.verdict,
        "outcome": trace.outcome.name,
        "sentence": trace.outcome.sentence,
        "unexplained_fraction": trace.unexplained_fraction,
        "ranking": [
            {"name": name, "evidence": evidence, "standard_error": error} for name, evidence, error in trace.ranking
        ],
        "autocorrelation": trace.whiteness[0],
        "whiteness_p": trace.whiteness[1],
        "parameter_correlation": _correlation(trace),
    }
