"""Executed runs on the page of their plan: a ghost, a track and a list entry for each, and a summary."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.quantities import count, quantity
from micah_plan.task.plan import Trajectory
from micah_plan.view.chart import evenly
from micah_plan.view.drawing import draw_shapes, link_shapes, shown_links
from micah_plan.view.executed import ExecutedRun
from micah_plan.view.learned_words import capital
from micah_plan.view.motion import times_of_steps
from micah_plan.view.page import LegendEntry, RunEntry, Status
from micah_plan.view.palette import EXECUTED_BEFORE
from micah_plan.view.placement import handle_in_part
from micah_plan.view.scene import DrawnScene, slug
from micah_plan.view.solids import beads

# More would make the page large and the list long; failed runs come first.
_MOST_GHOSTS, MOST_KEYFRAMES = 20, 200
_LAYER = "runs"


def first_runs(runs: Sequence[ExecutedRun]) -> list[ExecutedRun]:
    """The runs that a page shows, equally many per recording: failures first, then deviations, then others."""
    names = list(dict.fromkeys(run.recording for run in runs))
    return [
        run
        for name in names
        for run in sorted(
            (run for run in runs if run.recording == name), key=lambda run: (run.reached, not run.leaving, run.run)
        )[: _MOST_GHOSTS // len(names)]
    ]


def draw_runs(
    scene: DrawnScene, automaton: HybridAutomaton, trajectory: Trajectory, runs: Sequence[ExecutedRun], size: float
) -> list[RunEntry]:
    """Draw a ghost of every run on the plan's clock, with its handle's path; returns the list entries."""
    entries = []
    for order, run in enumerate(runs):
        layer = f"{_layer(run)}/{order}_run"
        rows = evenly(len(run.x), MOST_KEYFRAMES)
        clock = times_of_steps(trajectory, rows.astype(float))
        for number, link in shown_links(automaton):
            poses = run.poses[link.child]
            path = f"{layer}/{slug(link.child, number)}"
            draw_shapes(scene, path, link_shapes(automaton, number), color=run.color, opacity=0.42)
            scene.animate(path, clock, poses[rows])
            track = np.asarray(poses.apply(handle_in_part(automaton, link.child)))
            scene.mesh(f"{layer}/track/{number}", beads(track[rows], 0.012 * size), run.color)
        entries.append(
            RunEntry(run.label, run.words, layer, run.number, _readouts(automaton, run, clock.tolist(), rows.tolist()))
        )
    return entries


def _readouts(
    automaton: HybridAutomaton, run: ExecutedRun, clock: Sequence[float], rows: Sequence[int]
) -> tuple[tuple[float, tuple[str, ...]], ...]:
    """Seconds, believed mode and configuration of a run at its rows."""
    lines = []
    for time, row in zip(clock, rows, strict=True):
        mode = f", believed {run.modes[row]}" if run.modes else ""
        values = [
            f"{c.name} = {quantity(float(value), c.unit, degrees=False)} executed"
            for c, value in zip(automaton.coordinates, run.x[row], strict=True)
        ]
        lines.append((time, (f"{run.name} after {quantity(float(run.seconds[row]), 's')}{mode}", *values)))
    return tuple(lines)


def runs_legend(runs: Sequence[ExecutedRun]) -> list[LegendEntry]:
    """Legend entries of ghosts and beads."""
    what = "the object as it was measured, and where its handle was"
    kinds = dict.fromkeys((run.color, run.recording or "executed", _layer(run)) for run in runs)
    return [LegendEntry(color, f"{name}: {what}", layer) for color, name, layer in kinds]


def _layer(run: ExecutedRun) -> str:
    """The layer of a run's recording."""
    when = "before" if run.color == EXECUTED_BEFORE else "after"
    return f"{_LAYER}/{when}" if run.recording else _LAYER


def runs_badge(runs: Sequence[ExecutedRun]) -> tuple[str, Status]:
    """Number of successful runs per recording, coloured by the last one."""
    badges = list[str]()
    status: Status = "bad"
    for name in dict.fromkeys(run.recording for run in runs):
        own = [run.reached for run in runs if run.recording == name]
        status = "good" if all(own) else "fair" if any(own) else "bad"
        badges.append(f"{name}: " * bool(name) + f"{sum(own)} of {count(len(own), 'run')}")
    return f"{', '.join(badges)} reached the goal", status


def runs_details(runs: Sequence[ExecutedRun]) -> list[tuple[str, list[str]]]:
    """Outcomes of all runs, for the panel."""
    shown = len(first_runs(runs))
    title = f"All {len(runs)} runs" + (f" ({shown} are drawn, those that failed first)" if shown < len(runs) else "")
    return [(title, [f"{capital(run.name)}: {' '.join(run.words)}" for run in runs])]
