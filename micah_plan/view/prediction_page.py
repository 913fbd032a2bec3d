"""The page of a prediction: the object as it was measured beside where the model has it, run by run.

The figure of measured and predicted motion: one axes per coordinate and run, over the time of the run.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import RigidTransform

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.quantities import count, quantity
from micah_plan.recording.value import Recording
from micah_plan.residual.judgement import Floor, Judgement
from micah_plan.residual.prediction import PredictionError, RunPrediction, rmse, rmse_of_coordinates
from micah_plan.view.camera import camera
from micah_plan.view.drawing import draw_shapes, fixed_shapes, link_shapes, object_size, shape_corners, shown_links
from micah_plan.view.executed import poses_of_run
from micah_plan.view.learned import capital
from micah_plan.view.model_page import draw_ground_and_frame, ground_legend
from micah_plan.view.motion import Keyframes, poses_over_time
from micah_plan.view.page import Chart, LegendEntry, RunEntry, ScenePage, Status, Timeline, render_scene
from micah_plan.view.palette import BLUE, INK, ORANGE
from micah_plan.view.placement import handle_in_part
from micah_plan.view.scene import Scene, slug
from micah_plan.view.svg import Panel, Svg, enlarged, evenly, played

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_RUNS, _MOST_KEYFRAMES, _MOST_COORDINATES = 20, 200, 12
_SHORTEST_S, _LONGEST_S, _REST_S = 4.0, 15.0, 0.8
_WIDTH, _LEFT, _RIGHT, _TOP, _HEIGHT, _GAP = 420.0, 66.0, 8.0, 6.0, 110.0, 14.0
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
        charts=_charts(automaton, worst, longest, scale),
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


def _charts(automaton: HybridAutomaton, runs: Sequence[RunPrediction], longest: float, scale: float) -> list[Chart]:
    """Measured, one step ahead and rolled out, per coordinate; below it the errors of both."""
    top = Panel(_LEFT, _TOP - _GAP, _WIDTH - _LEFT - _RIGHT, 0.0, 0.0, max(longest, 1e-9), 0.0, 1.0)
    ends = ((0.0, 0.0), (longest * scale, longest), (longest * scale + _REST_S, longest))
    frames = tuple((shown, top.x(time)) for shown, time in ends)
    panels: list[Panel] = []
    parts: list[Svg] = []
    height = _HEIGHT * enlarged(2 * _HEIGHT * min(automaton.n, _MOST_COORDINATES))
    for i, coordinate in enumerate(automaton.coordinates[:_MOST_COORDINATES]):
        errors = [(run.one_step.configuration[:, i], run.rollout.configuration[:, i]) for run in runs]
        measured = [run.x[:, i] for run in runs]
        predicted = [
            (x[1:] + step_error, x[1:] + rolled) for x, (step_error, rolled) in zip(measured, errors, strict=True)
        ]
        panel = top.below(_GAP, height, *_ends([*measured, *(rolled for _, rolled in predicted)]))
        top = panel.below(_GAP, height, *_ends([error for both in errors for error in both]))
        panels += [panel, top]
        for run, x in zip(runs, measured, strict=True):
            parts.append(panel.curve(run.time, x, "run dots small", INK, dots=True, data_run=str(run.run)))
        parts += [*_curves(panel, runs, predicted), top.level(0.0, "zero"), *_curves(top, runs, errors)]
        parts += [panel.y_axis(f"{coordinate.name}\n[{coordinate.unit}]"), top.y_axis(f"error\n[{coordinate.unit}]")]
    words = ["Dots: measured. Blue: predicted one step ahead of each measured row. Orange: from the first row alone."]
    left_out = automaton.n - _MOST_COORDINATES
    words += [f"{count(left_out, 'more coordinate')} not shown."] if left_out > 0 else []
    drawing = played(_WIDTH, panels, parts, "time in the run [s]", "measured and predicted over time")
    return [Chart("Measured and predicted", tuple(words), drawing, keyframes=frames)]


def _curves(panel: Panel, runs: Sequence[RunPrediction], both: Sequence[tuple[Floats, Floats]]) -> list[Svg]:
    """One step ahead and rolled out, of every run, over the rows after its first."""
    drawn = []
    for run, curves in zip(runs, both, strict=True):
        for values, color in zip(curves, (BLUE, ORANGE), strict=True):
            drawn.append(panel.curve(run.time[1:], values, "run", color, data_run=str(run.run)))
    return drawn


def _ends(values: Sequence[Floats]) -> tuple[float, float]:
    low, high = min(float(v.min()) for v in values), max(float(v.max()) for v in values)
    room = 0.08 * (high - low) or 1e-3
    return low - room, high + room


_MOST_RUNS_DRAWN = 6


def prediction_figure(
    automaton: HybridAutomaton, runs: Sequence[RunPrediction], corrected: Sequence[RunPrediction] = ()
) -> Figure:
    """Measured configurations, one-step predictions and roll-outs of the first runs.

    Args:
        automaton: of the predictions.
        runs: at least one.
        corrected: the same runs as another model predicts them; then roll-outs alone are drawn, of both.
    """
    from micah_plan.view.figures import empty_figure  # pages need no Matplotlib

    shown = list(runs)[:_MOST_RUNS_DRAWN]
    size = (3.4 * max(len(shown), 2), 0.8 + 2.4 * automaton.n)
    figure = empty_figure(size, layout="constrained")
    grid = figure.subplots(automaton.n, len(shown), sharex="col", sharey="row", squeeze=False)
    for column, run in enumerate(shown):
        others = (run,) if not corrected else (run, corrected[column])
        for i in range(automaton.n):
            _draw(grid[i, column], i, others)
        grid[0, column].set_title(f"run {run.run}", fontsize=10)
        grid[-1, column].set_xlabel("time in the run [s]")
    for i, coordinate in enumerate(automaton.coordinates):
        grid[i, 0].set_ylabel(f"{coordinate.name} [{coordinate.unit}]")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False, fontsize=9)
    return figure


def _draw(axes: Axes, i: int, runs: Sequence[RunPrediction]) -> None:
    """Measured, and what one model predicts in both ways, or two models in one."""
    first = runs[0]
    axes.spines[["top", "right"]].set_visible(False)
    axes.plot(first.time, first.x[:, i], ".", ms=3.5, color=INK, label="measured")
    if len(runs) == 1:
        predicted = first.x[1:, i] + first.one_step.configuration[:, i]
        axes.plot(first.time[1:], predicted, color=BLUE, lw=1.0, alpha=0.8, label="one step ahead")
    names = ("roll-out",) if len(runs) == 1 else ("roll-out before", "roll-out calibrated")
    for run, name, color in zip(runs, names, (ORANGE, BLUE), strict=False):
        rolled = np.concatenate([run.x[:1, i], run.x[1:, i] + run.rollout.configuration[:, i]])
        axes.plot(run.time, rolled, color=color, lw=1.6, label=name)
