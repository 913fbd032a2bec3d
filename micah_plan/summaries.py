"""What the commands report, as plain data: the JSON keys that scripts rely on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from micah_plan.automaton.graph import Segment
from micah_plan.automaton.joint import Joint, radius
from micah_plan.planning.plan import Plan

if TYPE_CHECKING:
    from micah_plan.execution.trials import TrialStatistics
    from micah_plan.residual.prediction import PredictionError, RunPrediction
    from micah_plan.workflow import Learned


def joint_parameters(joint: Joint) -> dict[str, Any]:
    """Axis (unit, base frame), center [m], radius [m], pitch [m/rad], pose at configuration 0, as far as they apply."""
    parameters: dict[str, Any] = {"position": list(joint.position), "orientation": list(joint.quaternion)}
    if joint.kind != "rigid":
        parameters["axis"] = list(joint.axis)
    if joint.kind in ("revolute", "screw"):
        parameters |= {"center": list(joint.center), "radius": float(radius(joint))}
    if joint.kind == "screw":
        parameters["pitch"] = joint.pitch
    return parameters


def learned(result: Learned, seed: int) -> dict[str, Any]:
    """Keys of `learn`: segments and changepoints (per edge if there are several parts), seconds, seed."""
    edges = [
        {
            "parent": edge.parent,
            "child": edge.child,
            "segments": [_segment(segment) for segment in edge.segments],
            "changepoints": list(edge.changepoints),
        }
        for edge in result.graph.edges
    ]
    found = {"edges": edges} if len(edges) > 1 else {key: edges[0][key] for key in ("segments", "changepoints")}
    return {**found, "modes": [mode.name for mode in result.automaton.modes], "seconds": result.seconds, "seed": seed}


def _segment(segment: Segment) -> dict[str, Any]:
    return {
        "model": segment.joint.kind,
        "start": segment.start,
        "end": segment.end,
        "run": segment.run,
        "parameters": joint_parameters(segment.joint),
        "configuration": [segment.configuration_start, segment.configuration_end],
        "probability": segment.probability,
    }


def segment_row(segment: Segment) -> tuple[str, ...]:
    """One line of the table that `learn` prints."""
    joint = segment.joint
    unit = {"rigid": "", "prismatic": " m"}.get(joint.kind, " rad")
    axis = "" if joint.kind == "rigid" else " ".join(f"{value:+.2f}" for value in joint.axis)
    arm = f"{radius(joint):.3f} m" if joint.kind in ("revolute", "screw") else ""
    ends = (f"{segment.configuration_start:+.3f}{unit}", f"{segment.configuration_end:+.3f}{unit}")
    return (joint.kind, f"{segment.start}-{segment.end}", *ends, axis, arm)


def solved(plan: Plan) -> dict[str, Any]:
    """Keys of `solve`."""
    return {
        "outcome": plan.outcome,
        "reason": plan.reason,
        "modes": list(plan.mode_sequence),
        "cost": plan.cost,
        "goal_error": plan.goal_error,
        "goal_std": plan.goal_std,
        "success_probability": plan.success_probability,
        "seconds": dict(plan.timings),
        "seed": plan.seed,
    }


def executed(statistics: TrialStatistics, seconds: float) -> dict[str, Any]:
    """Keys of `execute`."""
    return {
        "trials": statistics.trials,
        "successes": statistics.successes,
        "final_error": {
            "mean": statistics.final_error.mean,
            "std": statistics.final_error.std,
            "max": statistics.final_error.max,
        },
        "failures": [{"trial": trial, "reason": reason} for trial, reason in statistics.failures],
        "seconds": seconds,
    }


def predicted(runs: Sequence[RunPrediction]) -> dict[str, Any]:
    """Keys of `predict`: root mean squares over all runs, and per run."""
    return {
        "one_step": _rmse([run.one_step for run in runs]),
        "rollout": _rmse([run.rollout for run in runs]),
        "per_run": [
            {"run": run.run, "one_step": _rmse([run.one_step]), "rollout": _rmse([run.rollout])} for run in runs
        ],
    }


def _rmse(errors: Sequence[PredictionError]) -> dict[str, float | None]:
    from micah_plan.residual.prediction import rmse

    rotations = [error.rotation for error in errors if error.rotation is not None]
    return {
        "position_rmse_m": rmse([error.position for error in errors]),
        "rotation_rmse_rad": rmse(rotations) if rotations else None,
        "configuration_rmse": rmse([error.configuration for error in errors]),
    }
