"""The figure of measured and predicted motion: one axes per coordinate and run, over the time of the run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.residual.prediction import RunPrediction
from micah_plan.view.figures import empty_figure
from micah_plan.view.palette import BLUE, INK, ORANGE

_MOST_RUNS = 6


def prediction_figure(
    automaton: HybridAutomaton, runs: Sequence[RunPrediction], corrected: Sequence[RunPrediction] = ()
) -> Figure:
    """Measured configurations, one-step predictions and roll-outs of the first runs.

    Args:
        automaton: of the predictions.
        runs: at least one.
        corrected: the same runs as another model predicts them; then roll-outs alone are drawn, of both.
    """
    shown = list(runs)[:_MOST_RUNS]
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
