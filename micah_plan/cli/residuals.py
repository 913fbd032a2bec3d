"""`micah-plan predict` and `calibrate`: a model against measured motion."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from micah_plan.cli.console import (
    NO_RESULT,
    JsonFlag,
    OutputPath,
    out,
    print_files,
    print_lines,
    print_summary,
    progress_bar,
    table,
)
from micah_plan.errors import located_in
from micah_plan.files import MODEL, PAGE, Output, check_outputs
from micah_plan.quantities import common_unit, count, percent, plain, quantity

if TYPE_CHECKING:
    from micah_plan.automaton.hybrid import HybridAutomaton
    from micah_plan.documents.model_difference import Difference
    from micah_plan.residual.calibrate import Calibration, FoundEffect
    from micah_plan.residual.judgement import Judgement
    from micah_plan.residual.missing_mode import MissingMode
    from micah_plan.residual.next_experiment import Designed
    from micah_plan.residual.prediction import PredictionError, RunPrediction
    from micah_plan.residual.trace import CoordinateTrace


def predict(
    model: Annotated[Path, typer.Argument(help="Model, or the problem or plan that was executed (YAML, JSON).")],
    recording: Annotated[Path, typer.Argument(help="Recording with actions.")],
    as_learned: Annotated[
        bool, typer.Option("--actions-as-learned", help="Apply the action channel that the model was learned with.")
    ] = False,
    html: Annotated[Path | None, typer.Option(help="Write measured against predicted motion as a page.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Compare measured motion with one-step and roll-out predictions, and their errors with the noise in the data.

    A held object has no model file of its own: give the problem or a plan instead.
    """
    from micah_plan.api import stages
    from micah_plan.api.inputs import automaton_of
    from micah_plan.files import replace_file
    from micah_plan.residual.judgement import judge
    from micah_plan.residual.prediction import predict_recording

    check_outputs((model, recording), (Output("--html", html, PAGE),))
    automaton = automaton_of(model)
    measured = stages.read(recording, minimum_rows=2)
    with located_in(recording):
        automaton = stages.for_demonstrations(automaton, measured) if as_learned else automaton
        with progress_bar(as_json) as progress:
            runs = predict_recording(automaton, measured, progress)
            progress("compare with the noise", 1.0)
            judged = judge(automaton, measured, runs)
    if html is not None:
        from micah_plan.view.prediction_page import prediction_page

        replace_file(html, prediction_page(automaton, measured, runs, judged, title=recording.stem).encode())
    summary = _predicted(automaton, runs, judged)
    print_summary(as_json, summary, lambda: _print_predicted(summary, html))


def _predicted(automaton: HybridAutomaton, runs: Sequence[RunPrediction], judged: Judgement) -> dict[str, Any]:
    """Keys of `predict`: root mean squares over all runs against what noise alone would leave, and per run."""
    from micah_plan.residual.prediction import estimate_errors
    from micah_plan.residual.range_exceeded import ranges_exceeded

    return {
        "configuration_unit": common_unit(coordinate.unit for coordinate in automaton.coordinates),
        "one_step": _rmse([run.one_step for run in runs]),
        "rollout": _rmse([run.rollout for run in runs]),
        **_estimate(estimate_errors(runs)),
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
            {"run": c.run, "mode": c.mode, "measured_s": c.measured, "predicted_s": c.predicted} for c in judged.changes
        ],
        "per_run": [_of_run(number, runs) for number in dict.fromkeys(run.run for run in runs)],
        "per_mode": _per_mode(runs),
        "per_coordinate": _per_coordinate(automaton, runs, judged),
        "ranges_exceeded": [
            {"coordinate": excess.name, "end": excess.end, "measured": excess.reached, "sentence": str(excess)}
            for excess in ranges_exceeded(automaton, [run.x for run in runs])
        ],
    }


def _of_run(number: int, runs: Sequence[RunPrediction]) -> dict[str, Any]:
    """Errors of one run, whose consecutive parts are predicted by themselves."""
    parts = [run for run in runs if run.run == number]
    one_step, rollout = (_rmse([getattr(part, kind) for part in parts]) for kind in ("one_step", "rollout"))
    return {"run": number, "gaps": len(parts) - 1, "one_step": one_step, "rollout": rollout}


def _estimate(errors: tuple[float, float] | None) -> dict[str, Any]:
    return {} if errors is None else {"estimate": {"rmse": errors[0], "final_error": errors[1]}}


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
    import numpy as np

    found: dict[str, list[float]] = {}
    for run in runs:
        for mode, errors in zip(run.one_step.modes, run.one_step.configuration, strict=True):
            found.setdefault(mode, []).extend(np.square(errors).tolist())
    return {m: {"configuration_rmse": float(np.sqrt(np.mean(v))), "steps": len(v)} for m, v in found.items()}


