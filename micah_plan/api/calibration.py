"""`calibrate`: identify the effects that a model lacks from measured motion."""

from __future__ import annotations

import math
import time
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from micah_plan.api import inputs
from micah_plan.api.inputs import Measured, Modelled
from micah_plan.api.result import Result, save_model
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.message import codes_of
from micah_plan.quantities import percent, plain, quantity
from micah_plan.recording.commands import CommandKind, with_commands
from micah_plan.recording.value import Recording
from micah_plan.summaries import Progress, Table
from micah_plan.task.experiment import Experiment

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from micah_plan.documents.model_difference import Difference
    from micah_plan.residual.calibration import Calibration, FoundEffect
    from micah_plan.residual.missing_mode import MissingMode
    from micah_plan.residual.trace import CoordinateTrace
from micah_plan.api.prediction import SHOWN


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationResult(Result):
    """Result of `calibrate`: the verdict, the effects found, and the model with them."""

    calibration: Calibration
    before: HybridAutomaton
    recording: Recording
    seconds: float = 0.0

    @property
    def success(self) -> bool:
        """Whether the model is complete, or some effect explains what it lacks."""
        return self.outcome != "unexplained"

    @property
    def outcome(self) -> str:
        """``"none"``, ``"explained"``, ``"partly"`` or ``"unexplained"``."""
        return self.calibration.verdict

    @property
    def reason(self) -> str:
        """The outcome as a sentence."""
        from micah_plan.residual.messages import VERDICTS

        return VERDICTS[self.calibration.verdict]

    @property
    def title(self) -> str:
        """Title of the page."""
        return "measured runs"

    @property
    def automaton(self) -> HybridAutomaton:
        """The model with the effects."""
        return self.calibration.automaton

    @property
    def effects(self) -> tuple[FoundEffect, ...]:
        """The effects found, strongest first."""
        return self.calibration.effects

    @cached_property
    def changes(self) -> tuple[Difference, ...]:
        """Differences of the new model."""
        from micah_plan.documents.model_difference import differences

        return tuple(differences(self.before, self.automaton))

    @cached_property
    def experiment(self) -> Experiment | None:
        """The motions that would separate the open alternatives, for `execute`; None if motion cannot.

        They are designed on first use, which takes some seconds.
        """
        from micah_plan.residual.next_experiment import next_experiment

        designed = next_experiment(self.before, self.recording, self.calibration)
        return None if designed is None else designed.experiment

    def report(self) -> list[str | Table]:
        """Verdict, effects with their parameters, errors before and after, the next experiment, and changes of the
        model.
        """
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
        """Verdict, effects, errors before and after, the unexplained fraction, and changes of the model."""
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
            "note_codes": codes_of(calibration.notes),
            "next_experiment": calibration.experiment,
            "seconds": self.seconds,
            "changes": [asdict(change) for change in self.changes],
        }

    def plot(self) -> Figure:
        """Measured configurations, with the predictions before and after."""
        from micah_plan.view.calibration_page import motion_charts
        from micah_plan.view.figures import chart_figure

        return chart_figure(motion_charts(self.calibration), across=True)

    def page(self, title: str = "") -> str:
        """The data, the missing effects, and their evidence."""
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
    """Identify the effects that a model lacks from measured motion.

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
    """Name, parameters, evidence and alternatives."""
    from micah_plan.residual.calibrate import began

    effect = row.effect
    values = [(name, value, unit) for name, value, unit, *_ in row.rows]
    values += [(name, value, "s") for name, value in row.derived]
    name = f"{effect.name} ({effect.coordinate})" + ("" if row.is_added else ", not added")
    name += f", began {began(effect.since)}" if effect.since else ""
    texts = ", ".join(f"{parameter} {quantity(value, unit)}" for parameter, value, unit in values)
    return name, texts, plain(row.evidence), ", ".join(row.tied)


def _error_lines(calibration: Calibration) -> list[str]:
    """Errors before and after with their noise floors, in one unit each."""
    lines = []
    for error in calibration.errors:
        lines += [f"  {error.of}"] if error.of else []
        for name, text in SHOWN.items():
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
    return {
        "name": effect.name,
        "parameters": {name: value for name, value, *_ in entry.rows} | dict(entry.derived),
        "units": {name: unit for name, _, unit, *_ in entry.rows} | {name: "s" for name, _ in entry.derived},
        "evidence": entry.evidence,
        "is_added": entry.is_added,
        "interval_95": {name: [low, high] for name, _, _, low, high in entry.rows},
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
