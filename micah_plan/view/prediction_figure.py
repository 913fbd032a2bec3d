"""The figure of measured and predicted motion: one axes per coordinate and run, over the time of the run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.residual.prediction import (
    RunPrediction,
)
from micah_plan.view.chart import Chart, Curve, Level, Panel, widened
from micah_plan.view.palette import BLUE, INK, ORANGE
from micah_plan.view.plan_charts import MOST_COORDINATES

MOST_RUNS, MOST_DRAWN = 20, 6
_HEIGHT = 110.0


def prediction_charts(automaton: HybridAutomaton, runs: Sequence[RunPrediction]) -> list[Chart]:
    """One chart for each of the first runs."""
    return [
        replace(prediction_chart(automaton, [run]), x_label=f"time in run {run.run} [s]") for run in runs[:MOST_DRAWN]
    ]


def prediction_chart(automaton: HybridAutomaton, runs: Sequence[RunPrediction]) -> Chart:
    """Measured, one step ahead and rolled out, per coordinate; below it the errors of both."""
    panels: list[Panel] = []
    shown = automaton.coordinates[:MOST_COORDINATES]
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
    """One-step and roll-out errors, added to the measured values."""
    kinds = (run.one_step, BLUE, "one step ahead"), (run.rollout, ORANGE, "roll-out")
    return [
        Curve(run.time[1:], measured + error.configuration[:, i], "run", color, label, run.run)
        for error, color, label in kinds
    ]
