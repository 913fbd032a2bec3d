"""The page of a prediction: the object as it was measured beside where the model has it, run by run.

The figure of measured and predicted motion: one axes per coordinate and run, over the time of the run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.quantities import count, quantity
from micah_plan.recording.value import Recording
from micah_plan.residual.judgement import Floor, Judgement
from micah_plan.residual.prediction import PredictionError, RunPrediction, rmse, rmse_of_coordinates
from micah_plan.view.camera import camera
from micah_plan.view.chart import Chart, Curve, Level, Panel, evenly, widened
from micah_plan.view.drawing import draw_shapes, fixed_shapes, link_shapes, object_size, shape_corners, shown_links
from micah_plan.view.executed import poses_of_run
from micah_plan.view.learned import capital
from micah_plan.view.model_page import draw_ground_and_frame, ground_legend
from micah_plan.view.motion import Keyframes, poses_over_time
from micah_plan.view.page import Block, LegendEntry, RunEntry, ScenePage, Status, Timeline, render_scene
from micah_plan.view.palette import BLUE, INK, ORANGE
from micah_plan.view.placement import handle_in_part
from micah_plan.view.scene import Scene, slug

_MOST_RUNS, _MOST_DRAWN, _MOST_KEYFRAMES, _MOST_COORDINATES = 20, 6, 200, 12
_SHORTEST_S, _LONGEST_S, _REST_S = 4.0, 15.0, 0.8
_HEIGHT = 110.0
_BADGES: dict[bool | None, tuple[str, Status]] = {
    True: ("errors look like noise", "good"),
    False: ("the model lacks something", "fair"),
    None: ("whether it is noise is not certain", "fair"),
}


def prediction_page(
    automaton: HybridAutomaton,
    recording: Recording,
    runs: Sequence[RunPrediction],
    judged: Judgement,
    *,
    title: str = "Prediction",
) -> str:
    """The page as HTML text.

    Args:
        automaton: that predicts.
        recording: what was measured.
        runs: its predictions, of the same recording.
        judged: what their errors are worth.
    """
    worst = sorted(runs, key=lambda run: -rmse([run.rollout.position]))[:_MOST_RUNS]
    scene, size = Scene(), object_size(automaton)
    longest = max(float(run.time[-1]) for run in worst)
    scale = min(max(longest, _SHORTEST_S), _LONGEST_S) / max(longest, 1e-9)
    fixed = fixed_shapes(automaton)
    draw_shapes(scene, "object/fixed", fixed, opacity=0.5)
    scene.reserve(shape_corners(fixed, RigidTransform.identity()))
    entries, handles = [], []
    for order, run in enumerate(worst):
        entry, points = _draw_run(scene, automaton, recording, run, order, scale)
        entries.append(entry)
        handles += points
    spacing = draw_ground_and_frame(scene, size)
    page = ScenePage(
        title=title,
        kind="measured against predicted",
        camera=camera(scene, np.concatenate(handles)),
        badge=_BADGES[judged.is_noise],
        message=f"{capital(judged.sentence)}.",
        facts=_facts(automaton, runs, judged),
        details=[("Mode changes", _changes(judged))] if judged.changes else [],
        legend=[
            LegendEntry(INK, "the object as it was measured, in its own colours"),
            LegendEntry(ORANGE, "where the model has it without looking again (roll-out)"),
            *ground_legend(spacing),
        ],
        timeline=Timeline(longest * scale + _REST_S),
        charts=_blocks(automaton, worst, longest, scale),
        runs=entries,
    )
    return render_scene(page, scene)


def _draw_run(
    scene: Scene, automaton: HybridAutomaton, recording: Recording, run: RunPrediction, order: int, scale: float
) -> tuple[RunEntry, list[Floats]]:
    """The measured object and the ghost of its roll-out; the entry of the run, and where its handles were."""
    rows = evenly(len(run.time), _MOST_KEYFRAMES)
    clock = run.time[rows] * scale
    measured = poses_of_run(automaton, recording.select(run=run.run), run.x, ())
    modes = (run.rollout.modes[0], *run.rollout.modes)
    rolled = np.vstack([run.x[:1], run.x[1:] + run.rollout.configuration])
    predicted = poses_over_time(automaton, Keyframes(clock, tuple(modes[i] for i in rows), rolled[rows]))
    layer, points = f"runs/{order}_run", list[Floats]()
    for number, link in shown_links(automaton):
        shapes, name = link_shapes(automaton, number), slug(link.child, number)
        for path, poses, color, opacity in (
            (f"{layer}/measured/{name}", measured[link.child][rows], None, 1.0),
            (f"{layer}/predicted/{name}", predicted[link.child], ORANGE, 0.45),
        ):
            draw_shapes(scene, path, shapes, color=color, opacity=opacity)
            scene.animate(path, clock, poses)
            for i in range(0, len(poses), max(1, len(poses) // 6)):
                scene.reserve(shape_corners(shapes, poses[i]))
        points.append(np.asarray(measured[link.child].apply(handle_in_part(automaton, link.child))))
    steps, rolled_on = (
        _sizes(automaton, rmse_of_coordinates([prediction])) for prediction in (run.one_step, run.rollout)
    )
    words = (f"One step ahead {steps} off, from the first row on {rolled_on} (root mean square).",)
    readouts = _readouts(automaton, run, rolled, modes, scale)
    return RunEntry(f"run {run.run}", words, layer, run.run, readouts), points


def _readouts(
    automaton: HybridAutomaton, run: RunPrediction, rolled: Floats, modes: Sequence[str], scale: float
) -> tuple[tuple[float, tuple[str, ...]], ...]:
    found = []
    for row in evenly(len(run.time), _MOST_KEYFRAMES).tolist():
        lines = [f"run {run.run} after {quantity(float(run.time[row]), 's')}, predicted {modes[row]}"]
        for c, measured, predicted in zip(automaton.coordinates, run.x[row], rolled[row], strict=True):
            both = (quantity(float(value), c.unit, degrees=False) for value in (measured, predicted))
            lines.append(f"{c.name} = {' measured, '.join(both)} predicted")
        found.append((float(run.time[row] * scale), tuple(lines)))
    return tuple(found)


def _sizes(automaton: HybridAutomaton, sizes: Sequence[float]) -> str:
    """Root mean squares (n,) of coordinates: together where they have one unit, else each with its name."""
    coordinates = automaton.coordinates
    if len({coordinate.unit for coordinate in coordinates}) == 1:
        return quantity(float(np.sqrt(np.mean(np.square(sizes)))), coordinates[0].unit)
    return ", ".join(f"{c.name} {quantity(size, c.unit)}" for c, size in zip(coordinates, sizes, strict=True))


def _facts(automaton: HybridAutomaton, runs: Sequence[RunPrediction], judged: Judgement) -> list[tuple[str, str]]:
    facts = [("Runs", str(len(runs)))]
    rows: tuple[tuple[str, list[PredictionError], Floor | None], ...] = (
        ("One step ahead", [run.one_step for run in runs], judged.one_step),
        ("Roll-out from the first row", [run.rollout for run in runs], judged.rollout),
    )
    for name, errors, floor in rows:
        facts.append((name, _sizes(automaton, rmse_of_coordinates(errors))))
        noise = "unknown" if floor is None else _sizes(automaton, floor.coordinates)
        facts.append(("… noise alone would leave", noise))
    return facts


def _changes(judged: Judgement) -> list[str]:
    lines = []
    for change in judged.changes:
        times = [
            f"{name} after {quantity(when, 's')}" if when is not None else f"not {name}"
            for name, when in (("measured", change.measured), ("predicted", change.predicted))
        ]
        lines.append(f"Run {change.run}, into {change.mode}: {', '.join(times)}.")
    return lines


def _blocks(automaton: HybridAutomaton, runs: Sequence[RunPrediction], longest: float, scale: float) -> list[Block]:
    """The chart of all runs, whose line follows the player."""
    ends = ((0.0, 0.0), (longest * scale, longest), (longest * scale + _REST_S, longest))
    words = ["Dots: measured. Blue: predicted one step ahead of each measured row. Orange: from the first row alone."]
    left_out = automaton.n - _MOST_COORDINATES
    words += [f"{count(left_out, 'more coordinate')} not shown."] if left_out > 0 else []
    return [Block("Measured and predicted", tuple(words), prediction_chart(automaton, runs), keyframes=ends)]


def prediction_charts(automaton: HybridAutomaton, runs: Sequence[RunPrediction]) -> list[Chart]:
    """One chart for each of the first runs."""
    return [
        replace(prediction_chart(automaton, [run]), x_label=f"time in run {run.run} [s]") for run in runs[:_MOST_DRAWN]
    ]


def prediction_chart(automaton: HybridAutomaton, runs: Sequence[RunPrediction]) -> Chart:
    """Measured, one step ahead and rolled out, per coordinate; below it the errors of both."""
    panels: list[Panel] = []
    shown = automaton.coordinates[:_MOST_COORDINATES]
    for i, coordinate in enumerate(shown):
        dots = [Curve(run.time, run.x[:, i], "small", INK, "measured", run.run) for run in runs]
        errors = [line for run in runs for line in _lines(run, i, 0.0)]
        predicted = [line for run in runs for line in _lines(run, i, run.x[1:, i])]
        ends = widened([line.y for line in (*dots, *predicted)])
        panels.append(Panel(f"{coordinate.name}\n[{coordinate.unit}]", *ends, _HEIGHT, (*dots, *predicted)))
        ends = widened([line.y for line in errors])
        panels.append(Panel(f"error\n[{coordinate.unit}]", *ends, _HEIGHT, (Level(0.0, "zero"), *errors)))
    longest = max(float(run.time[-1]) for run in runs)
    described = "measured and predicted over time"
    return Chart(described, "time in the run [s]", 0.0, max(longest, 1e-9), tuple(panels), fills=True)


def _lines(run: RunPrediction, i: int, measured: Floats | float) -> list[Curve]:
    """One step ahead and rolled out over the rows after the first: errors, added to what was measured."""
    kinds = (run.one_step, BLUE, "one step ahead"), (run.rollout, ORANGE, "roll-out")
    return [
        Curve(run.time[1:], measured + error.configuration[:, i], "run", color, label, run.run)
        for error, color, label in kinds
    ]
