"""The page of a prediction: the measured object beside one or two models, run by run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import RigidTransform

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.quantities import count, quantity
from micah_plan.recording.value import Recording
from micah_plan.residual.calibration import Calibration
from micah_plan.residual.judgement import Floor, Judgement
from micah_plan.residual.prediction import (
    PredictionError,
    RunPrediction,
    rmse,
    rmse_of_coordinates,
)
from micah_plan.view.camera import camera
from micah_plan.view.chart import evenly
from micah_plan.view.drawing import draw_shapes, fixed_shapes, link_shapes, object_size, shape_corners, shown_links
from micah_plan.view.executed import poses_of_run
from micah_plan.view.learned_words import capital
from micah_plan.view.model_page import draw_ground_and_frame, ground_legend
from micah_plan.view.motion import LONGEST_S, REST_S, SHORTEST_S, Keyframes, poses_over_time
from micah_plan.view.page import Block, LegendEntry, RunEntry, ScenePage, Status, Timeline, render_scene
from micah_plan.view.palette import BLUE, INK, ORANGE
from micah_plan.view.placement import handle_in_part
from micah_plan.view.plan_charts import MOST_COORDINATES
from micah_plan.view.prediction_figure import MOST_DRAWN, MOST_RUNS, prediction_chart
from micah_plan.view.runs_on_page import MOST_KEYFRAMES
from micah_plan.view.scene import DrawnScene, slug

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
        recording: the measurements.
        runs: its predictions, of the same recording.
        judged: evaluation of their errors.
    """
    worst = sorted(runs, key=lambda run: -rmse([run.rollout.position]))[:MOST_RUNS]
    scene, scale, longest = _scene_of(automaton, worst)
    entries, handles = [], []
    for order, run in enumerate(worst):
        entry, points = _draw_run(scene, recording, [_Ghost(automaton, run, ORANGE)], order, scale)
        entries.append(entry)
        handles += points
    spacing = draw_ground_and_frame(scene, object_size(automaton))
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
        timeline=Timeline(longest * scale + REST_S),
        charts=_blocks(automaton, worst, longest, scale),
        runs=entries,
    )
    return render_scene(page, scene)


@dataclass(frozen=True, eq=False)
class _Ghost:
    """The roll-out of a run by a model, drawn in a colour."""

    automaton: HybridAutomaton
    run: RunPrediction
    color: str
    name: str = "predicted"

    @cached_property
    def modes(self) -> tuple[str, ...]:
        """(K + 1,) of the configurations."""
        return (self.run.rollout.modes[0], *self.run.rollout.modes)

    @cached_property
    def x(self) -> Floats:
        """(K + 1, n) configurations, the first as it was measured."""
        return np.vstack([self.run.x[:1], self.run.x[1:] + self.run.rollout.configuration])


