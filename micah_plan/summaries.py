"""What the commands report, as plain data: the JSON keys that scripts rely on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from micah_plan.automaton.certainty import CHANNEL_NAMES, ActionChannel, Misfit
from micah_plan.automaton.graph import KinematicEdge, Segment
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.joint import Joint, radius
from micah_plan.automaton.misfit import misfit_of
from micah_plan.errors import InputError
from micah_plan.task.plan import Plan

if TYPE_CHECKING:
    from micah_plan.checking import FileCheck
    from micah_plan.environment import Environment
    from micah_plan.execution.trials import TrialStatistics
    from micah_plan.planning.explain import Explanation
    from micah_plan.residual.calibrate import Calibration, FoundEffect
    from micah_plan.residual.judgement import Floor
    from micah_plan.residual.missing_mode import MissingMode
    from micah_plan.residual.prediction import PredictionError, RunPrediction
    from micah_plan.residual.trace import LaneTrace
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
    """Keys of `learn`: what is said of the edge (of each, in `edges`, if there are several parts), seconds, seed.

    Attributes of certainty that nobody worked out are null.
    """
    edges = [{"parent": edge.parent, "child": edge.child, **_edge(edge)} for edge in result.graph.edges]
    found = {"edges": edges} if len(edges) > 1 else _edge(result.graph.edges[0])
    modes = [] if result.automaton is None else list(result.automaton.mode_names)
    told = {"reason": result.reason, "warnings": list(result.warnings)}
    return {**found, "modes": modes, **told, "seconds": result.seconds, "seed": seed}


def _edge(edge: KinematicEdge) -> dict[str, Any]:
    sure = edge.certainty
    return {
        "segments": [_segment(segment) for segment in edge.segments],
        "changepoints": list(edge.changepoints),
        "changepoint_counts": None if sure is None else [list(run) for run in sure.changepoint_counts],
        "action_channel": None if sure is None or sure.channel is None else _channel(sure.channel),
    }


def _segment(segment: Segment) -> dict[str, Any]:
    sure, misfit = segment.certainty, misfit_of(segment)
    start = None if sure is None else sure.start
    data: dict[str, Any] = {
        "model": segment.joint.kind,
        "start": segment.start,
        "end": segment.end,
        "run": segment.run,
        "start_interval": None if start is None else list(start.interval()),
    }
    fitted = {
        "parameters": joint_parameters(segment.joint),
        **_spread(segment.joint),
        "configuration": [segment.configuration_start, segment.configuration_end],
        "probability": segment.probability,
        "probabilities": None if sure is None else dict(sure.kinds),
    }
    if misfit is None:
        return data | fitted
    best = {"model": segment.joint.kind, **fitted}
    return data | {"model": "none", "parameters": {}, "best": best, "misfit": _misfit(misfit)}


def _spread(joint: Joint) -> dict[str, Any]:
    """Covariance of a joint's parameters and their standard deviations, by name [rad, m, m/rad]."""
    if joint.covariance is None:
        return {"stds": None, "covariance": None}
    names, matrix = joint.covariance.names, joint.covariance.matrix
    stds = dict(zip(names, _stds(matrix), strict=True))
    return {"stds": stds, "covariance": {"names": list(names), "matrix": [list(row) for row in matrix]}}


def _misfit(misfit: Misfit) -> dict[str, float | None]:
    return {
        "position_m": misfit.position,
        "rotation_rad": misfit.rotation,
        "position_noise_m": misfit.position_noise,
        "rotation_noise_rad": misfit.rotation_noise,
        "log_odds": misfit.log_odds,
    }


def _channel(channel: ActionChannel) -> dict[str, Any]:
    *turned, gain, delay = _stds(channel.covariance)
    return {
        "frame_rotation": list(channel.frame_rotation),
        "gain": channel.gain,
        "delay": channel.delay,
        "stds": {"frame_rotation": turned, "gain": gain, "delay": delay},
        "covariance": {"names": list(CHANNEL_NAMES), "matrix": [list(row) for row in channel.covariance]},
        "explained": channel.explained,
    }


def _stds(matrix: Sequence[Sequence[float]]) -> list[float]:
    return [math.sqrt(max(row[i], 0.0)) for i, row in enumerate(matrix)]


