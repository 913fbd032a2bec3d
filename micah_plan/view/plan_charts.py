"""The charts of a plan, on its page and in its figure: belief, its spread and the arm over the steps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.execution.mujoco.parameters import parameters_of
from micah_plan.quantities import count, percent, plain, quantity
from micah_plan.task.plan import ArmTrajectory, Plan, Trajectory
from micah_plan.task.problem import Problem
from micah_plan.view.chart import Area, Chart, Curve, Level, Mark, Panel, Range, Span, Words, widened
from micah_plan.view.motion import knot_times, mode_stretches, shown_duration, step_times, times_of_steps
from micah_plan.view.page import Block
from micah_plan.view.palette import BELIEF, EXECUTED, GOAL, mode_colors
from micah_plan.view.placement import guards_of

_MEAN, _SPREAD = 96.0, 44.0
MOST_COORDINATES = 12
_NARROW = 0.15  # of the axis; names of narrower stretches in a row end together where the last one ends
_LETTER = 0.021  # of the axis, on the page: names that would lie over the one before are left to the colours


@dataclass(frozen=True, eq=False)
class DrawnRun:
    """An executed run in charts.

    Attributes:
        number: by which its curves and its entry on the page belong together.
        x: (T, n) configurations, true or measured [rad or m].
        recording: name of its recording, where there are several; empty: it is the only one.
        color: of its curves.
    """

    number: int
    x: Floats
    recording: str = ""
    color: str = EXECUTED


def plan_charts(plan: Plan, problem: Problem, runs: Sequence[DrawnRun] = ()) -> list[Block]:
    """Charts of the belief with executed runs, and of the arm's manipulability and clearance; empty without a plan."""
    trajectory = plan.trajectory
    if trajectory is None:
        return []
    settings = problem.settings
    steps, last = step_times(trajectory).astype(np.float64), _last(trajectory, runs)
    times = [
        *knot_times(trajectory),
        float(times_of_steps(trajectory, np.array([last]))[0]),
        shown_duration(trajectory, last),
    ]
    frames = {float(time): float(step) for time, step in zip(times, [*steps, last, last], strict=True)}
    keyframes = tuple(sorted(frames.items()))
    legend = (
        f"Mean ± {plain(settings.sigmas)} σ, the room that a confidence of {percent(settings.confidence)} requires at "
        "a limit; below it σ alone. Green: goal. Dashed: where the mode changes."
    )
    left_out = problem.automaton.n - MOST_COORDINATES
    words = (legend,) if left_out <= 0 else (legend, f"{count(left_out, 'more coordinate')} not shown.")
    names = [name for name in dict.fromkeys(run.recording for run in runs) if name]
    if runs:
        words = (*words, f"Pink: {names[0]}. Orange: {names[1]}." if len(names) > 1 else "Orange: executed.")
    title = "Belief and executed runs" if runs else "Belief"
    blocks = [Block(title, words, belief_chart(problem, trajectory, runs), keyframes=keyframes)]
    if plan.arm is not None:
        blocks.append(Block("Arm", (), _arm_chart(problem, trajectory, plan.arm, last), keyframes=keyframes))
    return blocks


def step_label(problem: Problem) -> str:
    """The name of the axis of steps, with their duration."""
    return f"step, of {quantity(parameters_of(problem).control_period, 's')} each"