def _draw_run(
    scene: DrawnScene, recording: Recording, ghosts: Sequence[_Ghost], order: int, scale: float
) -> tuple[RunEntry, list[Floats]]:
    """Draw the measured object and the ghosts of its roll-outs; returns the run's entry and the handles' paths."""
    automaton, run = ghosts[0].automaton, ghosts[0].run
    rows = evenly(len(run.time), MOST_KEYFRAMES)
    clock = run.time[rows] * scale
    measured = poses_of_run(automaton, recording.select(run=run.run), run.x, ())
    drawn: list[tuple[HybridAutomaton, str, Mapping[str, RigidTransform], str | None, float]] = [
        (automaton, "measured", {name: poses[rows] for name, poses in measured.items()}, None, 1.0)
    ]
    for ghost in ghosts:
        keys = Keyframes(clock, tuple(ghost.modes[i] for i in rows), ghost.x[rows])
        drawn.append((ghost.automaton, ghost.name, poses_over_time(ghost.automaton, keys), ghost.color, 0.45))
    layer, points = f"runs/{order}_run", list[Floats]()
    for model, kind, poses_of, color, opacity in drawn:
        for number, link in shown_links(model):
            shapes, path = link_shapes(model, number), f"{layer}/{kind}/{slug(link.child, number)}"
            poses = poses_of[link.child]
            draw_shapes(scene, path, shapes, color=color, opacity=opacity)
            scene.animate(path, clock, poses)
            for i in range(0, len(poses), max(1, len(poses) // 6)):
                scene.reserve(shape_corners(shapes, poses[i]))
    for _, link in shown_links(automaton):
        points.append(np.asarray(measured[link.child].apply(handle_in_part(automaton, link.child))))
    return RunEntry(f"run {run.run}", _run_words(ghosts), layer, run.run, _readouts(ghosts, scale)), points


def _run_words(ghosts: Sequence[_Ghost]) -> tuple[str, ...]:
    """Root mean square errors of one model, or of two in roll-outs."""
    sizes = [
        [_sizes(ghost.automaton, rmse_of_coordinates([error])) for error in (ghost.run.one_step, ghost.run.rollout)]
        for ghost in ghosts
    ]
    if len(ghosts) > 1:
        rolled = ", ".join(f"{size} {ghost.name}" for ghost, (_, size) in zip(ghosts, sizes, strict=True))
        return (f"Off by {rolled} (root mean square).",)
    ((steps, rolled),) = sizes
    return (f"One step ahead {steps} off, from the first row on {rolled} (root mean square).",)


def calibration_scene(calibration: Calibration, title: str) -> str | None:
    """The page (HTML) of the measured object with its roll-outs before and after a calibration; None if there are none.

    A run is drawn where both models have it in the same parts.
    """
    recording, models = calibration.recording, (calibration.nominal, calibration.automaton)
    before, after = (
        {(run.run, float(run.time[0]), len(run.time)): run for run in runs} for runs in calibration.predicted
    )
    both = [(before[key], after[key]) for key in before if key in after]
    worst = sorted(both, key=lambda pair: -rmse([pair[0].rollout.position]))[:MOST_DRAWN]
    if not worst:
        return None
    colors = ((ORANGE, "before"), (BLUE, "after"))[: 1 if calibration.automaton is calibration.nominal else 2]
    scene, scale, longest = _scene_of(calibration.nominal, [run for run, _ in worst])
    entries, handles = [], []
    for order, pair in enumerate(worst):
        ghosts = [_Ghost(model, run, *color) for model, run, color in zip(models, pair, colors, strict=False)]
        entry, points = _draw_run(scene, recording, ghosts, order, scale)
        entries.append(entry)
        handles += points
    spacing = draw_ground_and_frame(scene, object_size(calibration.nominal))
    page = ScenePage(
        title=title,
        kind="measured against two models",
        camera=camera(scene, np.concatenate(handles)),
        legend=[
            LegendEntry(INK, "the object as it was measured, in its own colours"),
            *(LegendEntry(color, f"roll-out {name} the calibration") for color, name in colors),
            *ground_legend(spacing),
        ],
        timeline=Timeline(longest * scale + REST_S),
        runs=entries,
        is_within=True,
        fade=("before", "after") if len(colors) > 1 else None,
    )
    return render_scene(page, scene)


def _scene_of(automaton: HybridAutomaton, runs: Sequence[RunPrediction]) -> tuple[DrawnScene, float, float]:
    """(scene with the fixed parts, player seconds per run second, duration of the longest run [s])."""
    scene, longest = DrawnScene(), max(float(run.time[-1]) for run in runs)
    fixed = fixed_shapes(automaton)
    draw_shapes(scene, "object/fixed", fixed, opacity=0.5)
    scene.reserve(shape_corners(fixed, RigidTransform.identity()))
    return scene, min(max(longest, SHORTEST_S), LONGEST_S) / max(longest, 1e-9), longest


def _readouts(ghosts: Sequence[_Ghost], scale: float) -> tuple[tuple[float, tuple[str, ...]], ...]:
    """Measured and predicted values at each keyframe, by the player's clock [s]."""
    readouts, run = [], ghosts[0].run
    for row in evenly(len(run.time), MOST_KEYFRAMES).tolist():
        when = quantity(float(run.time[row]), "s")
        lines = [f"run {run.run} after {when}, {', '.join(f'{ghost.name} {ghost.modes[row]}' for ghost in ghosts)}"]
        for i, c in enumerate(ghosts[0].automaton.coordinates):
            values = [("measured", run.x[row, i]), *((ghost.name, ghost.x[row, i]) for ghost in ghosts)]
            words = (f"{quantity(float(value), c.unit, degrees=False)} {name}" for name, value in values)
            lines.append(f"{c.name} = {', '.join(words)}")
        readouts.append((float(run.time[row] * scale), tuple(lines)))
    return tuple(readouts)


def _sizes(automaton: HybridAutomaton, sizes: Sequence[float]) -> str:
    """Root mean squares (n,) of coordinates: combined if they share a unit, else each with its name."""
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
        if floor is not None:
            facts.append(("… noise alone would leave", _sizes(automaton, floor.coordinates)))
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
    ends = ((0.0, 0.0), (longest * scale, longest), (longest * scale + REST_S, longest))
    words = ["Dots: measured. Blue: predicted one step ahead of each measured row. Orange: from the first row alone."]
    left_out = automaton.n - MOST_COORDINATES
    words += [f"{count(left_out, 'more coordinate')} not shown."] if left_out > 0 else []
    return [Block("Measured and predicted", tuple(words), prediction_chart(automaton, runs), keyframes=ends)]
