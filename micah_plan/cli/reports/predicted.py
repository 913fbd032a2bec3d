"""What `predict` says: errors of predictions against what noise alone would leave."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.cli.console import out, table
from micah_plan.quantities import common_unit, quantity
from micah_plan.residual.judgement import Floor, judge
from micah_plan.residual.prediction import PredictionError, RunPrediction, rmse


def predicted(automaton: HybridAutomaton, runs: Sequence[RunPrediction]) -> dict[str, Any]:
    """Keys of `predict`: root mean squares over all runs against what noise alone would leave, and per run."""
    judged = judge(automaton, runs)
    return {
        "configuration_unit": common_unit(coordinate.unit for coordinate in automaton.coordinates),
        "one_step": _rmse([run.one_step for run in runs]),
        "rollout": _rmse([run.rollout for run in runs]),
        "noise_floor": {"one_step": _floor(judged.one_step), "rollout": _floor(judged.rollout)},
        "whiteness": {
            "is_noise": judged.is_noise,
            "verdict": judged.sentence,
            "follows": [{"coordinate": c, "what": what, "probability": p} for c, what, p in judged.follows],
            "lag_1_correlation": judged.correlation,
        },
        "mode_changes": [
            {"run": c.run, "mode": c.mode, "measured_s": c.measured, "predicted_s": c.predicted} for c in judged.changes
        ],
        "per_run": [
            {"run": run.run, "one_step": _rmse([run.one_step]), "rollout": _rmse([run.rollout])} for run in runs
        ],
        "per_mode": _per_mode(runs),
    }


def _floor(floor: Floor | None) -> dict[str, float | None] | None:
    if floor is None:
        return None
    return {
        "position_rmse_m": floor.position,
        "rotation_rmse_rad": floor.rotation,
        "configuration_rmse": floor.configuration,
    }


def _per_mode(runs: Sequence[RunPrediction]) -> dict[str, dict[str, float]]:
    """One-step errors of the configuration by the mode that a step ended in."""
    found: dict[str, list[float]] = {}
    for run in runs:
        for mode, errors in zip(run.one_step.modes, run.one_step.configuration, strict=True):
            found.setdefault(mode, []).extend(np.square(errors).tolist())
    return {m: {"configuration_rmse": float(np.sqrt(np.mean(v))), "steps": len(v)} for m, v in found.items()}


def _rmse(errors: Sequence[PredictionError]) -> dict[str, float | None]:
    rotations = [error.rotation for error in errors if error.rotation is not None]
    return {
        "position_rmse_m": rmse([error.position for error in errors]),
        "rotation_rmse_rad": rmse(rotations) if rotations else None,
        "configuration_rmse": rmse([error.configuration for error in errors]),
    }


def print_predicted(summary: dict[str, Any]) -> None:
    """Errors of both predictions beside what noise alone would leave, what they follow, and when modes changed."""
    shown = table("root mean square error", "position", "rotation", "configuration")
    for name, text in (("one_step", "one step"), ("rollout", "roll-out")):
        floor, unit = summary["noise_floor"][name], summary["configuration_unit"]
        shown.add_row(text, *_three(summary[name], unit))
        shown.add_row("  noise alone", *(_three(floor, unit) if floor else ("unknown",) * 3))
    out.print(shown)
    out.print(summary["whiteness"]["verdict"], markup=False)
    changes = summary["mode_changes"]
    both = [c["predicted_s"] - c["measured_s"] for c in changes if None not in (c["predicted_s"], c["measured_s"])]
    if changes:
        late = sum(both) / len(both) if both else 0.0
        when = f"{quantity(abs(late), 's')} {'early' if late < 0 else 'late'}" if abs(late) > 1e-6 else "in time"
        on_average = f", on average {when}" if both else ""
        missed = sum(c["predicted_s"] is None for c in changes)
        extra = len(changes) - len(both) - missed
        out.print(f"mode changes: {len(both)} predicted{on_average}, {missed} measured only, {extra} predicted only")


def _three(values: dict[str, float | None], unit: str) -> tuple[str, ...]:
    units = {"position_rmse_m": "m", "rotation_rmse_rad": "rad", "configuration_rmse": unit}
    found = ((values[name], own) for name, own in units.items())
    return tuple("not measured" if value is None else quantity(value, own, degrees=False) for value, own in found)