def _rmse(errors: Sequence[PredictionError]) -> dict[str, float | None]:
    from micah_plan.residual.prediction import rmse

    rotations = [error.rotation for error in errors if error.rotation is not None]
    return _errors(
        rmse([error.position for error in errors]),
        rmse(rotations) if rotations else None,
        rmse([error.configuration for error in errors]),
    )


def _print_predicted(summary: dict[str, Any], html: Path | None) -> None:
    """Errors of both predictions beside what noise alone would leave, what they follow, and when modes changed."""
    coordinates = summary["per_coordinate"]
    shown = table("root mean square error", "position", "rotation", *(c["name"] for c in coordinates))
    for k, (name, text) in enumerate((("one_step", "one step"), ("rollout", "roll-out"))):
        floor, sizes = summary["noise_floor"][name], [(c[f"{name}_rmse"], c["unit"]) for c in coordinates]
        shown.add_row(text, *_amounts(summary[name], sizes))
        if floor:
            shown.add_row("  noise alone", *_amounts(floor, [(c["noise_floor"][k], c["unit"]) for c in coordinates]))
    out.print(shown)
    out.print(summary["whiteness"]["verdict"])
    if "estimate" in summary:
        size, last = (
            quantity(summary["estimate"][key], summary["configuration_unit"]) for key in ("rmse", "final_error")
        )
        out.print(f"what the controller believed was {size} beside what was measured, at the end {last}")
    print_lines(tuple(excess["sentence"] for excess in summary["ranges_exceeded"]))
    gaps = sum(run["gaps"] for run in summary["per_run"])
    if gaps:
        out.print(f"{count(gaps, 'gap')} in t: rows are missing, so roll-outs begin anew after each")
    changes = summary["mode_changes"]
    both = [c["predicted_s"] - c["measured_s"] for c in changes if None not in (c["predicted_s"], c["measured_s"])]
    if changes:
        late = sum(both) / len(both) if both else 0.0
        when = f"{quantity(abs(late), 's')} {'early' if late < 0 else 'late'}" if abs(late) > 1e-6 else "in time"
        on_average = f", on average {when}" if both else ""
        missed = sum(c["predicted_s"] is None for c in changes)
        extra = len(changes) - len(both) - missed
        out.print(f"mode changes: {len(both)} predicted{on_average}, {missed} measured only, {extra} predicted only")
    print_files((html,))


def _amounts(values: dict[str, float | None], coordinates: list[tuple[float, str]]) -> tuple[str, ...]:
    """Position, rotation, and each coordinate, in their units."""
    errors = [(values["position_rmse_m"], "m"), (values["rotation_rmse_rad"], "rad"), *coordinates]
    return tuple("not measured" if value is None else quantity(value, unit, degrees=False) for value, unit in errors)