def segment_row(segment: Segment) -> tuple[str, ...]:
    """One line of the table that `learn` prints, short enough for 80 columns.

    Mode, rows, configuration, axis, radius [m], how sure, first row at 95 %.
    """
    joint, rows, misfit = segment.joint, f"{segment.start}-{segment.end}", misfit_of(segment)
    if misfit is not None:
        return ("none", rows, f"misses by {1e3 * misfit.position:.3g} mm", "", "", "", _start(segment))
    axis = "" if joint.kind == "rigid" else " ".join(_rounded(value, 2) for value in joint.axis)
    arm = f"{radius(joint):.3f}" if joint.kind in ("revolute", "screw") else ""
    way = _rounded(segment.configuration_end, 3) if joint.kind == "rigid" else _way(segment)
    sure = segment.certainty
    probability = segment.probability if sure is None else dict(sure.kinds).get(joint.kind, 0.0)
    percent = ">99 %" if probability > 0.995 else f"{100 * probability:.0f} %"
    return (joint.kind, rows, way, axis, arm, percent, _start(segment))


def _way(segment: Segment) -> str:
    """Where a moving segment begins and ends, and where it turns around if it comes back from further on."""
    ends = [segment.configuration_start, segment.configuration_end]
    low, high = segment.configuration_range
    furthest = max((low, high), key=lambda value: min(abs(value - end) for end in ends))
    turned = min(abs(furthest - end) for end in ends) > 0.2 * (high - low)
    stops = [ends[0], furthest, ends[1]] if turned else ends
    return " → ".join(_rounded(value, 3) for value in stops) + (" m" if segment.joint.kind == "prismatic" else " rad")


def _rounded(value: float, digits: int) -> str:
    """Without a sign where nothing but 0 is left."""
    return f"{round(value, digits) + 0.0:.{digits}f}"


def _start(segment: Segment) -> str:
    """The rows at one of which a segment starts, with 95 % probability; empty where nothing tells."""
    if segment.certainty is None or segment.certainty.start is None:
        return ""
    first, last = segment.certainty.start.interval()
    return f"{first}" if first == last else f"{first}-{last}"


def channel_line(channel: ActionChannel) -> str:
    """The line on the action channel that `learn` prints, with one standard deviation each; it fits 80 columns."""
    *_, gain, delay = _stds(channel.covariance)
    vector, spread = np.array(channel.frame_rotation), np.array(channel.covariance)[:3, :3]
    angle = float(np.linalg.norm(vector))
    # Along the rotation's own axis its spread is that of the angle; without a rotation the widest direction counts.
    variance = float(vector @ spread @ vector) / angle**2 if angle else float(np.linalg.eigvalsh(spread)[-1])
    turned = f"turned {math.degrees(angle):.0f}° ± {math.degrees(math.sqrt(max(variance, 0.0))):.0f}°"
    late = f"delay {_rounded(channel.delay, 2)} ± {delay:.2f} s"
    return f"actions explain {100 * channel.explained:.0f} %: gain {channel.gain:.2f} ± {gain:.2f}, {turned}, {late}"


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
        "success_interval": None if plan.success_interval is None else list(plan.success_interval),
        "verification_trials": plan.verification_trials,
        "findings": findings(plan),
        "warnings": list(plan.warnings),
        "arm": None
        if plan.arm is None
        else {
            "least_clearance": plan.arm.least_clearance,
            "closest_pair": list(plan.arm.closest_pair),
            "closest_knot": plan.arm.closest_knot,
            "least_manipulability": float(plan.arm.manipulability.min()),
            "deviation": plan.arm.deviation,
        },
        "seconds": dict(plan.timings),
        "seed": plan.seed,
    }


def findings(plan: Plan) -> list[dict[str, Any]]:
    """What stands in the way of a plan."""
    return [asdict(finding) for finding in plan.findings]


def explained(explanation: Explanation) -> dict[str, Any]:
    """Keys of `explain`."""
    return asdict(explanation)


def checked(found: Sequence[FileCheck]) -> dict[str, Any]:
    """Keys of `check`: the number of faults, and per file its kind, faults and warnings."""
    files = [
        {
            "file": str(item.file),
            "kind": item.kind,
            "faults": [_fault(fault) for fault in item.faults],
            "warnings": list(item.warnings),
        }
        for item in found
    ]
    return {"faults": sum(len(item.faults) for item in found), "files": files}


