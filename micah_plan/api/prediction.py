"""`predict`: a model against measured motion, with the significance of its errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from micah_plan.api import inputs
from micah_plan.api.inputs import Measured, Modelled
from micah_plan.api.result import Result
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.quantities import common_unit, count, quantity
from micah_plan.recording.commands import CommandKind, with_commands
from micah_plan.recording.value import Recording
from micah_plan.summaries import Progress, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from micah_plan.residual.judgement import Judgement
    from micah_plan.residual.prediction import PredictionError, RunPrediction
    from micah_plan.residual.range_exceeded import RangeExceeded

SHOWN = {"one_step": "one step", "rollout": "roll-out"}


@dataclass(frozen=True, eq=False, repr=False)
class PredictionResult(Result):
    """Result of `predict`: the predictions of every run, with their assessment."""

    automaton: HybridAutomaton
    recording: Recording
    runs: tuple[RunPrediction, ...]

    @cached_property
    def judgement(self) -> Judgement:
        """Noise floors, regressors that errors depend on, and mode changes."""
        from micah_plan.residual.judgement import judge

        return judge(self.automaton, self.recording, self.runs)

    @property
    def success(self) -> bool:
        """Whether the errors are consistent with noise."""
        return self.judgement.is_noise is True

    @property
    def outcome(self) -> str:
        """``"noise"``, ``"lacking"`` (the model lacks something) or ``"unknown"``."""
        return {True: "noise", False: "lacking", None: "unknown"}[self.judgement.is_noise]

    @property
    def reason(self) -> str:
        """The dependence of the errors, in words."""
        return self.judgement.sentence

    @cached_property
    def excesses(self) -> tuple[RangeExceeded, ...]:
        """Where the motion went beyond the model's range."""
        from micah_plan.residual.range_exceeded import ranges_exceeded

        return tuple(ranges_exceeded(self.automaton, [run.x for run in self.runs]))

    def report(self) -> list[str | Table]:
        """Errors of both predictions with their noise floors, their dependence, and mode changes."""
        summary = self.json()
        coordinates = summary["per_coordinate"]
        rows = list[tuple[str, ...]]()
        for k, (name, text) in enumerate(SHOWN.items()):
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
            lines.append(f"the controller's belief was off by {size}, at the end by {last}")
        lines += [str(excess) for excess in self.excesses]
        gaps = sum(run["gaps"] for run in summary["per_run"])
        if gaps:
            lines.append(f"{count(gaps, 'gap')} in t: rows are missing, so roll-outs restart after each")
        return [*lines, *_changes_of_mode(self.judgement)]

    def json(self) -> dict[str, Any]:
        """Root mean squares over all runs with noise floors, and per run, mode and coordinate."""
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
        commands: meaning of the actions: ``"displacement"``, the displacement to a commanded ``"position"``, or
            ``"velocity"`` [m/s]; None: as in the recording.
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
    """Errors of one run, whose contiguous parts are predicted separately."""
    parts = [run for run in runs if run.run == number]
    one_step, rollout = (_rmse([getattr(part, kind) for part in parts]) for kind in ("one_step", "rollout"))
    return {"run": number, "gaps": len(parts) - 1, "one_step": one_step, "rollout": rollout}


def _errors(position: float, rotation: float | None, configuration: float) -> dict[str, float | None]:
    return {"position_rmse_m": position, "rotation_rmse_rad": rotation, "configuration_rmse": configuration}


def _per_coordinate(
    automaton: HybridAutomaton, runs: Sequence[RunPrediction], judged: Judgement
) -> list[dict[str, Any]]:
    """Errors of each coordinate in its own unit, with noise floors."""
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
    """Number of predicted mode changes, and their delays."""
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
