"""Executed runs on the page of their plan: a ghost of each, its track, its entry in the list; what is said of all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.quantities import count, quantity
from micah_plan.task.plan import Trajectory
from micah_plan.view.drawing import draw_shapes, link_shapes, shown_links
from micah_plan.view.executed import ExecutedRun
from micah_plan.view.motion import times_of_steps
from micah_plan.view.page import LegendEntry, RunEntry, Status
from micah_plan.view.palette import EXECUTED
from micah_plan.view.placement import handle_in_part
from micah_plan.view.scene import Scene, slug
from micah_plan.view.solids import beads
from micah_plan.view.svg import evenly

# More would make the page large and the list long; failed runs come first.
_MOST_GHOSTS, _MOST_KEYFRAMES = 20, 200
_LAYER = "runs"


def first_runs(runs: Sequence[ExecutedRun]) -> list[ExecutedRun]:
    """The runs that a page shows: those that failed, then those that left the plan, then the others."""
    return sorted(runs, key=lambda run: (run.reached, not run.leaving, run.run))[:_MOST_GHOSTS]


def draw_runs(
    scene: Scene, automaton: HybridAutomaton, trajectory: Trajectory, runs: Sequence[ExecutedRun], size: float
) -> list[RunEntry]:
    """A ghost of every run along the plan's clock, with beads where its handle was; the entries of the list."""
    entries = []
    for order, run in enumerate(runs):
        layer = f"{_LAYER}/{order}_run"
        rows = evenly(len(run.x), _MOST_KEYFRAMES)
        clock = times_of_steps(trajectory, rows.astype(float))
        for number, link in shown_links(automaton):
            poses = run.poses[link.child]
            path = f"{layer}/{slug(link.child, number)}"
            draw_shapes(scene, path, link_shapes(automaton, number), color=EXECUTED, opacity=0.42)
            scene.animate(path, clock, poses[rows])
            track = np.asarray(poses.apply(handle_in_part(automaton, link.child)))
            scene.mesh(f"{layer}/track/{number}", beads(track[rows], 0.012 * size), EXECUTED)
        entries.append(
            RunEntry(run.label, run.words, layer, run.run, _readouts(automaton, run, clock.tolist(), rows.tolist()))
        )
    return entries


def _readouts(
    automaton: HybridAutomaton, run: ExecutedRun, clock: Sequence[float], rows: Sequence[int]
) -> tuple[tuple[float, tuple[str, ...]], ...]:
    """Seconds, believed mode and configuration of a run at its rows."""
    found = []
    for time, row in zip(clock, rows, strict=True):
        mode = f", believed {run.modes[row]}" if run.modes else ""
        values = [
            f"{c.name} = {quantity(float(value), c.unit, degrees=False)} executed"
            for c, value in zip(automaton.coordinates, run.x[row], strict=True)
        ]
        found.append((time, (f"run {run.run} after {quantity(float(run.seconds[row]), 's')}{mode}", *values)))
    return tuple(found)


def runs_legend() -> list[LegendEntry]:
    """What ghosts and beads are."""
    return [LegendEntry(EXECUTED, "executed: the object as it was measured, and where its handle was", _LAYER)]


def runs_badge(runs: Sequence[ExecutedRun]) -> tuple[str, Status]:
    """How many runs reached the goal."""
    reached = sum(run.reached for run in runs)
    status: Status = "good" if reached == len(runs) else "fair" if reached else "bad"
    return f"{reached} of {count(len(runs), 'run')} reached the goal", status


def runs_details(runs: Sequence[ExecutedRun]) -> list[tuple[str, list[str]]]:
    """Every run with its ending, for the panel."""
    shown = min(len(runs), _MOST_GHOSTS)
    title = f"All {len(runs)} runs" + (f" ({shown} are drawn, those that failed first)" if shown < len(runs) else "")
    return [(title, [f"Run {run.run}: {' '.join(run.words)}" for run in runs])]