def _fault(error: InputError) -> dict[str, Any]:
    """An error in its pieces; line and column (from 1) are null where they are not known."""
    line, column = error.position or (None, None)
    return {
        "source": error.source,
        "where": error.where,
        "line": line,
        "column": column,
        "problem": error.problem,
        "remedy": error.remedy,
        "message": str(error),
    }


def examined(found: Environment) -> dict[str, Any]:
    """Keys of `doctor`: versions, libraries with their state, solvers, browser and advice."""
    libraries = [
        {**asdict(item.library), "state": item.state, "version": item.version, "message": item.message}
        for item in found.libraries
    ]
    return {
        "micah_plan": found.micah_plan,
        "python": found.python,
        "system": found.system,
        "complete": found.complete,
        "libraries": libraries,
        "linear_solvers": list(found.linear_solvers),
        "browser": found.browser,
        "advice": list(found.advice),
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


def predicted(automaton: HybridAutomaton, runs: Sequence[RunPrediction]) -> dict[str, Any]:
    """Keys of `predict`: root mean squares over all runs against what noise alone would leave, and per run."""
    from micah_plan.residual.judgement import judge

    judged = judge(automaton, runs)
    return {
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


def calibrated(found: Calibration, seconds: float) -> dict[str, Any]:
    """Keys of `calibrate`."""
    return {
        "verdict": found.verdict,
        "effects": [_effect(effect) for effect in found.effects],
        "residual": {
            "before": {"one_step_rmse": found.before.one_step, "rollout_rmse": found.before.rollout},
            "after": {"one_step_rmse": found.after.one_step, "rollout_rmse": found.after.rollout},
            "noise_floor": found.noise_floor,
        },
        "unexplained_fraction": found.unexplained_fraction,
        "missing_modes": [_missing_mode(mode) for one in found.traces for mode in one.missing_modes],
        "coordinates": [_coordinate(one) for one in found.traces],
        "notes": list(found.notes),
        "next_experiment": found.experiment,
        "seconds": seconds,
    }


def _effect(found: FoundEffect) -> dict[str, Any]:
    effect = found.effect
    names = [name for name, _ in effect.parameters]
    return {
        "name": effect.name,
        "parameters": dict(effect.parameters) | dict(found.derived),
        "units": dict(zip(names, found.units, strict=True)) | {name: "s" for name, _ in found.derived},
        "evidence": found.evidence,
        "is_added": found.is_added,
        "interval_95": {name: list(pair) for name, pair in zip(names, found.interval, strict=True)},
        "coordinate": effect.coordinate,
        "modes": list(effect.modes),
        "since": None if found.since is None else {"run": found.since[0], "time_s": found.since[1]},
        "tied_with": list(found.tied),
        "separating_experiment": found.experiment or None,
        "sentence": found.sentence,
        "source": found.source,
    }


def _missing_mode(mode: MissingMode) -> dict[str, Any]:
    ends = {
        "from": mode.low if math.isfinite(mode.low) else None,
        "to": mode.high if math.isfinite(mode.high) else None,
    }
    return {"coordinate": mode.coordinate, "unit": mode.unit, **ends, "gain": mode.gain, "bias": mode.bias} | {
        "evidence": mode.evidence,
        "modes": list(mode.modes),
        "sentence": str(mode),
    }


def _coordinate(one: LaneTrace) -> dict[str, Any]:
    return {
        "name": one.lane.coordinate,
        "unit": one.lane.unit,
        "verdict": one.verdict,
        "unexplained_fraction": one.unexplained_fraction,
        "ranking": [
            {"name": name, "evidence": evidence, "standard_error": error} for name, evidence, error in one.ranking
        ],
        "autocorrelation": one.correlation,
        "whiteness_p": one.white_probability,
    }


def _rmse(errors: Sequence[PredictionError]) -> dict[str, float | None]:
    from micah_plan.residual.prediction import rmse

    rotations = [error.rotation for error in errors if error.rotation is not None]
    return {
        "position_rmse_m": rmse([error.position for error in errors]),
        "rotation_rmse_rad": rmse(rotations) if rotations else None,
        "configuration_rmse": rmse([error.configuration for error in errors]),
    }