def belief_chart(
    problem: Problem, trajectory: Trajectory, runs: Sequence[DrawnRun] = (), *, spreads: bool = True
) -> Chart:
    """Mean and margin of every coordinate over the steps, with goal, guards and executed runs.

    Args:
        problem: with the confidence that the margin stands for: ± k σ with Phi(k) = confidence.
        trajectory: the belief.
        runs: that were executed.
        spreads: whether σ alone is drawn below each coordinate.
    """
    panels: list[Panel] = []
    shown = problem.automaton.coordinates[:MOST_COORDINATES]
    steps, stds = step_times(trajectory).astype(np.float64), np.sqrt((trajectory.factors**2).sum(axis=2))
    margin = f"± {plain(problem.settings.sigmas)} σ (confidence {percent(problem.settings.confidence)})"
    counts = Counter(run.recording for run in runs)
    labels = {
        name: (name or "executed") + (f" ({count(number, 'run')})" if number > 1 else "")
        for name, number in counts.items()
    }
    for i, coordinate in enumerate(shown):
        mean, std = trajectory.means[:, i], stds[:, i]
        lower, upper = mean - problem.settings.sigmas * std, mean + problem.settings.sigmas * std
        goals = [(value - tol, value + tol) for index, value, tol in problem.goal.target if index == i]
        low, high = widened([lower, upper, *(end for goal in goals for end in goal), *(run.x[:, i] for run in runs)])
        marks: list[Mark] = [Range(*goal, GOAL, "goal") for goal in goals]
        marks += [Level(at, label="guard") for at in guards_of(problem.automaton, i) if low < at < high]
        marks.append(Area(steps, lower, upper, color=BELIEF, label=f"belief, {margin}"))
        marks.append(Curve(steps, mean, color=BELIEF))
        for run in runs:
            at, label = np.arange(len(run.x), dtype=float), labels[run.recording]
            marks.append(Curve(at, run.x[:, i], "run", run.color, label, run.number))
        panels.append(Panel(f"{coordinate.name}\n[{coordinate.unit}]", low, high, _MEAN, tuple(marks)))
        if spreads:
            line = Curve(steps, std, color=BELIEF)
            panels.append(Panel(f"σ\n[{coordinate.unit}]", *widened([0.0, std]), _SPREAD, (line,)))
    return _over_steps(problem, trajectory, panels, _last(trajectory, runs), "belief")


def _last(trajectory: Trajectory, runs: Sequence[DrawnRun]) -> float:
    """The last step of the plan or of a run."""
    return max([float(step_times(trajectory)[-1]), 1.0, *(len(run.x) - 1.0 for run in runs)])


def _over_steps(
    problem: Problem, trajectory: Trajectory, panels: Sequence[Panel], last: float, described: str
) -> Chart:
    """Panels over the steps, shaded and named by mode."""
    steps, colors = step_times(trajectory).astype(np.float64), mode_colors(problem.automaton)
    bands = [(trajectory.modes[i], steps[i], steps[j]) for i, j in mode_stretches(trajectory.modes)]
    shades = [Span(float(start), float(end), color=colors[mode]) for mode, start, end in bands]
    shaded = [panel.with_marks(*shades) for panel in panels]
    shaded[0] = replace(shaded[0], marks=(*shaded[0].marks, *_names(bands, last)))
    label = f"{described} over the steps of the plan"
    return Chart(label, step_label(problem), 0.0, last, tuple(shaded), whole=True, lines=1, fills=True)


def _names(bands: Sequence[tuple[str, float, float]], last: float) -> list[Words]:
    """Names of modes above their bands; names of adjacent narrow bands are joined."""
    narrow = [end - start < _NARROW * last for _, start, end in bands]
    words, waiting, taken = list[Words](), list[str](), 0.0
    for number, (name, start, end) in enumerate(bands):
        waiting.append(name)
        if narrow[number] and any(narrow[number + 1 : number + 2]):
            continue
        names = ", ".join(waiting)
        length = _LETTER * last * (len(names) + 1)
        if not narrow[number]:
            words.append(Words(names, float(start), side="right"))
            taken = start + length
        elif end - length >= taken:
            words.append(Words(names, float(end), side="left"))
            taken = end
        waiting = []
    return words


def _arm_chart(problem: Problem, trajectory: Trajectory, arm: ArmTrajectory, last: float) -> Chart:
    """Manipulability and clearance of the arm."""
    steps, panels = step_times(trajectory).astype(np.float64), []
    clearance = np.array([np.nan if c is None else 1000.0 * c for c in arm.clearance])
    for label, values in (("manipulability", arm.manipulability), ("clearance\n[mm]", clearance)):
        shown = np.isfinite(values)
        if shown.any():
            line = Curve(steps[shown], values[shown], color=BELIEF)
            panels.append(Panel(label, *widened([0.0, values[shown]]), _MEAN, (line,)))
    return _over_steps(problem, trajectory, panels, last, "manipulability and clearance of the arm")