def calibrate(
    model: Annotated[Path, typer.Argument(help="Model (YAML).")],
    recordings: Annotated[
        list[Path], typer.Argument(help="Recordings with actions: executed runs, experiments or a demonstration.")
    ],
    output: OutputPath,
    html: Annotated[
        Path | None, typer.Option("--html", "--report", help="Write the comparison and the effects as a page.")
    ] = None,
    experiment: Annotated[
        Path | None, typer.Option(help="Write the experiment that tells apart what stays open, if motion can.")
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Find what a model lacks and write the improved model; exit code 1 if a deviation has no name."""
    from micah_plan.api import stages
    from micah_plan.api.formatting import error_lines
    from micah_plan.api.inputs import joined
    from micah_plan.documents.experiment import experiment_text
    from micah_plan.documents.kind import files_named_by
    from micah_plan.documents.model import load_model, model_text
    from micah_plan.documents.model_difference import differences
    from micah_plan.files import replace_files
    from micah_plan.residual.calibrate import calibrate as find_effects
    from micah_plan.residual.next_experiment import next_experiment

    outputs = Output("-o", output, MODEL), Output("--html", html, PAGE), Output("--experiment", experiment, MODEL)
    check_outputs((*files_named_by(model), *recordings), outputs)
    automaton = load_model(model)
    read = [stages.read(recording, minimum_rows=2) for recording in recordings]
    measured = read[0] if len(read) == 1 else joined(read)
    begin = time.perf_counter()
    with progress_bar(as_json) as progress, located_in(recordings[0]):
        calibration = find_effects(automaton, measured, progress)
    contents = {output: model_text(calibration.automaton).encode()}
    designed = None if experiment is None else next_experiment(automaton, measured, calibration)
    if experiment is not None and designed is not None:
        contents[experiment] = experiment_text(designed.experiment, model, experiment, str(designed)).encode()
    if html is not None:
        from micah_plan.view.calibration_page import calibration_page

        contents[html] = calibration_page(calibration, title=recordings[0].stem).encode()
    replace_files(contents)
    changes = differences(automaton, calibration.automaton)
    summary = calibrated(calibration, time.perf_counter() - begin) | {"changes": [asdict(change) for change in changes]}
    if experiment is not None:
        summary |= {"experiment": None if designed is None else _designed(designed)}
    lines = error_lines(calibration)
    print_summary(as_json, summary, lambda: _print_calibrated(summary, lines, changes, tuple(contents)))
    if calibration.verdict == "unexplained":
        raise typer.Exit(NO_RESULT)


def _designed(designed: Designed) -> dict[str, Any]:
    """Which pairs an experiment tells apart, and the evidence to expect of it [nats]."""
    pairs = [{"between": [first, second], "expected_nats": nats} for first, second, nats in designed.expected]
    return {"coordinate": designed.coordinate, "pairs": pairs, "sentence": str(designed)}


def calibrated(calibration: Calibration, seconds: float) -> dict[str, Any]:
    """Keys of `calibrate`."""
    return {
        "verdict": calibration.verdict,
        "effects": [_effect(effect) for effect in calibration.effects],
        "residual": {
            "before": {"one_step_rmse": calibration.before.one_step, "rollout_rmse": calibration.before.rollout},
            "after": {"one_step_rmse": calibration.after.one_step, "rollout_rmse": calibration.after.rollout},
            "new_model": {
                coordinate.name: {"one_step_rmse": written.one_step, "rollout_rmse": written.rollout}
                for coordinate, written in zip(
                    calibration.automaton.coordinates, calibration.written, strict=bool(calibration.written)
                )
            },
            "noise_floor": calibration.noise_floor,
            "rollout_noise_floor": calibration.rollout_floor,
        },
        "unexplained_fraction": calibration.unexplained_fraction,
        "missing_modes": [_missing_mode(mode) for trace in calibration.traces for mode in trace.missing_modes],
        "coordinates": [_coordinate(trace) for trace in calibration.traces],
        "notes": list(calibration.notes),
        "next_experiment": calibration.experiment,
        "seconds": seconds,
    }


def _effect(found: FoundEffect) -> dict[str, Any]:
    effect, since = found.effect, found.effect.since
    names = [name for name, _ in effect.parameters]
    return {
        "name": effect.name,
        "parameters": dict(effect.parameters) | dict(found.derived),
        "units": dict(zip(names, found.units, strict=True)) | {name: "s" for name, _ in found.derived},
        "evidence": found.evidence,
        "is_added": found.is_added,
        "interval_95": {name: list(pair) for name, pair in zip(names, found.interval, strict=True)},
        "coordinate": effect.coordinate,
        "modes": list(effect.modes),
        "since": None if since is None else {"run": since.run, "time_s": since.time},
        "tied_with": list(found.tied),
        "separating_experiment": found.experiment or None,
        "sentence": found.sentence,
        "source": found.source,
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
    names, matrix = trace.search.correlations_of(trace.chosen)
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


def _print_calibrated(
    summary: dict[str, Any], errors: Sequence[str], changes: Sequence[Difference], files: tuple[Path, ...]
) -> None:
    """Verdict, effects and errors of a calibration."""
    from micah_plan.automaton.effects.value import Since
    from micah_plan.residual.calibrate import began
    from micah_plan.residual.verdict import SENTENCES

    out.print(f"{summary['verdict']}: {SENTENCES[summary['verdict']]}")
    if summary["effects"]:
        shown = table("effect", "parameters", "evidence [nats]", "or instead")
        for effect in summary["effects"]:
            units = effect["units"]
            values = [f"{name} {quantity(value, units[name])}" for name, value in effect["parameters"].items()]
            since = effect["since"]
            name = f"{effect['name']} ({effect['coordinate']})" + ("" if effect["is_added"] else ", not added")
            name += f", began {began(Since(since['time_s'], since['run']))}" if since else ""
            shown.add_row(name, ", ".join(values), plain(effect["evidence"]), ", ".join(effect["tied_with"]))
        out.print(shown)
    print_lines(errors)
    out.print(f"  left unexplained: {percent(summary['unexplained_fraction'], 0)}")
    for note in summary["notes"]:
        out.print(f"  note: {note}")
    out.print(f"  next: {summary['next_experiment']}")
    if "experiment" in summary:
        none = "not written: no commands along a joint would tell more"
        out.print(f"  experiment {summary['experiment']['sentence'] if summary['experiment'] else none}")
    out.print("changes of the model:" if changes else "the model stays as it is")
    print_lines(tuple(f"  {change}" for change in changes))
    print_files(files)
